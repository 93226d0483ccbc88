// Small charts in SVG: lines with bands over time, a value on its scale, and bars.

import { h, s, figure } from "./dom.js";

const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 20;

// Lines at multiples of the widest step (of 1, 2 or 5) that gives at least so many of them.
function ticks(low, high, least) {
  const power = 10 ** Math.floor(Math.log10(high - low));
  const ends = (step) => [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
  const step = [5, 2, 1, 0.5, 0.2, 0.1].map((m) => m * power).find((x) => ends(x)[1] - ends(x)[0] + 1 >= least);
  const [first, last] = ends(step);
  return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step);
}

// A path that breaks where a value is missing; a value alone is a ring.
function line(time, values, x, y) {
  const missing = (k) => values[k] === null || values[k] === undefined;
  let path = "";
  for (let k = 0; k < time.length; k++) {
    if (missing(k)) continue;
    const first = k === 0 || missing(k - 1), alone = first && (k === time.length - 1 || missing(k + 1));
    path += `${first ? "M" : "L"}${x(time[k]).toFixed(1)} ${y(values[k]).toFixed(1)}`;
    if (alone) path += "m-2.5 0a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0 -5 0";
  }
  return path;
}

function area(time, low, high, x, y) {
  let path = "", from = -1;
  for (let k = 0; k <= time.length; k++) {
    const there = k < time.length && low[k] !== null && high[k] !== null;
    if (there && from < 0) from = k;
    if (!there && from >= 0) {
      const points = [];
      for (let j = from; j < k; j++) points.push(`${x(time[j]).toFixed(1)} ${y(high[j]).toFixed(1)}`);
      for (let j = k - 1; j >= from; j--) points.push(`${x(time[j]).toFixed(1)} ${y(low[j]).toFixed(1)}`);
      path += `M${points.join("L")}Z`;
      from = -1;
    }
  }
  return path;
}

const scaled = (values, by) => values?.map((v) => (v === null ? null : v * by));

// Before the end of the data, which is now only where they still come.
export const minutesAgo = (end, ended) => (t) => {
  const m = (t - end) / 60;
  return Math.abs(m) < 0.01 ? ended ?? "now" : `${Number(m.toFixed(1)).toString().replace("-", "−")} min`;
};

export function dates(t) {
  const day = new Date(t * 1000), hour = day.toLocaleTimeString("en-GB").slice(0, 5);
  return hour === "00:00" ? day.toLocaleDateString("en-GB", { day: "numeric", month: "short" }) : hour;
}

// Midnights, or whole hours of less than three days.
export function days(time) {
  if (!time.length) return [];
  const end = time.at(-1), hours = (end - time[0]) / 3600, out = [];
  const step = [1, 3, 6, 12, 24, 48, 120, 240, 720, 2160].find((x) => hours / x <= 9) ?? 8760;
  const day = new Date(time[0] * 1000);
  day.setHours(0, 0, 0, 0);
  while (day / 1000 <= end) {
    if (day / 1000 >= time[0]) out.push(day / 1000);
    if (step < 24) day.setHours(day.getHours() + step);
    else day.setDate(day.getDate() + step / 24);
  }
  return out;
}

// As many as fit beside each other, the last one always.
function fitting(stamps, x, apart) {
  const out = [];
  for (const t of stamps.toReversed()) if (!out.length || x(out[0]) - x(t) >= apart) out.unshift(t);
  return out;
}

// rows: [{label, values, low, high}]; all else is optional. Figures are multiplied by `scale`.
export function chart({ title, unit = "", time, rows, scale = 1, mark, at = [], stamp, height = 150, floor, empty = "Nothing to show yet." }) {
  const holder = h("div", { class: "plot" });
  const readout = h("span", { class: "readout", "aria-hidden": "true" });
  const drawn = rows.map((r) => ({ ...r, values: scaled(r.values, scale), low: scaled(r.low, scale), high: scaled(r.high, scale) }));
  const level = mark === null || mark === undefined ? undefined : mark * scale;
  const all = drawn.flatMap((r) => [r.values, r.low, r.high].filter(Boolean).flat()).filter((v) => v !== null);
  const last = drawn[0]?.values?.findLast((v) => v !== null) ?? drawn[0]?.high?.findLast((v) => v !== null);
  const draw = (width) => {
    if (!all.length || width < 60) { holder.replaceChildren(h("p", { class: "soft" }, empty)); return; }
    let low = Math.min(...bounds(all), level ?? Infinity), high = Math.max(...bounds(all), level ?? -Infinity);
    if (floor !== undefined) { low = 0; high = Math.max(high, floor); }
    const pad = Math.max((high - low) * 0.06, Math.abs(high) * 0.01) || 0.06; // lines that three digits tell apart
    high += pad; if (floor === undefined) low -= pad;
    const begin = time[0], end = time[time.length - 1];
    const x = (t) => LEFT + ((t - begin) / (end - begin || 1)) * (width - LEFT - RIGHT);
    const y = (v) => height - BOTTOM - ((v - low) / (high - low)) * (height - TOP - BOTTOM);
    const cursor = s("line", { class: "cursor", y1: TOP, y2: height - BOTTOM, visibility: "hidden" });
    const stamps = fitting(at.length ? at : ticks(begin, end, 4), x, 70);
    const picture = s("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title}: ${figure(last)} ${unit} ${stamp(end)}` },
      ticks(low, high, 2).map((v) => [
        s("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(v), y2: y(v) }),
        s("text", { x: LEFT - 6, y: y(v) + 4, "text-anchor": "end" }, figure(v)),
      ]).flat(),
      stamps.map((t) => s("text", { x: x(t), y: height - 4, "text-anchor": x(t) > width - 40 ? "end" : x(t) < LEFT + 20 ? "start" : "middle" }, stamp(t))),
      level !== undefined && s("line", { class: "level", x1: LEFT, x2: width - RIGHT, y1: y(level), y2: y(level) }),
      drawn.map((r, k) => [
        r.low && s("path", { class: `band row${k}`, d: area(time, r.low, r.high, x, y) }),
        r.values && s("path", { class: `line row${k}`, d: line(time, r.values, x, y) }),
      ]).flat(),
      cursor);
    picture.addEventListener("pointermove", (event) => {
      const t = begin + ((event.offsetX - LEFT) / (width - LEFT - RIGHT)) * (end - begin);
      let k = time.findIndex((v) => v >= t);
      if (k < 0) k = time.length - 1;
      cursor.setAttribute("x1", x(time[k])); cursor.setAttribute("x2", x(time[k])); cursor.setAttribute("visibility", "visible");
      readout.textContent = `${stamp(time[k])}: ${drawn.map((r) => (r.values ? figure(r.values[k]) : `${figure(r.low[k])} to ${figure(r.high[k])}`)).join(", ")}`;
    });
    picture.addEventListener("pointerleave", () => { cursor.setAttribute("visibility", "hidden"); readout.textContent = ""; });
    holder.replaceChildren(picture);
  };
  new ResizeObserver(([entry]) => draw(Math.floor(entry.contentRect.width))).observe(holder);
  const legend = drawn.length > 1 && h("span", { class: "legend" }, drawn.map((r, k) => h("span", { class: `row${k}` }, r.label)));
  return h("figure", {}, h("figcaption", {}, h("b", {}, title), unit && h("span", { class: "soft" }, unit), readout, legend), holder);
}

function bounds(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
  return [low, high];
}

// A value beside its healthy one, from half to one and a half of it: the eye compares places, not digits.
export function gauge(estimate) {
  if (!estimate?.observable || !estimate.baseline) return h("span", { class: "soft" }, "not visible");
  const ratio = estimate.value / estimate.baseline, std = (estimate.std ?? 0) / estimate.baseline;
  const x = (r) => 4 + 72 * Math.min(1, Math.max(0, r - 0.5));
  const off = Math.abs(ratio - 1) > Math.max(0.1, 3 * std);
  const change = Math.round(100 * (ratio - 1));
  const text = `${change > 0 ? "+" : change < 0 ? "−" : "±"}${Math.abs(change)} %`;
  return h("span", { class: `gauge${off ? " off" : ""}` },
    s("svg", { viewBox: "0 0 80 16", width: 80, height: 16, "aria-hidden": "true" },
      s("rect", { class: "track", x: 4, y: 6, width: 72, height: 4, rx: 2 }),
      s("rect", { class: "usual", x: x(0.9), y: 4, width: x(1.1) - x(0.9), height: 8, rx: 2 }),
      s("line", { class: "doubt", x1: x(ratio - 2 * std), x2: x(ratio + 2 * std), y1: 8, y2: 8 }),
      s("path", { class: "hand", d: `M${x(ratio)} 1.5l3.5 6.5-3.5 6.5-3.5-6.5z` })),
    h("span", { class: "n" }, text));
}

export function bars(shares, titles) {
  const rows = Object.entries(shares).filter(([, p]) => p >= 0.005).sort((a, b) => b[1] - a[1]).slice(0, 6);
  if (!rows.length) return h("p", { class: "soft" }, "Not known before the first five seconds of data.");
  return h("div", { class: "bars" }, rows.map(([name, share]) => [
    h("span", {}, titles[name] ?? name),
    s("svg", { viewBox: "0 0 100 8", preserveAspectRatio: "none", "aria-hidden": "true" },
      s("rect", { class: "track", width: 100, height: 8 }), s("rect", { class: name === "healthy" ? "fill calm" : "fill", width: 100 * share, height: 8 })),
    h("span", { class: "n" }, `${Math.round(100 * share)} %`),
  ]));
}
