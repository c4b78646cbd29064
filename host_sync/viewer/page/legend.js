// Legend of the stage: colour bar in µm and scale bar.

import { h, svg } from "./dom.js";
import { length, plain, roundBelow, ticks } from "./format.js";

const BAR_WIDTH = 190;

export class ColourLegend {
  constructor(palettes) {
    this.palettes = palettes;
    this.canvas = h("canvas", { width: 256, height: 1, class: "ramp", "aria-hidden": "true" });
    this.marks = svg("svg", { viewBox: `0 0 ${BAR_WIDTH} 20`, class: "marks", "aria-hidden": "true" });
    this.title = h("span", { class: "legend-title" });
    this.element = h("div", { class: "legend" }, this.title, this.canvas, this.marks);
  }

  /** Show a range of µm in the colours of a palette; null hides it. */
  show(name, low, high, title) {
    this.element.hidden = name === null;
    if (name === null) return;
    const context = this.canvas.getContext("2d");
    const data = context.createImageData(256, 1);
    this.palettes[name].forEach((colour, index) => data.data.set([...colour, 255], 4 * index));
    context.putImageData(data, 0, 0);
    this.title.textContent = title;
    const at = (value) => ((value - low) / (high - low)) * BAR_WIDTH;
    this.marks.replaceChildren(...ticks(low, high, 5).flatMap((value) => [
      svg("line", { x1: at(value), x2: at(value), y1: 0, y2: 4 }),
      words(Math.min(BAR_WIDTH - 8, Math.max(8, at(value))), 16, plain(value)),
    ]));
    this.element.setAttribute("aria-label", `${title}: colours from ${plain(low)} to ${plain(high)}`);
    this.element.setAttribute("role", "img");
  }
}

function words(x, y, text) {
  const element = svg("text", { x, y, "text-anchor": "middle" });
  element.textContent = text;
  return element;
}

export class ScaleBar {
  constructor() {
    this.words = h("span", {});
    this.bar = h("span", { class: "bar-line" });
    this.element = h("div", { class: "scale-bar" }, this.bar, this.words);
  }

  /** um: length of a screen pixel, µm; null hides it. */
  show(um) {
    this.element.hidden = um === null;
    if (um === null) return;
    const long = roundBelow(um * 150);
    this.bar.style.width = `${long / um}px`;
    this.words.textContent = length(long);
  }
}

