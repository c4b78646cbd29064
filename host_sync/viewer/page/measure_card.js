// What is measured at one place: its name, places that can be typed, numbers with limits and verdicts.

import { field, h } from "./dom.js";
import { numberText } from "./format.js";
import { KINDS, numbers } from "./recipe_shapes.js";

export const SURFACE = { kind: "surface", index: 0, name: "surface" };
const VERDICTS = { pass: "✓ pass", fail: "✗ fail", undecided: "? undecided" };
const STEP_KINDS = ["step", "groove", "ridge"];

export class ItemCard {
  /** place : { kind, index, name }; panel : takes the changed recipe */
  constructor(place, panel) {
    this.place = place;
    this.panel = panel;
    this.rows = new Map();
    this.table = h("div", { class: "rows" });
    this.inputs = [];
    const head = place.kind === "surface" ? h("h2", {}, "Surface") : this.head();
    this.places = h("div", { class: "pair" });
    this.details = h("details", { class: "places" }, h("summary", {}, "Places, µm"), this.places);
    this.details.hidden = place.kind === "surface";
    this.shared = h("p", { class: "warning", hidden: true });
    this.element = h("li", { class: "item" }, head, this.table, this.shared, this.details);
  }

  head() {
    const { kind, name } = this.place;
    this.label = h("input", { type: "text", maxlength: 80, value: name, "aria-label": `Name of ${name}`, onchange: () => this.rename() });
    const remove = h("button", { type: "button", class: "small quiet", "aria-label": `Remove ${name}`, onclick: () => this.remove() }, "Remove");
    const parts = [this.label, h("span", { class: "unit" }, KINDS[kind].words), remove];
    if (kind === "step") {
      this.kind = h("select", { "aria-label": `Kind of ${name}`, onchange: () => this.change({ kind: this.kind.value }) },
        STEP_KINDS.map((one) => h("option", { value: one }, one)));
      parts[1] = this.kind;
    }
    return h("div", { class: "item-head" }, ...parts);
  }

  get item() {
    const { kind, index } = this.place;
    return this.panel.history.recipe[kind][index];
  }

  change(part) {
    const { kind, index } = this.place;
    const { recipe } = this.panel.history;
    const items = recipe[kind].map((item, at) => (at === index ? { ...item, ...part } : item));
    this.panel.commit({ ...recipe, [kind]: items });
  }

  rename() {
    const { recipe } = this.panel.history;
    const next = this.label.value.trim();
    const used = Object.keys(KINDS).some((kind) => (recipe[kind] ?? []).some((item) => item.name === next));
    if (!next || used || next === SURFACE.name) {
      this.label.value = this.place.name;
      return;
    }
    const old = this.place.name;
    const { kind, index } = this.place;
    this.panel.commit({ ...recipe, [kind]: recipe[kind].map((item, at) => (at === index ? { ...item, name: next } : item)),
      tolerance: (recipe.tolerance ?? []).map((one) => (one.of === old ? { ...one, of: next } : one)) });
  }

  remove() {
    const { kind, index, name } = this.place;
    const { recipe } = this.panel.history;
    this.panel.commit({ ...recipe, [kind]: recipe[kind].filter((_, at) => at !== index),
      tolerance: (recipe.tolerance ?? []).filter((one) => one.of !== name) });
  }

  /** Limits of a number: low and high, null for none. */
  limit(number, end, value) {
    const { recipe } = this.panel.history;
    const of = this.place.name;
    const others = (recipe.tolerance ?? []).filter((one) => one.of !== of || one.number !== number);
    const old = (recipe.tolerance ?? []).find((one) => one.of === of && one.number === number) ?? { of, number };
    const next = Object.fromEntries(Object.entries({ ...old, [end]: value }).filter(([, one]) => one !== null));
    this.panel.commit({ ...recipe, tolerance: "low" in next || "high" in next ? [...others, next] : others });
  }

  show(recipe, found) {
    const { kind, name } = this.place;
    if (kind !== "surface") {
      if (this.kind) this.kind.value = this.item.kind ?? "step";
      this.showPlaces();
    }
    const shown = (found?.quantities ?? []).filter((one) => one.subject === name);
    const names = shown.map((one) => one.name);
    if (names.join("|") !== [...this.rows.keys()].join("|")) {
      this.rows = new Map(shown.map((one) => [one.name, this.row(one)]));
      this.table.replaceChildren(...[...this.rows.values()].map(({ element }) => element));
    }
    const known = found?.doubts ?? [];
    const common = shown.length > 1 ? shown[0].doubts.filter((words) => shown.every((one) => one.doubts.includes(words))) : [];
    this.hidden = [...known, ...common];
    const said = common.filter((words) => !known.includes(words) && !words.startsWith("±"));
    this.shared.hidden = !said.length;
    this.shared.textContent = said.join("; ");
    for (const one of shown) this.fill(this.rows.get(one.name), one, found.whole, recipe);
  }

  row({ name, unit }) {
    const value = h("span", { class: "value" });
    const verdict = h("span", { class: "verdict" });
    const words = h("p", { class: "warning", hidden: true });
    const limits = ["low", "high"].map((end) => {
      const input = h("input", { type: "number", step: "any", placeholder: end === "low" ? "at least" : "at most",
        "aria-label": `${name} of ${this.place.name}: ${end === "low" ? "at least" : "at most"}${unit ? `, ${unit}` : ""}`,
        onchange: () => this.limit(name, end, input.value === "" ? null : Number(input.value)) });
      return input;
    });
    const element = h("div", { class: "number" }, h("span", { class: "quantity" }, name), value, verdict,
      h("span", { class: "limits" }, ...limits), words);
    return { element, value, verdict, words, limits };
  }

  fill(row, one, whole, recipe) {
    row.value.textContent = numberText(one, whole);
    const verdict = whole ? one.limits?.verdict : null;
    row.element.dataset.verdict = verdict ?? "";
    row.verdict.textContent = verdict ? VERDICTS[verdict] : "";
    const table = (recipe.tolerance ?? []).find(({ of, number }) => of === this.place.name && number === one.name);
    ["low", "high"].forEach((end, at) => {
      if (document.activeElement !== row.limits[at]) row.limits[at].value = table?.[end] ?? "";
    });
    // What a ± lacks is said beside a verdict that it keeps open.
    const own = one.doubts.filter((words) => (words.startsWith("±") ? verdict === "undecided" : !this.hidden.includes(words)));
    row.words.hidden = !own.length;
    row.words.textContent = own.join("; ");
  }

  showPlaces() {
    const { kind } = this.place;
    const wanted = numbers(kind, this.item);
    if (this.inputs.length !== wanted.length) {
      this.inputs = wanted.map(({ words }, at) => {
        const input = h("input", { type: "number", step: "any", onchange: () => {
          if (input.value !== "") this.change(numbers(kind, this.item)[at].changed(Number(input.value)));
        } });
        return { input, element: field(words, input) };
      });
      this.places.replaceChildren(...this.inputs.map(({ element }) => element));
    }
    wanted.forEach(({ value }, at) => {
      if (document.activeElement !== this.inputs[at].input) this.inputs[at].input.value = value;
    });
  }
}
