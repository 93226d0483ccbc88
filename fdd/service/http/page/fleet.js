// The fleet at a glance: worst first, by state, by name.

import { gauge } from "./charts.js";
import { ago, axisLink, capital, h, many, percent, showIfNew, unbroken, now } from "./dom.js";
import { RANK, chip, isIn, stateMark } from "./marks.js";

const ORDER = ["unacknowledged", "in alarm", "failed", "silent", "learning", "healthy"];
const worse = (a, b) =>
  ORDER.indexOf(a.state) - ORDER.indexOf(b.state) || RANK.indexOf(b.priority) - RANK.indexOf(a.priority) || a.name.localeCompare(b.name, "en", { numeric: true });

function row(axis, alarms) {
  const silenced = alarms.filter((a) => a.axis === axis.name && a.state === "SHELVED").length;
  const quantity = (name) => gauge(axis.estimates[name]);
  return h("tr", { class: axis.state.replace(" ", "-") },
    h("td", { class: "sign" }, stateMark(axis)),
    h("th", { scope: "row" }, axisLink(axis.name), h("span", { class: "soft" }, axis.unit)),
    h("td", { class: "say" }, h("span", {}, unbroken(axis.headline || capital(axis.verdict))), axis.alarms > 1 && h("span", { class: "soft" }, many(axis.alarms, "alarm")),
      axis.silent && axis.state !== "silent" && chip("Silent"),
      silenced > 0 && chip(`${silenced} silenced`)),
    h("td", { "data-title": "Leakage" }, quantity("leakage")),
    h("td", { "data-title": "Bulk modulus" }, quantity("bulk_modulus")),
    h("td", { "data-title": "Friction" }, quantity("coulomb_friction")),
    h("td", { class: "n", "data-title": "Healthy" }, percent(axis.probabilities.healthy)),
    h("td", { class: "n", "data-title": "Data" }, axis.last_wall === null ? "none yet" : axis.silent || now() - axis.last_wall > 20 ? ago(axis.last_wall, axis.zone) : `${Math.round(axis.rate_hz ?? 0)} Hz`));
}

// Where samples come from, and what was refused there and why.
function sourceTable(sources) {
  const row = (s) => h("tr", {}, h("th", { scope: "row" }, s.name), h("td", { "data-title": "Line" }, s.connected ? "connected" : "not connected"),
    h("td", { class: "n", "data-title": "Received" }, s.received.toLocaleString("en")), h("td", { class: "n", "data-title": "Refused" }, s.refused.toLocaleString("en")),
    h("td", { "data-title": "Last trouble" }, s.last_error ?? "none"));
  return [h("h2", {}, "Sources"), h("div", { class: "panel scroll", tabindex: 0, role: "region", "aria-label": "Sources" }, h("table", { class: "cards" },
    h("thead", {}, h("tr", {}, ["Source", "Line"].map((t) => h("th", { scope: "col" }, t)), ["Received", "Refused"].map((t) => h("th", { scope: "col", class: "n" }, t)), h("th", { scope: "col" }, "Last trouble"))),
    h("tbody", {}, Object.values(sources).map(row))))];
}

export function fleetView(app) {
  let wanted = "all";
  const search = h("input", { type: "search", id: "search", placeholder: "Search axes", "aria-label": "Search axes by name", autocomplete: "off", oninput: () => update() });
  const counts = h("div", { class: "counts", role: "group", "aria-label": "Filter by state" }), list = h("div"), sources = h("section");
  const count = (name, n) => h("button", { type: "button", "data-key": `count ${name}`, "aria-pressed": String(wanted === name), class: n && (name === "unacknowledged" || name === "failed") ? "strong" : "", onclick: () => { wanted = name; update(); } },
    h("b", {}, n), h("span", {}, capital(name)));
  function update() {
    const axes = app.axes, text = search.value.trim().toLowerCase();
    const numbers = ORDER.map((state) => axes.filter((a) => isIn(a, state)).length);
    showIfNew(counts, [wanted, numbers], () => [count("all", axes.length), ORDER.map((state, k) => count(state, numbers[k]))]);
    const shown = axes.filter((a) => (wanted === "all" || isIn(a, wanted)) && a.name.toLowerCase().includes(text)).sort(worse);
    showIfNew(list, [shown, app.alarms, Math.floor(now() / 20)], () => (shown.length
      ? h("div", { class: "panel" }, h("table", { class: "fleet" },
        h("thead", {}, h("tr", {}, h("th", {}, h("span", { class: "unseen" }, "State")), ["Axis", "Verdict", "Leakage", "Bulk modulus", "Friction"].map((t) => h("th", { scope: "col" }, t)), ["Healthy", "Data"].map((t) => h("th", { scope: "col", class: "n" }, t)))),
        h("tbody", {}, shown.map((a) => row(a, app.alarms)))))
      : h("p", { class: "panel soft" }, axes.length ? "No axis of that name and state." : "No axis has sent data yet.")));
    showIfNew(sources, app.sources, () => sourceTable(app.sources));
  }
  return {
    title: "Fleet", update, search,
    node: [h("div", { class: "bar" }, h("h1", {}, "Fleet"), search), counts, list, sources,
      h("p", { class: "soft key" }, "Gauges compare with the healthy value, from half to one and a half of it; the shaded middle is ± 10 %.")],
  };
}
