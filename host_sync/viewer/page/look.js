// Appearance of a relief, and the panel that changes it.

import { check, field, h } from "./dom.js";
import { plain, roundBelow } from "./format.js";
import { LightDial } from "./light_dial.js";

const PLEASANT_SLOPE = 0.35;
const MAX_EXAGGERATION = 20;

/** The initial appearance. */
export function firstLook(facts) {
  const isDifference = facts.kind === "difference";
  const end = Math.max(Math.abs(facts.low_um), Math.abs(facts.high_um));
  const [low, high] = isDifference ? [-end, end] : [facts.low_um, facts.high_um];
  return {
    azimuth: 135,
    elevation: 40,
    exaggeration: Math.min(MAX_EXAGGERATION, Math.max(1, Math.round(PLEASANT_SLOPE / Math.max(facts.steep, 1e-6)))),
    colour: "height",
    palette: isDifference ? "difference" : "relief",
    shading: !isDifference,
    low,
    high,
    curves: false,
    interval: roundBelow((high - low) / 12),
    uncertainty: false,
    hatch: true,
  };
}

/** The panel; `onchange` is called with the look on each change, `onuncertainty` before ± is first shown. */
export class LookPanel {
  constructor(facts, look, { onchange, onframe = null, onuncertainty = null }) {
    this.look = look;
    this.facts = facts;
    this.onchange = onchange;
    this.dial = new LightDial(look, () => this.changed());
    this.parts = [];
    const number = (name, label, unit, { min = null, step = "any" } = {}) => {
      const input = h("input", { type: "number", step, min, onchange: () => this.take(name, input) });
      this.parts.push(() => (input.value = plainNumber(look[name])));
      return field(label, input, { unit });
    };
    const choice = (name, label, options) => {
      const select = h("select", { onchange: () => this.set({ [name]: select.value }) },
        options.map(([value, words]) => h("option", { value }, words)));
      this.parts.push(() => (select.value = look[name]));
      return field(label, select);
    };
    const toggle = (name, label) => {
      const { box, element } = check(label, look[name], (on) => this.set({ [name]: on }));
      this.parts.push(() => (box.checked = look[name]));
      return element;
    };
    const slider = h("input", {
      type: "range", min: 0, max: 100, step: 1,
      oninput: () => this.set({ exaggeration: fromSlider(Number(slider.value)) }),
    });
    const factor = h("output", { class: "unit wide" });
    this.parts.push(() => {
      slider.value = toSlider(look.exaggeration);
      factor.textContent = `×${plain(Number(look.exaggeration.toPrecision(3)))}`;
      slider.setAttribute("aria-valuetext", `heights times ${plain(Number(look.exaggeration.toPrecision(3)))}`);
    });
    const exaggeration = field("Exaggerate", slider);
    exaggeration.append(factor);
    const colours = [["height", "Heights"], ["white", "White plaster"]];
    if (onframe) colours.push(["frame", "Frame"]);
    const palettes = facts.kind === "difference"
      ? [["difference", "Blue – orange"], ["cividis", "Cividis"], ["grey", "Grey"]]
      : [["relief", "Relief"], ["cividis", "Cividis"], ["viridis", "Viridis"], ["grey", "Grey"]];
    this.element = h("div", { class: "sections" },
      section("Light", this.dial.element),
      section("Surface",
        choice("colour", "Colour by", colours),
        choice("palette", "Palette", palettes),
        exaggeration,
        h("div", { class: "pair" }, number("low", "From", "µm"), number("high", "To", "µm")),
        h("div", { class: "row" }, toggle("shading", "Shading"),
          h("button", { type: "button", class: "small", onclick: () => this.reset() }, "Reset"))),
      section("Overlays",
        toggle("curves", "Level curves"),
        number("interval", "Every", "µm", { min: 0 }),
        onuncertainty ? toggle("uncertainty", "Uncertainty ±") : h("p", { class: "hint" }, "No ± is known here."),
        toggle("hatch", "Hatch invalid pixels")),
    );
    this.before = { frame: onframe, uncertainty: onuncertainty };
    this.show();
  }

  /** Change parts of the look. */
  async set(part) {
    Object.assign(this.look, part);
    this.changed();
    if (part.colour === "frame" && this.before.frame) await this.before.frame();
    if (part.uncertainty && this.before.uncertainty) await this.before.uncertainty();
    this.changed();
  }

  take(name, input) {
    const value = Number(input.value);
    const next = { ...this.look, [name]: value };
    if (input.value !== "" && Number.isFinite(value) && next.low < next.high && next.interval > 0) this.set({ [name]: value });
    else this.show();
  }

  reset() {
    const { azimuth, elevation } = this.look;
    this.set({ ...firstLook(this.facts), azimuth, elevation, curves: this.look.curves });
  }

  changed() {
    this.show();
    this.onchange(this.look);
  }

  show() {
    for (const part of this.parts) part();
    this.dial.show();
  }
}

function section(title, ...children) {
  return h("details", { open: true }, h("summary", {}, title), h("div", { class: "inside" }, ...children));
}

const toSlider = (factor) => Math.round((100 * Math.log(factor)) / Math.log(50));
const fromSlider = (place) => (place === 0 ? 1 : Number((50 ** (place / 100)).toPrecision(3)));
const plainNumber = (value) => Number(value.toPrecision(4));
