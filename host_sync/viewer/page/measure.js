// The panel that measures: tools, surface operations, what was drawn with its numbers and limits, charts, recipe file.

import * as api from "./api.js";
import { figures } from "./charts.js";
import { announce, button, check, copy, field, h, tabbed } from "./dom.js";
import { ItemCard, SURFACE } from "./measure_card.js";
import { RecipeHistory } from "./recipe_history.js";
import { KINDS } from "./recipe_shapes.js";
import { Shapes } from "./shapes.js";

const TOOLS = [["region", "Region"], ...Object.entries(KINDS).map(([kind, { words }]) => [kind, words]), ["mask", "Mask"],
  ["points", "Level: points"], ["level line", "Level: line"], ["level plane", "Level: plane"]];
const FORMS = ["plane", "none", "mean", "sphere", "polynomial-2", "polynomial-3", "polynomial-4", "polynomial-5"];
const GROUPS = ["height", "hybrid", "spatial", "functional"];
const CALM_MS = 400;
export const KEPT = "retrograph recipe";

export class MeasurePanel {
  /** stage : the relief; drawer : element for the charts */
  constructor(stage, drawer) {
    this.stage = stage;
    this.drawer = drawer;
    this.history = new RecipeHistory();
    this.shapes = new Shapes(stage, this.history, (whole) => this.changed(whole));
    stage.shapes = this.shapes;
    this.cards = new Map();
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.status = h("p", { class: "hint", role: "status" });
    this.list = h("ul", { class: "items" });
    this.doubts = h("p", { class: "warning", hidden: true });
    this.element = h("div", { class: "sections" }, this.toolSection(), this.surfaceSection(), this.numberSection(), this.recipeSection());
    this.keys = (event) => this.key(event);
  }

  toolSection() {
    this.tools = new Map(TOOLS.map(([tool, words]) => [tool, h("button", { type: "button", class: "small", "aria-pressed": "false",
      onclick: () => this.choose(this.shapes.tool === tool ? null : tool) }, words)]));
    this.brush = h("input", { type: "number", min: 1, step: "any", value: Math.round(this.shapes.brush_um),
      onchange: () => (this.shapes.brush_um = Math.max(1, Number(this.brush.value) || 1)) });
    this.placing = h("button", { type: "button", class: "small", disabled: true, onclick: () => this.shapes.place() }, "Place in the middle");
    const act = (words, act) => h("button", { type: "button", class: "small", disabled: true, onclick: act }, words);
    this.undo = act("Undo", () => this.step(-1));
    this.redo = act("Redo", () => this.step(1));
    return section("Measure with", h("p", { class: "hint" }, "Choose a tool, then drag on the relief. Handles move what was drawn."),
      h("div", { class: "row", role: "group", "aria-label": "Tools" }, ...this.tools.values()),
      field("Brush", this.brush, { unit: "µm" }), h("div", { class: "row" }, this.placing, this.undo, this.redo));
  }

  surfaceSection() {
    const set = (part) => this.commit({ ...this.history.recipe, ...part });
    const choice = (name, options, words) => {
      const select = h("select", { onchange: () => set({ [name]: select.value }) }, options.map(([value, text]) => h("option", { value }, text)));
      return [select, field(words, select)];
    };
    const number = (name, words) => {
      const input = h("input", { type: "number", min: 0, step: "any", placeholder: "none",
        onchange: () => set({ [name]: Number(input.value) > 0 ? Number(input.value) : null }) });
      return [input, field(words, input, { unit: "µm" })];
    };
    const [form, formField] = choice("form", FORMS.map((one) => [one, one]), "Form");
    const [level, levelField] = [h("select", { onchange: () => set({ level: level.value === "skin" ? { on: "skin" } : null }) },
      [["", "as it is"], ["skin", "untouched skin"], ["drawn", "as drawn"]].map(([value, text]) => h("option", { value }, text))), null];
    const [s, sField] = number("s_filter_um", "S-filter");
    const [l, lField] = number("l_filter_um", "L-filter");
    const pitch = h("input", { type: "number", min: 0, max: 50, step: "any", placeholder: "as measured", onchange: () => {
      const share = Number(pitch.value) > 0 ? Number(pitch.value) / 100 : null;
      set({ scale: { ...this.history.recipe.scale, pixel_pitch_share: share } });
    } });
    const groups = GROUPS.map((group) => check(group, group === "height", (on) => {
      const now = this.history.recipe.parameters ?? GROUPS;
      set({ parameters: on ? [...now, group] : now.filter((one) => one !== group) });
    }));
    const spectrum = check("power spectrum", false, (on) => set({ spectrum: on || null }));
    const beyond = check("slopes beyond the balls'", false, (on) => set({ keep_extrapolated: on || null }));
    const factor = h("select", { onchange: () => set({ coverage_factor: Number(factor.value) }) }, [1, 2].map((k) => h("option", { value: k }, `k = ${k}`)));
    this.show = () => {
      const { recipe } = this.history;
      form.value = recipe.form ?? "plane";
      level.value = recipe.level ? (recipe.level.on === "skin" ? "skin" : "drawn") : "";
      level.lastChild.disabled = level.value !== "drawn";
      s.value = recipe.s_filter_um ?? "";
      l.value = recipe.l_filter_um ?? "";
      factor.value = recipe.coverage_factor ?? 1;
      const share = recipe.scale?.pixel_pitch_share;
      pitch.value = share ? Number((100 * share).toPrecision(6)) : "";
      groups.forEach(({ box }, at) => (box.checked = (recipe.parameters ?? GROUPS).includes(GROUPS[at])));
      spectrum.box.checked = Boolean(recipe.spectrum);
      beyond.box.checked = Boolean(recipe.keep_extrapolated);
      this.undo.disabled = !this.history.canUndo;
      this.redo.disabled = !this.history.canRedo;
    };
    return section("Surface", levelField ?? field("Level on", level), formField, sField, lField, field("± is", factor),
      field("± of the pixel pitch", pitch, { unit: "%" }),
      h("fieldset", { class: "checks" }, h("legend", {}, "Parameters"), ...groups.map(({ element }) => element), spectrum.element, beyond.element));
  }

  numberSection() {
    this.copying = button("Copy numbers", () => copy(tabbed([["", "", "value", "±", "unit", "verdict"], ...this.found.quantities.map((one) =>
      [one.subject, one.name, one.value, one.uncertainty, one.unit, one.limits?.verdict])]), "Numbers"), { disabled: true });
    return section("Numbers", this.status, this.problem, this.doubts, this.list, h("div", { class: "row" }, this.copying));
  }

  recipeSection() {
    const file = h("input", { type: "file", accept: ".toml", onchange: () => {
      if (file.files.length) this.load(file.files[0]);
      file.value = "";
    } });
    this.saved = h("a", { class: "small button", download: "recipe.toml", hidden: true }, "Save recipe");
    this.many = h("button", { type: "button", class: "small", disabled: true, onclick: () => {
      sessionStorage.setItem(KEPT, this.found.text);
      location.hash = "#/batch";
    } }, "Measure many scans …");
    return section("Recipe", h("p", { class: "hint" }, "The file of retrosync measure and report: --recipe recipe.toml"),
      field("Open", file), h("div", { class: "row" }, this.saved, this.many));
  }

  /** Call when the panel is shown first. */
  start() {
    document.addEventListener("keydown", this.keys);
    this.changed(true);
  }

  key(event) {
    if (!(event.ctrlKey || event.metaKey) || event.target.matches("input:not([type=checkbox]), textarea") || this.element.hidden) return;
    const steps = { z: event.shiftKey ? 1 : -1, Z: 1, y: 1 }[event.key];
    if (!steps) return;
    event.preventDefault();
    this.step(steps);
  }

  step(steps) {
    this.history.move(steps);
    this.changed(true);
    announce(steps < 0 ? "Undone" : "Redone");
  }

  choose(tool) {
    this.shapes.tool = tool;
    for (const [name, button] of this.tools) button.setAttribute("aria-pressed", String(name === tool));
    this.placing.disabled = !tool;
    this.stage.choose(tool ? "measure" : "move");
  }

  /** Another tool of the stage was chosen. */
  left() {
    if (this.shapes.tool) this.choose(null);
  }

  commit(recipe) {
    this.history.commit(recipe);
    this.changed(true);
  }

  changed(whole) {
    this.stage.overlay();
    if (whole) this.show();
    this.layOut();
    this.ask();
  }

  /** Cards for what the recipe has; those that stay keep their focus. */
  layOut() {
    const { recipe } = this.history;
    const wanted = [SURFACE, ...Object.keys(KINDS).flatMap((kind) => (recipe[kind] ?? []).map((item, index) => ({ kind, index, name: item.name })))];
    const names = new Set(wanted.map(({ name }) => name));
    for (const [name, card] of this.cards) {
      if (names.has(name)) continue;
      card.element.remove();
      this.cards.delete(name);
    }
    wanted.forEach((one, at) => {
      if (!this.cards.has(one.name)) this.cards.set(one.name, new ItemCard(one, this));
      const card = this.cards.get(one.name);
      card.place = one;
      if (this.list.children[at] !== card.element) this.list.insertBefore(card.element, this.list.children[at] ?? null);
      card.show(recipe, this.found);
    });
  }

  /** Ask for numbers: at once without ±, with ± when nothing changes any more. One question at a time, the latest wins. */
  async ask() {
    clearTimeout(this.timer);
    this.wanted = JSON.stringify(this.history.recipe);
    if (this.wanted !== this.done) this.element.dataset.ready = "no";
    if (this.asking) return;
    this.asking = true;
    while (this.wanted !== this.done && !this.gone) await this.answer(this.wanted, false);
    this.asking = false;
    if (this.stage.facts.has_samples) this.timer = setTimeout(() => this.askWhole(), CALM_MS);
  }

  async askWhole() {
    if (this.asking || this.gone) return;
    this.asking = true;
    this.status.textContent = "± is computed …";
    await this.answer(this.wanted, true);
    this.asking = false;
    if (this.wanted !== this.done) this.ask();
  }

  async answer(recipe, samples) {
    try {
      const found = await api.measure(this.stage.facts.key, this.stage.relief.page, JSON.parse(recipe), samples);
      if (this.gone) return;
      this.done = recipe;
      if (recipe === this.wanted) this.take(found);
    } catch (error) {
      this.done = recipe;
      this.problem.textContent = error.message;
      this.problem.hidden = false;
      this.status.textContent = "";
    }
  }

  take(found) {
    this.found = this.shapes.found = found;
    this.problem.hidden = true;
    found.whole = found.samples || !this.stage.facts.has_samples;
    this.status.textContent = found.whole ? found.notes.join(". ") : "± follows";
    this.element.dataset.ready = found.whole ? "yes" : "no";
    this.doubts.hidden = !found.doubts.length;
    this.doubts.textContent = `Doubt: ${found.doubts.join("; ")}`;
    if (this.address) URL.revokeObjectURL(this.address);
    this.address = URL.createObjectURL(new Blob([found.text], { type: "application/toml" }));
    this.saved.href = this.address;
    this.saved.hidden = this.many.disabled = this.copying.disabled = false;
    if (!found.samples || !this.stage.facts.has_samples || !this.drawer.childElementCount) this.drawer.replaceChildren(...figures(found));
    this.drawer.hidden = !this.drawer.childElementCount;
    this.layOut();
    this.stage.overlay();
    if (found.whole) announce("Numbers are complete");
  }

  /** Take the recipe of a file. */
  async load(file) {
    try {
      if (!file.name.endsWith(".toml")) throw new Error(`${file.name} is no recipe: a recipe is a .toml file`);
      const found = await api.measure(this.stage.facts.key, this.stage.relief.page, { text: await file.text() }, false);
      const kept = Object.entries(found.recipe).filter(([name, value]) => value !== null && name !== "scale");
      if (found.recipe.scale && Object.values(found.recipe.scale).some((share) => share !== null)) kept.push(["scale", found.recipe.scale]);
      this.commit(Object.fromEntries(kept));
    } catch (error) {
      this.problem.textContent = error.message;
      this.problem.hidden = false;
    }
  }

  dispose() {
    this.gone = true;
    clearTimeout(this.timer);
    document.removeEventListener("keydown", this.keys);
    if (this.address) URL.revokeObjectURL(this.address);
  }
}

function section(title, ...children) {
  return h("details", { open: true }, h("summary", {}, title), h("div", { class: "inside" }, ...children));
}
