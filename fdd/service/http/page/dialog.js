// One question at a time: a dialogue that keeps the focus, closes by Escape and says what went wrong.

import { h } from "./dom.js";

export function field(label, input) {
  return h("label", { class: "field" }, h("span", {}, label), input);
}

// `fields` are inputs with names; `act` is given their values and may refuse by throwing.
export function question({ title, text, fields = [], confirm, act }) {
  const problem = h("p", { class: "problem", role: "alert" });
  const yes = h("button", { type: "submit", class: "primary" }, confirm);
  const no = h("button", { type: "button", onclick: () => box.close() }, "Cancel");
  const form = h("form", { method: "dialog" }, h("h2", { id: "question" }, title), text && h("p", { class: "soft" }, text), fields, problem,
    h("div", { class: "buttons" }, no, yes));
  const box = h("dialog", { "aria-labelledby": "question" }, form);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    yes.disabled = true;
    problem.textContent = "";
    try {
      await act(Object.fromEntries(new FormData(form)));
      box.close();
    } catch (error) {
      problem.textContent = error.message;
      yes.disabled = false;
    }
  });
  const back = document.activeElement?.dataset?.key;
  box.addEventListener("close", () => {
    box.remove();
    [...document.querySelectorAll("[data-key]")].find((n) => n.dataset.key === back)?.focus();
  });
  document.body.append(box);
  box.showModal();
}
