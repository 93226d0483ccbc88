// Alarms: the list of those that stand, what can be done to them, and the history.

import { get, post } from "./api.js";
import { field, question } from "./dialog.js";
import { ago, axisLink, capital, clock, figure, h, many, now, percent, showIfNew, span } from "./dom.js";
import { RANK, STATES, chip, priority } from "./marks.js";
import words from "./words.js";

const isFresh = (alarm) => alarm.state === "UNACK" || alarm.state === "RTNUN";
const mayAct = (app) => app.session.role !== "view";

export const faultTitle = (alarm) => {
  const title = capital(words.faults[alarm.fault] ?? alarm.fault.replaceAll("_", " "));
  return alarm.channel ? `${title}, ${alarm.channel.replaceAll("_", " ")}` : title;
};

// Unacknowledged first, then by priority, then the newest.
export function ordered(alarms) {
  const kind = (a) => (isFresh(a) ? 0 : a.state === "ACKED" ? 1 : 2);
  return [...alarms].sort((a, b) => kind(a) - kind(b) || RANK.indexOf(b.priority) - RANK.indexOf(a.priority) || b.raised_wall - a.raised_wall);
}

const note = () => field("Note (optional)", h("input", { name: "note", maxlength: 1000, autocomplete: "off", autofocus: true }));
const named = (alarm) => `${faultTitle(alarm)} on ${alarm.axis}`;

export function acknowledge(app, alarm) {
  if (!isFresh(alarm) || !mayAct(app)) return;
  question({
    title: "Acknowledge this alarm?", text: named(alarm), fields: [note()], confirm: "Acknowledge",
    act: async ({ note }) => { await post(`/api/alarms/${alarm.id}/acknowledge`, { note }); await app.refresh(); },
  });
}

function shelve(app, alarm) {
  const spans = [[30, "30 minutes"], [120, "2 hours"], [480, "8 hours"], [1440, "a day"], [10080, "a week"]];
  question({
    title: "Shelve this alarm?", text: `${named(alarm)}. It stays silent until the time is up.`, confirm: "Shelve",
    fields: [field("For how long", h("select", { name: "minutes", autofocus: true }, spans.map(([m, text]) => h("option", { value: m, selected: m === 480 }, text)))), field("Why", h("input", { name: "note", maxlength: 1000, required: true, autocomplete: "off" }))],
    act: async ({ minutes, note }) => { await post(`/api/alarms/${alarm.id}/shelve`, { minutes: Number(minutes), note }); await app.refresh(); },
  });
}

function unshelve(app, alarm) {
  question({
    title: "Take it off the shelf?", text: named(alarm), fields: [note()], confirm: "Unshelve",
    act: async ({ note }) => { await post(`/api/alarms/${alarm.id}/unshelve`, { note }); await app.refresh(); },
  });
}

function actions(app, alarm) {
  const button = (text, act, kind = "") => h("button", { type: "button", class: kind, "data-key": `${text} ${alarm.id}`, "aria-label": `${text}: ${named(alarm)}`, onclick: act }, text);
  const standing = ["UNACK", "ACKED", "RTNUN"].includes(alarm.state);
  return h("div", { class: "actions" },
    mayAct(app) && isFresh(alarm) && button("Acknowledge", () => acknowledge(app, alarm), "primary"),
    mayAct(app) && standing && button("Shelve", () => shelve(app, alarm)),
    mayAct(app) && alarm.state === "SHELVED" && button("Unshelve", () => unshelve(app, alarm)));
}

const zoneOf = (app, axis) => app.axes.find((a) => a.name === axis)?.zone;

function item(app, alarm, withAxis) {
  const facts = [
    alarm.severity !== null && `severity ${figure(alarm.severity, 2)}`,
    alarm.confidence !== null && `${percent(alarm.confidence)} sure`,
    alarm.count > 1 && `raised ${many(alarm.count, "time")}`,
  ].filter(Boolean).join(", ");
  const shelf = alarm.state === "SHELVED" && alarm.shelved_until ? ` for ${span(alarm.shelved_until - now())} more, by ${alarm.shelved_by ?? "?"}` : "";
  const by = alarm.state === "ACKED" && alarm.acked_by ? ` by ${alarm.acked_by}` : "";
  return h("li", { class: `alarm ${alarm.priority}${isFresh(alarm) ? " fresh" : ""}`, tabindex: 0, "data-alarm": alarm.id, "data-key": `alarm ${alarm.id}`, "aria-label": `${alarm.priority} priority, ${named(alarm)}, ${STATES[alarm.state]}` },
    priority(alarm.priority, isFresh(alarm)),
    h("div", { class: "what" },
      h("b", {}, faultTitle(alarm)), withAxis && axisLink(alarm.axis),
      h("span", { class: "soft" }, [`${capital(alarm.priority)} priority`, facts].filter(Boolean).join(" · ")),
      alarm.note && h("q", {}, alarm.note)),
    h("div", { class: "state" },
      h("span", {}, chip(STATES[alarm.state] + by + shelf, isFresh(alarm) ? "strong" : ""), alarm.chattering && chip("Chattering")),
      h("span", { class: "soft" }, "Raised ", ago(alarm.raised_wall, zoneOf(app, alarm.axis)))),
    actions(app, alarm));
}

export function alarmList(app, alarms, withAxis = true) {
  if (!alarms.length) return h("p", { class: "panel soft" }, "No alarms stand.");
  return h("ul", { class: "panel alarms" }, ordered(alarms).map((a) => item(app, a, withAxis)));
}

const minute = () => Math.floor(now() / 20);

export function alarmsView(app) {
  const head = h("p", { class: "soft" }), list = h("div");
  return {
    title: "Alarms", node: [h("h1", {}, "Alarms"), head, list],
    update: () => {
      const fresh = app.alarms.filter(isFresh).length;
      head.textContent = app.alarms.length ? `${many(app.alarms.length, "alarm stands", "alarms stand")}, ${fresh} unacknowledged.` : "";
      showIfNew(list, [app.alarms, minute(), app.session], () => alarmList(app, app.alarms));
    },
  };
}

export function historyView(app) {
  const past = h("div"), audit = h("div");
  return {
    title: "History", node: [h("h1", {}, "History"), h("h2", {}, "Alarms"), past, h("h2", {}, "Who did what"), audit],
    update: async () => {
      const [{ alarms }, { records }] = await Promise.all([get("/api/alarms?state=all&limit=500"), get("/api/audit?limit=300")]);
      const byId = new Map(alarms.map((a) => [a.id, a]));
      showIfNew(past, alarms, () => table(["Raised", "Axis", "Fault", "Priority", "State", "Times", "Note"], alarms.map((a) => [
        clock(a.raised_wall, zoneOf(app, a.axis)), axisLink(a.axis), faultTitle(a), h("span", { class: "with-mark" }, priority(a.priority), a.priority), STATES[a.state], a.count, a.note])));
      showIfNew(audit, records, () => table(["When", "Who", "What", "Alarm", "Axis", "Note"], records.map((r) => [
        clock(r.wall, zoneOf(app, r.axis)), r.who, r.action.toLowerCase().replaceAll("_", " "), byId.has(r.alarm_id) ? faultTitle(byId.get(r.alarm_id)) : r.alarm_id ?? "", r.axis ?? "", r.note])));
    },
  };
}

function table(heads, rows) {
  if (!rows.length) return h("p", { class: "panel soft" }, "Nothing yet.");
  return h("div", { class: "panel scroll", tabindex: 0, role: "region", "aria-label": heads.join(", ") }, h("table", { class: "cards" },
    h("thead", {}, h("tr", {}, heads.map((t) => h("th", { scope: "col" }, t)))),
    h("tbody", {}, rows.map((row) => h("tr", {}, row.map((cell, k) => h("td", { "data-title": heads[k] }, cell)))))));
}
