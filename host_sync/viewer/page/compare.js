// Two scans side by side under one light, moving together, or their difference after registration.

import * as api from "./api.js";
import { announce, field, h } from "./dom.js";
import { length, micrometres, percent } from "./format.js";
import { firstLook, LookPanel } from "./look.js";
import { Stage } from "./stage.js";
import { nameOf } from "./scan.js";

export async function comparePage(first, second, palettes) {
  const both = await Promise.all([api.facts(first), api.facts(second)]);
  return new ComparePage(both, palettes);
}

class ComparePage {
  constructor(both, palettes) {
    this.both = both;
    this.palettes = palettes;
    this.title = `${both[0].title} and ${both[1].title}`;
    this.look = this.commonLook();
    this.stages = both.map((facts, index) => new Stage(facts, this.look, palettes, {
      label: facts.title, first: index === 0, onlight: () => this.panel.changed(), onview: (eye) => this.follow(index, eye),
    }));
    this.panel = new LookPanel({ ...both[0], low_um: this.look.low, high_um: this.look.high }, this.look,
      { onchange: () => this.apply() });
    this.words = h("p", { class: "found", role: "status" }, "Looking for the shift …");
    this.views = ["Side by side", "Difference"].map((name, index) => h("button", {
      type: "button", "aria-pressed": String(index === 0), onclick: () => this.choose(index) }, name));
    this.views[1].disabled = true;
    this.side = h("div", { class: "side" }, this.stages.map((stage, index) => h("figure", {}, h("figcaption", {},
      nameOf(both[index])), stage.element)));
    this.alone = h("div", { class: "alone", hidden: true });
    this.panelBox = h("aside", { class: "panel", "aria-label": "How it is shown" }, this.panel.element, this.hand());
    this.element = h("div", { class: "scan compare" }, h("div", { class: "view" }, h("h1", { class: "unseen" }, this.title),
      h("div", { class: "head" }, h("div", { class: "set", role: "group", "aria-label": "What is shown" }, ...this.views), this.words),
      this.side, this.alone), this.panelBox);
  }

  commonLook() {
    const looks = this.both.map(firstLook);
    const low = Math.min(...looks.map((look) => look.low));
    const high = Math.max(...looks.map((look) => look.high));
    return { ...looks[0], low, high, exaggeration: Math.min(...looks.map((look) => look.exaggeration)) };
  }

  start() {
    for (const stage of this.stages) stage.start(this.palettes);
    this.register();
  }

  /** The shift by hand: near it the best place is looked for, or it is taken as it is. */
  hand() {
    const number = (step) => h("input", { type: "number", step, value: 0 });
    this.typed = { down_um: number(1), right_um: number(1), turn_deg: number(0.01) };
    const button = (words, pinned) => h("button", { type: "button", class: "small", onclick: () => this.register({
      ...Object.fromEntries(Object.entries(this.typed).map(([name, input]) => [name, input.value || "0"])), pinned }) }, words);
    return h("details", { class: "hand" }, h("summary", {}, "Shift by hand"), h("div", { class: "inside" },
      h("p", { class: "hint" }, "Where the object lies in the second scan, relative to the first."),
      field("Down, µm", this.typed.down_um), field("Right, µm", this.typed.right_um),
      field("Clockwise, degrees", this.typed.turn_deg),
      h("div", { class: "row" }, button("Register near it", "0"), button("Take it as it is", "1"))));
  }

  fill(pose) {
    for (const [name, input] of Object.entries(this.typed)) input.value = pose[name].toFixed(name === "turn_deg" ? 3 : 1);
  }

  async register(near = {}) {
    this.words.textContent = "Looking for the shift …";
    try {
      const found = await api.compare(this.both[0].key, this.both[1].key, near);
      if (this.gone) return;
      if (found.refused) {
        this.withdraw();
        this.words.replaceChildren(h("strong", { class: "warning" }, `${found.refused}.`));
        this.fill(found.best);
        this.panelBox.querySelector("details.hand").open = true;
        return;
      }
      await this.registered(found);
    } catch (error) {
      this.words.textContent = error.message;
    }
  }

  /** Without a registration there is no difference to show, and views are linked as the scans lie. */
  withdraw() {
    this.choose(0);
    this.views[1].disabled = true;
    this.single?.dispose();
    this.single = this.shift = this.difference = null;
    this.alone.replaceChildren();
  }

  async registered(found) {
    this.difference = await api.facts(found.key);
    const { record } = found;
    const [down, right] = record.shift_um;
    const way = (um, more, less) => `${length(Math.abs(um))} ${um >= 0 ? more : less}`;
    this.fill({ down_um: down, right_um: right, turn_deg: record.turn_deg });
    if (this.single) {
      this.single.dispose();
      this.single = null;
      this.alone.replaceChildren();
      if (!this.alone.hidden) this.choose(1);
    }
    this.shift = { row: down / this.both[1].pitch_um, column: right / this.both[1].pitch_um };
    this.words.textContent = `The second lies ${way(down, "down", "up")}, ${way(right, "right", "left")}, turned by ` +
      `${record.turn_deg.toFixed(2).replace("-", "−")}° (found by: ${record.registered_by}, shift ` +
      `${Number.isFinite(record.shift_sigma_um) ? `± ${length(record.shift_sigma_um)}` : "of unknown ±"}, slopes agree by ` +
      `${percent(record.agreement_share)}). After levelling ${micrometres(record.residual_um)} rms remain ` +
      `(median ${micrometres(record.median_um)}) over ${percent(record.overlap_share)} of the first, ` +
      (Number.isFinite(record.height_sigma_median_um)
        ? `where the difference is known to ± ${micrometres(record.height_sigma_median_um)} (k = 1, median; both scans' ± together).`
        : "and no ± is known, as one of them states none.");
    const warnings = (found.doubts ?? []).map((words) => h("strong", { class: "warning" }, ` Doubt: ${words}.`));
    this.words.append(...warnings);
    this.views[1].disabled = false;
    this.follow(0, this.stages[0].relief.eye);
  }

  apply() {
    for (const stage of this.stages) if (stage.relief) stage.apply();
  }

  /** Move the other view to the same place. */
  follow(moved, eye) {
    const other = this.stages[1 - moved].relief;
    if (!other) return;
    const factor = this.both[moved].pitch_um / this.both[1 - moved].pitch_um;
    const middle = (facts) => ({ row: (facts.rows - 1) / 2, column: (facts.columns - 1) / 2 });
    const [here, there] = [middle(this.both[moved]), middle(this.both[1 - moved])];
    const sign = moved === 0 ? 1 : -1;
    const shift = this.shift ?? { row: 0, column: 0 };
    const scaled = moved === 0 ? 1 : factor;
    for (const side of ["row", "column"]) {
      other.eye.centre[side] = there[side] + (eye.centre[side] - here[side]) * factor + sign * shift[side] * scaled;
    }
    other.eye.zoom = eye.zoom / factor;
    other.eye.distance = eye.distance * factor;
    Object.assign(other.eye, { azimuth: eye.azimuth, elevation: eye.elevation });
    if (other.eye.space !== eye.space) {
      other.eye.space = eye.space;
      this.stages[1 - moved].spaceButton.setAttribute("aria-pressed", String(eye.space));
    }
    other.draw();
  }

  choose(index) {
    this.views.forEach((button, at) => button.setAttribute("aria-pressed", String(at === index)));
    this.side.hidden = index === 1;
    this.alone.hidden = index === 0;
    if (index === 1 && !this.single) this.openDifference();
    this.sameView(index);
    this.panelBox.firstChild.replaceWith((index === 1 ? this.singlePanel : this.panel).element);
    announce(index === 1 ? "The difference, second minus first" : "Side by side");
  }

  /** The difference lies on the grid of the first: both show the same place, whichever is turned to. */
  sameView(index) {
    const [from, to] = index === 1 ? [this.stages[0], this.single] : [this.single, this.stages[0]];
    if (!from?.relief || !to?.relief) return;
    const { centre, zoom, distance, azimuth, elevation, space } = from.relief.eye;
    Object.assign(to.relief.eye, { centre: { ...centre }, zoom, distance, azimuth, elevation, space });
    to.spaceButton.setAttribute("aria-pressed", String(space));
    to.relief.draw();
    if (index === 0) this.follow(0, to.relief.eye);
  }

  openDifference() {
    const look = firstLook(this.difference);
    this.single = new Stage(this.difference, look, this.palettes, {
      label: "Difference", onlight: () => this.singlePanel.changed() });
    this.singlePanel = new LookPanel(this.difference, look, { onchange: () => this.single.relief && this.single.apply() });
    this.alone.append(this.single.element);
    this.single.start(this.palettes);
  }

  dispose() {
    this.gone = true;
    for (const stage of [...this.stages, this.single]) stage?.dispose();
  }
}
