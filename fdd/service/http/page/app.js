// The page: what is shown by the address after #, kept up to date, and the keyboard.

import { acknowledge, alarmsView, faultTitle, historyView } from "./alarms.js";
import { get, listen, post } from "./api.js";
import { axisView } from "./axis.js";
import { field } from "./dialog.js";
import { h, now, show } from "./dom.js";
import { fleetView } from "./fleet.js";

const at = (id) => document.getElementById(id);
const main = at("main");
const EVERY_S = 5;
const app = { axes: [], alarms: [], sources: {}, session: null, refresh: () => refresh() };
let view = null, known = null, live = false, trouble = [], answered = now(), busy = null, due = 0;

// Views

function route() {
  const [, kind, rest] = location.hash.match(/^#\/(\w*)\/?(.*)$/) ?? [null, "", ""];
  let name = "";
  try { name = decodeURIComponent(rest); } catch { /* a damaged address shows no such axis */ }
  view = kind === "axis" ? axisView(app, name) : kind === "alarms" ? alarmsView(app) : kind === "history" ? historyView(app) : fleetView(app);
  main.replaceChildren(...view.node.flat(Infinity).filter(Boolean));
  for (const link of document.querySelectorAll("nav [data-view]")) {
    if (link.dataset.view === (kind || "fleet")) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  scrollTo(0, 0);
  refresh();
}

// Data

async function refresh() {
  if (busy) { await busy; }
  busy = update();
  try { await busy; } finally { busy = null; }
}

async function update() {
  due = now() + EVERY_S;
  try {
    const [{ axes }, { alarms }, health] = await Promise.all([get("/api/axes"), get("/api/alarms"), get("/api/health")]);
    Object.assign(app, { axes, alarms, sources: health.sources ?? {} });
    trouble = health.status === "ok" ? [] : health.problems.length ? health.problems : ["The service reports trouble."];
    answered = now();
    announce(alarms);
    await view.update();
  } catch (error) {
    if (error.status === 401) { login(); return; }
    trouble = [error.status === 404 ? "There is no such axis." : error.message];
  }
  tell();
}

function announce(alarms) {
  const fresh = alarms.filter((a) => a.state === "UNACK");
  const added = known === null ? [] : fresh.filter((a) => known.get(a.id) !== "UNACK");
  known = new Map(alarms.map((a) => [a.id, a.state]));
  if (added.length) at("news").textContent = added.map((a) => `New ${a.priority} alarm on ${a.axis}: ${faultTitle(a)}`).join(". ");
  const n = alarms.filter((a) => a.state === "UNACK" || a.state === "RTNUN").length;
  at("badge").textContent = n;
  at("badge").hidden = n === 0;
  document.title = `${n ? `(${n}) ` : ""}${view.title} – fdd`;
}

function tell() {
  at("live").dataset.state = live && now() - answered < 15 ? "live" : "lost";
  at("live").textContent = at("live").dataset.state === "live" ? "Live" : "Not live";
  const lines = [...trouble];
  if (!live && now() - answered > 15) lines.unshift(`No connection since ${new Date(answered * 1000).toLocaleTimeString("en-GB")}: what is shown is old.`);
  const text = lines.join(" ");
  if (at("banner").textContent !== text) at("banner").textContent = text;
}

// Keyboard

const alarmsShown = () => [...main.querySelectorAll("[data-alarm]")];

function key(event) {
  const inField = event.target.closest("input, select, textarea, dialog");
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape" && !document.querySelector("dialog")) {
    if (view?.search?.value) { view.search.value = ""; view.update(); }
    else if (inField) event.target.blur();
    else if (location.hash.startsWith("#/axis/")) location.hash = "#/";
  }
  if (inField || !app.session) return;
  if (event.key === "/") {
    event.preventDefault();
    if (!view.search) { location.hash = "#/"; route(); }
    view.search.focus();
  } else if (event.key === "a") {
    const row = document.activeElement.closest("[data-alarm]") ?? alarmsShown()[0];
    const alarm = row && app.alarms.find((x) => x.id === Number(row.dataset.alarm));
    if (alarm) { event.preventDefault(); row.focus(); acknowledge(app, alarm); }
  } else if (event.key === "ArrowDown" || event.key === "ArrowUp") {
    const rows = alarmsShown(), k = rows.indexOf(document.activeElement.closest("[data-alarm]"));
    const next = rows[event.key === "ArrowDown" ? k + 1 : k - 1];
    if (next) { event.preventDefault(); next.focus(); }
  }
}

// Who is calling

function login() {
  app.session = null;
  at("logout").hidden = true;
  const problem = h("p", { class: "problem", role: "alert" });
  const token = h("input", { type: "password", name: "token", required: true, autocomplete: "current-password" });
  const form = h("form", { class: "panel login" }, h("h1", {}, "Log in"), field("Your token", token), problem, h("div", { class: "buttons" }, h("button", { class: "primary", type: "submit" }, "Log in")));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try { await post("/api/login", { token: token.value }); await begin(); } catch (error) { problem.textContent = error.message; token.select(); }
  });
  if (main.querySelector(".login")) return;
  show(main, form);
  token.focus();
}

async function begin() {
  try {
    app.session = await get("/api/session");
  } catch (error) {
    if (error.status === 401) { login(); return; }
    trouble = [error.message];
    tell();
    setTimeout(begin, 3000);
    return;
  }
  at("who").textContent = app.session.tokens ? `${app.session.name} (${app.session.role})` : "";
  at("logout").hidden = !app.session.tokens;
  route();
  listen((event) => {
    // Figures are asked for every few seconds anyway; what many axes say in a moment is asked for once.
    if (event.kind !== "status" && event.kind !== "quality") due = Math.min(due, now() + 0.15);
  }, (stands) => { live = stands; tell(); });
}

at("logout").addEventListener("click", async () => { await post("/api/logout").catch(() => {}); location.reload(); });
addEventListener("hashchange", () => app.session && route());
addEventListener("keydown", key);
setInterval(() => { if (app.session && !busy && now() >= due) refresh(); if (app.session) tell(); }, 250);
begin();
