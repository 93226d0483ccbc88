// Elements and figures. Text only ever becomes text nodes: nothing that is shown can be markup.

const SVG = "http://www.w3.org/2000/svg";

function fill(node, props, children) {
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  node.append(...children.flat(Infinity).filter((c) => c !== undefined && c !== null && c !== false && c !== ""));
  return node;
}

export const h = (tag, props, ...children) => fill(document.createElement(tag), props, children);
export const s = (tag, props, ...children) => fill(document.createElementNS(SVG, tag), props, children);

// Show something anew without taking the focus away from what has the same data-key.
export function show(container, ...children) {
  const key = container.contains(document.activeElement) && document.activeElement.dataset.key;
  container.replaceChildren(...children.flat(Infinity).filter(Boolean));
  if (key) [...container.querySelectorAll("[data-key]")].find((n) => n.dataset.key === key)?.focus();
}

// As `show`, but only where what it is made of has changed.
export function showIfNew(container, data, make) {
  const text = JSON.stringify(data);
  if (container.shown === text) return;
  container.shown = text;
  show(container, make());
}

export function figure(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return value.toExponential(digits - 1).replace("e", " e");
  const shown = Number(value.toPrecision(digits));
  return shown.toLocaleString("en", { maximumSignificantDigits: Math.max(digits, Math.trunc(size).toString().length), useGrouping: false });
}

export function percent(share) {
  if (share === null || share === undefined) return "–";
  if (share > 0.995) return "over 99 %";
  if (share < 0.005) return "under 1 %";
  return `${Math.round(100 * share)} %`;
}

export function span(seconds) {
  if (seconds < 0) return "0 s";
  if (seconds < 100) return `${seconds < 10 ? seconds.toFixed(1).replace(".0", "") : Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 48 * 3600) return `${(seconds / 3600).toFixed(1).replace(".0", "")} h`;
  return `${Math.round(seconds / 86400)} days`;
}

// In the zone that the axis's times are told in, where the service names one; a zone that is not the reader's is told.
export function clock(wall, zone) {
  const then = new Date(wall * 1000), timeZone = zone ?? undefined, day = (t) => t.toLocaleDateString("en-CA", { timeZone });
  const own = !zone || then.toLocaleString("en-GB", { timeZone }) === then.toLocaleString("en-GB");
  const time = then.toLocaleTimeString("en-GB", { timeZone, hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: own ? undefined : "short" });
  return day(then) === day(new Date()) ? time : `${day(then)} ${time}`;
}

export const many = (n, one, more = `${one}s`) => `${n} ${n === 1 ? one : more}`;

export const now = () => Date.now() / 1000;
export const ago = (wall, zone) => h("time", { datetime: new Date(wall * 1000).toISOString(), title: clock(wall, zone) }, `${span(Math.round(now() - wall))} ago`);
export const axisLink = (name, ...children) => h("a", { href: `#/axis/${encodeURIComponent(name)}`, "data-key": `axis ${name}` }, children.length ? children : name);
// Figures stay with their units, so that no line begins with a percent sign.
export const unbroken = (text) => text.replaceAll(/(\d) (%|s|h|min|MPa|Pa|N|Hz)\b/g, "$1\u00a0$2").replaceAll(" % ", "\u00a0% ").replaceAll(" sure", "\u00a0sure");
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);
