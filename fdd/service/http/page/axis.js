// One axis: the verdict, its alarms, and what it rests on.

import { alarmList } from "./alarms.js";
import { get, remove } from "./api.js";
import { bars, chart, dates, days, minutesAgo } from "./charts.js";
import { question } from "./dialog.js";
import { ago, capital, clock, figure, h, now, percent, showIfNew, unbroken } from "./dom.js";
import { chip, stateMark } from "./marks.js";
import words from "./words.js";

const SIGNALS = {
  position: ["Position", "mm", 1e3], pressure_difference: ["Pressure difference", "MPa", 1e-6], pressure_1: ["Pressure 1", "MPa", 1e-6],
  pressure_2: ["Pressure 2", "MPa", 1e-6], pressure_accumulator: ["Accumulator", "MPa", 1e-6], pump_speed: ["Pump speed", "rad/s", 1],
  pump_angle: ["Pump angle", "rad", 1], command: ["Command", "rad/s", 1], motor_current: ["Motor current", "A", 1],
  oil_temperature: ["Oil temperature", "°C", 1], load_force: ["Load", "kN", 1e-3], position_setpoint: ["Set point", "mm", 1e3],
};
const quantityOf = (name) => words.quantities[name] ?? { title: capital(name.replaceAll("_", " ")), unit: "", scale: 1 };

function verdict(status) {
  const facts = [
    ["Profile", status.unit], ["Samples", status.samples.toLocaleString("en")], ["Rate", status.rate_hz === null ? "–" : `${figure(status.rate_hz, 4)} Hz`],
    ["Behind by", status.lag_s === null ? "–" : `${figure(status.lag_s, 2)} s`], ["Last data", status.last_wall === null ? "none yet" : ago(status.last_wall, status.zone)],
    ...Object.entries(status.quality).map(([name, n]) => [capital(name.replaceAll("_", " ")), n.toLocaleString("en")]),
  ];
  return [
    h("div", { class: "headline" }, stateMark(status), h("div", {}, h("p", { class: "big" }, unbroken(status.headline || capital(status.verdict))), chip(capital(status.state), status.unacknowledged ? "strong" : ""), status.silent && status.state !== "silent" && chip("Silent"))),
    h("div", { class: "two" }, h("dl", { class: "facts" }, facts.map(([t, v]) => h("div", {}, h("dt", {}, t), h("dd", {}, v)))),
      h("div", {}, h("h3", {}, "What it is, by probability"), bars(status.probabilities, words.families))),
  ];
}

function finding(f, { clock: begin, zone }) {
  const at = (t) => clock(begin + t, zone);
  return h("article", { class: "panel finding" },
    h("h3", {}, `${capital(words.faults[f.fault] ?? f.fault)}, ${percent(f.confidence)} sure`),
    begin !== null && h("p", { class: "soft" }, `Since ${at(f.onset_s)}, detected ${at(f.detected_s)}. Seconds below count from ${at(0)}.`),
    h("ul", {}, f.evidence.map((text) => h("li", {}, unbroken(text)))),
    f.next_check && h("p", {}, h("b", {}, "To confirm it: "), f.next_check));
}

function estimateCharts({ estimates, status }) {
  const stamp = minutesAgo(estimates.time.at(-1), lastSeen(status));
  return Object.entries(estimates.values).map(([name, values]) => {
    const { title, unit, scale } = quantityOf(name), std = estimates.std[name] ?? [];
    const beside = (sign) => values.map((v, k) => (v === null || std[k] === null || std[k] === undefined ? null : v + sign * 2 * std[k]));
    return chart({ title, unit, scale, time: estimates.time, stamp, empty: "Not visible in what has come so far.", at: tens(estimates.time), mark: status.estimates[name]?.baseline, rows: [{ label: title, values, low: beside(-1), high: beside(1) }] });
  });
}

const missing = ({ silent, state, last_wall: last }) =>
  state === "failed" ? "None while the axis fails; the reason stands above." : silent && last !== null ? "None since the service was started: no samples have come." : "The first ones come after five seconds of data.";

const lastSeen = (status) => (status.silent && status.last_wall !== null ? clock(status.last_wall, status.zone) : undefined);

// Whole minutes before the end, every second one or so.
function tens(time) {
  const end = time.at(-1), long = (end - time[0]) / 60, step = long > 6 ? 2 : long > 2 ? 1 : 0.5, out = [];
  for (let m = 0; m <= long + 0.01; m += step) out.unshift(end - 60 * m);
  return out;
}

function others({ probabilities, misfits, signals, status }) {
  const stamp = (time) => ({ time, stamp: minutesAgo(time.at(-1), lastSeen(status)), at: tens(time) });
  const families = Object.entries(probabilities.values).filter(([, p]) => p.some((v) => v >= 0.05)).slice(0, 4);
  return [
    families.length && [h("h2", {}, "Probabilities and balances"), h("p", { class: "soft" }, "Root of the reduced chi-square of each balance, half a second at a time: about 1 while healthy (line). Findings add up many half seconds, so a small fault is found while this hardly leaves 1."),
      h("div", { class: "plots" },
        chart({ title: "Probability", unit: "%", scale: 100, floor: 100, ...stamp(probabilities.time), rows: families.map(([name, values]) => ({ label: words.families[name] ?? name, values })) }),
        Object.entries(misfits.values).map(([name, values]) => chart({ title: capital((words.balances[name] ?? name).replace(/^the /, "")), floor: 4, mark: 1, ...stamp(misfits.time), rows: [{ label: name, values }] })))],
    signals.time.length && [h("h2", {}, "Signals"), h("div", { class: "plots" }, Object.keys(signals.low).map((name) => {
      const [title, unit, scale] = SIGNALS[name] ?? [capital(name.replaceAll("_", " ")), "", 1];
      return chart({ title, unit, scale, ...stamp(signals.time), rows: [{ label: title, low: signals.low[name], high: signals.high[name] }] });
    }))],
  ];
}

function trend(name) {
  const choice = (key, options) => h("select", { "aria-label": key, "data-key": key, onchange: () => guarded() }, Object.entries(options).map(([v, t]) => h("option", { value: v }, t)));
  const what = choice("Quantity", Object.fromEntries(Object.entries(words.quantities).map(([k, q]) => [k, q.title])));
  const level = choice("Resolution", { hour: "by hour, 30 days", day: "by day, whole life", minute: "by minute, a day" });
  const holder = h("div");
  async function load() {
    const { title, unit, scale } = quantityOf(what.value);
    const { points, sentence } = await get(`/api/axes/${encodeURIComponent(name)}/trend?quantity=${what.value}&level=${level.value}`);
    const column = (key) => points.map((p) => p[key]);
    showIfNew(holder, [what.value, level.value, points, sentence], () => [sentence && h("p", { class: "soft" }, capital(sentence)), chart({ title: `${title}, mean and range`, unit, scale, height: 190, time: column("start_wall"), stamp: dates, at: days(column("start_wall")), empty: "No values in this span: the data have not told this quantity, or there are none.", rows: [{ label: title, values: column("mean"), low: column("min"), high: column("max") }] })]);
  }
  const guarded = () => load().catch((error) => holder.replaceChildren(h("p", { class: "soft" }, error.message)));
  return { node: [h("div", { class: "bar" }, h("h2", {}, "Trend"), h("div", { class: "choices" }, what, level)), h("div", { class: "plots one" }, holder)], update: guarded };
}

function removal(app, name) {
  const act = async () => { await remove(`/api/axes/${encodeURIComponent(name)}`); location.hash = "#/"; };
  const text = `${name}: its state and its trend go, its alarms end; history and audit stay. If it sends again it begins anew.`;
  return app.session.role === "admin" && h("button", { type: "button", "data-key": "remove", onclick: () => question({ title: "Remove this axis?", text, confirm: "Remove", act }) }, "Remove");
}

export function axisView(app, name) {
  const parts = Object.fromEntries(["top", "alarms", "findings", "estimates", "others"].map((k) => [k, h("section")]));
  const life = trend(name);
  let trendDue = 0;
  return {
    title: name,
    node: [h("nav", { class: "crumbs", "aria-label": "Where" }, h("a", { href: "#/" }, "Fleet"), " / "), h("div", { class: "bar" }, h("h1", {}, name), removal(app, name)), parts.top, parts.alarms, parts.findings, parts.estimates, h("section", {}, life.node), parts.others],
    update: async () => {
      const detail = await get(`/api/axes/${encodeURIComponent(name)}`);
      const alarms = app.alarms.filter((a) => a.axis === name), soon = Math.floor(now() / 20);
      parts.top.className = `panel verdict ${detail.status.priority ?? "calm"}`;
      showIfNew(parts.top, detail.status, () => verdict(detail.status));
      showIfNew(parts.alarms, [alarms, soon], () => [h("h2", {}, "Alarms"), alarmList(app, alarms, false)]);
      showIfNew(parts.findings, [detail.findings, detail.status.clock], () => detail.findings.length && [h("h2", {}, "What was found"), detail.findings.map((f) => finding(f, detail.status))]);
      showIfNew(parts.estimates, [detail.estimates, detail.status.estimates, detail.status.silent], () => detail.estimates.time.length ? [h("h2", {}, "Live estimates"), h("p", { class: "soft" }, "With two standard deviations; the dashed line is this unit's healthy value."), h("div", { class: "plots" }, estimateCharts(detail))] : [h("h2", {}, "Live estimates"), h("p", { class: "panel soft" }, missing(detail.status))]);
      showIfNew(parts.others, [detail.probabilities, detail.misfits, detail.signals, detail.status.silent], () => others(detail));
      if (now() > trendDue) { trendDue = now() + 60; life.update(); }
    },
  };
}
