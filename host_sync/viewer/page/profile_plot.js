// Profile plot: height over distance, ± as a band, and a reading at the pointer.

import { h, svg } from "./dom.js";
import { length, plain, ticks, withSigma } from "./format.js";

const LEFT = 62;
const RIGHT = 14;
const TOP = 12;
const BOTTOM = 38;

export class ProfilePlot {
  /** oncursor: called with the index of the point that is read, or null. */
  constructor(oncursor = () => {}) {
    this.oncursor = oncursor;
    this.drawing = svg("svg", { class: "plot" });
    this.summary = h("p", { class: "plot-summary" }, "Drag across the relief to draw a profile.");
    this.reading = h("p", { class: "plot-reading" });
    this.doubts = h("p", { class: "warning", hidden: true });
    this.slider = h("input", { type: "range", min: 0, max: 0, step: 1, value: 0, class: "plot-cursor",
      "aria-label": "Place along the profile", oninput: () => this.point(Number(this.slider.value)) });
    this.element = h("div", { class: "profile" }, h("div", { class: "plot-words" }, this.summary, this.reading),
      this.doubts, this.drawing, this.slider);
    this.drawing.addEventListener("pointermove", (event) => this.pointAt(event));
    this.drawing.addEventListener("pointerleave", () => this.point(null));
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.element);
  }

  show(found) {
    this.found = found;
    this.slider.max = found.z_um.length - 1;
    const total = found.distance_um.at(-1);
    const step = found.step_um === null ? "invalid" : withSigma(found.step_um, found.step_sigma_um);
    const known = found.z_um.filter((z) => z !== null);
    const range = known.length ? `, lowest to highest ${withSigma(max(known) - min(known), null)}` : "";
    this.summary.textContent = `Length ${length(total)}, end − beginning ${step}${range}`;
    this.doubts.hidden = !found.doubts.length;
    this.doubts.textContent = `Doubt: ${found.doubts.join("; ")}`;
    this.point(null);
    this.draw();
  }

  point(index) {
    this.cursor = index;
    if (!this.found) return;
    const { distance_um, z_um, sigma_um } = this.found;
    const words = index === null ? "" :
      `At ${length(distance_um[index])}: ${withSigma(z_um[index], sigma_um ? sigma_um[index] : null)}`;
    this.reading.textContent = words || (sigma_um ? "Band: ± one standard uncertainty" : "± is not known");
    if (index !== null) this.slider.value = index;
    this.slider.setAttribute("aria-valuetext", words || "no place chosen");
    this.moveCursor();
    this.oncursor(index);
  }

  pointAt(event) {
    if (!this.found) return;
    const box = this.drawing.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    const last = this.found.z_um.length - 1;
    this.point(Math.round(Math.min(1, Math.max(0, share)) * last));
  }

  draw() {
    const width = this.element.clientWidth;
    const height = Math.max(120, this.drawing.clientHeight || 170);
    if (!this.found || width < 50) return;
    const { distance_um, z_um, sigma_um } = this.found;
    const total = distance_um.at(-1);
    const upper = z_um.map((z, index) => (z === null ? null : z + ((sigma_um && sigma_um[index]) ?? 0)));
    const lower = z_um.map((z, index) => (z === null ? null : z - ((sigma_um && sigma_um[index]) ?? 0)));
    const known = (values) => values.filter((value) => value !== null);
    let [low, high] = known(z_um).length ? [min(known(lower)), max(known(upper))] : [0, 1];
    const room = Math.max((high - low) * 0.06, 1e-3);
    [low, high] = [low - room, high + room];
    this.x = (um) => LEFT + (um / total) * (width - LEFT - RIGHT);
    this.y = (um) => TOP + ((high - um) / (high - low)) * (height - TOP - BOTTOM);
    this.inside = { height };
    const milli = total >= 2000;
    this.drawing.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.drawing.replaceChildren(
      this.title(),
      ...ticks(low, high, Math.max(2, Math.floor(height / 42))).flatMap((value) => [
        svg("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: this.y(value), y2: this.y(value) }),
        word(LEFT - 8, this.y(value) + 4, plain(value), "end"),
      ]),
      ...ticks(0, total, Math.max(2, Math.floor(width / 90))).flatMap((value) => [
        svg("line", { class: "grid", x1: this.x(value), x2: this.x(value), y1: TOP, y2: height - BOTTOM }),
        word(this.x(value), height - BOTTOM + 17, plain(milli ? value / 1000 : value), "middle"),
      ]),
      word(LEFT + (width - LEFT - RIGHT) / 2, height - 4, `distance, ${milli ? "mm" : "µm"}`, "middle", "axis"),
      turned(13, TOP + (height - TOP - BOTTOM) / 2, "height, µm"),
      svg("path", { class: "band", d: sigma_um ? this.band(lower, upper) : "" }),
      svg("path", { class: "line", d: this.path(z_um) }),
      (this.mark = svg("g", { class: "mark" }, svg("line", { y1: TOP, y2: height - BOTTOM }), svg("circle", { r: 4 }))),
    );
    this.moveCursor();
  }

  title() {
    const element = svg("title");
    element.textContent = `Profile of ${this.found.title}`;
    return element;
  }

  moveCursor() {
    if (!this.mark) return;
    const z = this.cursor === null || this.cursor === undefined ? null : this.found.z_um[this.cursor];
    this.mark.setAttribute("visibility", z === null || z === undefined ? "hidden" : "visible");
    if (z === null || z === undefined) return;
    const x = this.x(this.found.distance_um[this.cursor]);
    this.mark.firstChild.setAttribute("x1", x);
    this.mark.firstChild.setAttribute("x2", x);
    this.mark.lastChild.setAttribute("cx", x);
    this.mark.lastChild.setAttribute("cy", this.y(z));
  }

  path(z_um) {
    const { distance_um } = this.found;
    let pen = "M";
    return z_um.map((z, index) => {
      if (z === null) {
        pen = "M";
        return "";
      }
      const piece = `${pen}${this.x(distance_um[index]).toFixed(2)} ${this.y(z).toFixed(2)}`;
      pen = "L";
      return piece;
    }).join("");
  }

  band(lower, upper) {
    const { distance_um } = this.found;
    let pieces = "";
    for (let first = 0; first < lower.length; first += 1) {
      if (lower[first] === null) continue;
      let last = first;
      while (last + 1 < lower.length && lower[last + 1] !== null) last += 1;
      const there = [];
      const back = [];
      for (let at = first; at <= last; at += 1) {
        const x = this.x(distance_um[at]).toFixed(2);
        there.push(`${x} ${this.y(upper[at]).toFixed(2)}`);
        back.push(`${x} ${this.y(lower[at]).toFixed(2)}`);
      }
      pieces += `M${there.join("L")}L${back.reverse().join("L")}Z`;
      first = last;
    }
    return pieces;
  }

  dispose() {
    this.observer.disconnect();
  }
}

const min = (values) => values.reduce((least, value) => Math.min(least, value), Infinity);
const max = (values) => values.reduce((most, value) => Math.max(most, value), -Infinity);

function word(x, y, text, anchor, kind = "tick") {
  const element = svg("text", { x, y, "text-anchor": anchor, class: kind });
  element.textContent = text;
  return element;
}

function turned(x, y, text) {
  const element = word(x, y, text, "middle", "axis");
  element.setAttribute("transform", `rotate(-90 ${x} ${y})`);
  return element;
}
