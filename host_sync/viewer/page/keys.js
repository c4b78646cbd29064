// The list of keys.

import { check, h } from "./dom.js";

const KEPT = "retrograph keys everywhere";

/** Whether single keys work without the focus on the relief; a person can switch that off. */
export const keysEverywhere = () => localStorage.getItem(KEPT) !== "no";

const KEYS = [
  ["← → ↑ ↓", "move the map, or turn in space"],
  ["Shift + ← → ↑ ↓", "move the light"],
  ["+  −", "zoom"],
  ["0", "show everything"],
  ["1", "a screen pixel for each pixel"],
  ["3", "map or space"],
  ["M  L  P", "drag to move, to light, to draw a profile"],
  ["R", "record, in a live view"],
  ["Ctrl + Z", "undo a change of what is measured (with Shift: redo)"],
  ["right button", "drag the light (map) or the view (space)"],
  ["?", "this list"],
];

export function setUpKeys(button) {
  const dialog = h("dialog", { class: "keys", "aria-label": "Keys" },
    h("h2", {}, "Keys"),
    h("p", {}, "Profile ends, light and places that are measured can also be typed in the panel."),
    check("Keys work wherever the focus is, except in fields", keysEverywhere(), (on) => localStorage.setItem(KEPT, on ? "yes" : "no")).element,
    h("dl", {}, KEYS.flatMap(([key, words]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, words)])),
    h("button", { type: "button", onclick: () => dialog.close() }, "Close"));
  document.body.append(dialog);
  button.addEventListener("click", () => dialog.showModal());
  document.addEventListener("keydown", (event) => {
    const typing = event.target.matches("input, select, textarea");
    if (event.key === "?" && !typing && !dialog.open) dialog.showModal();
  });
}
