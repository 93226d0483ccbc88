// What an alarm or a state looks like: a shape and a word, never colour alone.

import { h, s } from "./dom.js";

const SHAPES = {
  urgent: ["M2 2h20v20H2z", "1"],
  high: ["M12 1 23 22H1z", "2"],
  medium: ["M12 1 23 12 12 23 1 12z", "3"],
  low: ["M12 2a10 10 0 1 0 .01 0z", "4"],
};
export const STATES = {
  UNACK: "Unacknowledged", ACKED: "Acknowledged", RTNUN: "Returned, unacknowledged",
  SHELVED: "Shelved", NORMAL: "Closed",
};
export const RANK = ["low", "medium", "high", "urgent"];

export function priority(name, fresh = false) {
  const [path, digit] = SHAPES[name];
  return s("svg", { class: `mark ${name}${fresh ? " fresh" : ""}`, viewBox: "0 0 24 24", role: "img", "aria-label": `${name} priority` },
    s("path", { d: path }), s("text", { x: 12, y: name === "high" ? 19 : 17, "text-anchor": "middle" }, digit));
}

const CALM = {
  healthy: "M6 12.5l4 4 8-9", learning: "M7 12h.01M12 12h.01M17 12h.01", silent: "M6 12h12", failed: "M7 7l10 10M17 7 7 17",
};

export function stateMark(axis) {
  if (axis.priority) return priority(axis.priority, axis.unacknowledged > 0);
  return s("svg", { class: `mark calm ${axis.state}`, viewBox: "0 0 24 24", role: "img", "aria-label": axis.state },
    s("circle", { cx: 12, cy: 12, r: 10.5 }), s("path", { d: CALM[axis.state] ?? CALM.learning }));
}

// As the fleet counts it: an alarm that nobody has seen is an alarm, and an axis in alarm may have fallen silent.
export const isIn = (axis, state) => axis.state === state || (state === "in alarm" && axis.state === "unacknowledged") || (state === "silent" && axis.silent);

export const chip = (text, kind = "") => h("span", { class: `chip ${kind}` }, text);
