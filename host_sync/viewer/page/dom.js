// Elements from words: text is always set as text, so that no name or note of a scan can become markup.

/** An element with attributes, listeners (keys that begin with "on") and children; null children are left out. */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  assign(element, attributes);
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** The same for drawings. */
export function svg(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  assign(element, attributes);
  element.append(...children);
  return element;
}

function assign(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
}

let counter = 0;

/** A label and its control, joined. */
export function field(label, control, { hidden = false, unit = null } = {}) {
  control.id ||= `control-${(counter += 1)}`;
  const words = h("label", { for: control.id, class: hidden ? "unseen" : null }, label);
  return h("div", { class: "field" }, words, control, unit && h("span", { class: "unit" }, unit));
}

/** A switch that says whether it is on. */
export function check(label, checked, onchange) {
  const box = h("input", { type: "checkbox", checked, onchange: () => onchange(box.checked) });
  return { box, element: h("label", { class: "check" }, box, h("span", {}, label)) };
}

/** Says something to those who listen rather than look. */
export function announce(words) {
  document.getElementById("live").textContent = words;
}

/** A small button. */
export const button = (words, onclick, more = {}) => h("button", { type: "button", class: "small", onclick, ...more }, words);

/** Copies a text; where the browser refuses, it is shown to be copied by hand. */
export async function copy(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    announce(`${what}: copied`);
  } catch {
    prompt(what, text);
  }
}

/** A cell that no spreadsheet takes for a formula. */
export const harmless = (cell) => (typeof cell === "string" && /^[=+\-@\t\r]/.test(cell) ? `'${cell}` : String(cell ?? ""));

/** Rows of cells as a spreadsheet takes them from the clipboard. */
export const tabbed = (rows) => rows.map((row) => row.map((cell) => harmless(cell).replace(/\s+/g, " ")).join("\t")).join("\n");
