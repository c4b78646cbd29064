// Direction of the light: a dot on a dome seen from above, and two sliders.

import { field, h, svg } from "./dom.js";

const RADIUS = 46;

export class LightDial {
  constructor(look, onchange) {
    this.look = look;
    this.onchange = onchange;
    this.dot = svg("circle", { r: 7, class: "dot" });
    this.ray = svg("line", { x1: 0, y1: 0, class: "ray" });
    this.drawing = svg("svg", { viewBox: "-56 -56 112 112", class: "dial", "aria-hidden": "true" },
      svg("circle", { r: RADIUS, class: "rim" }), svg("circle", { r: RADIUS * Math.cos(Math.PI / 4), class: "ring" }),
      svg("path", { d: "M-46 0H46M0-46V46", class: "ring" }), this.ray, this.dot);
    this.azimuth = this.slider("azimuth", 0, 359);
    this.elevation = this.slider("elevation", 3, 90);
    this.element = h("div", { class: "light" }, this.drawing,
      h("div", {}, field("Direction", this.azimuth), field("Elevation", this.elevation)));
    const point = (event) => {
      const box = this.drawing.getBoundingClientRect();
      const scale = 56 / (box.width / 2);
      this.aim((event.clientX - box.left - box.width / 2) * scale, (event.clientY - box.top - box.height / 2) * scale);
    };
    this.drawing.addEventListener("pointerdown", (event) => {
      this.drawing.setPointerCapture(event.pointerId);
      point(event);
    });
    this.drawing.addEventListener("pointermove", (event) => event.buttons && point(event));
  }

  slider(name, min, max) {
    const input = h("input", { type: "range", min, max, step: 1, oninput: () => {
      this.look[name] = Number(input.value);
      this.onchange();
    } });
    return input;
  }

  /** The light at a place of the dome, right and down from its centre; the rim is the horizon. */
  aim(right, down, radius = RADIUS) {
    const far = Math.min(1, Math.hypot(right, down) / radius);
    this.look.azimuth = Math.round(((Math.atan2(-down, right) * 180) / Math.PI + 360) % 360);
    this.look.elevation = Math.max(3, Math.round((Math.acos(far) * 180) / Math.PI));
    this.onchange();
  }

  show() {
    const { azimuth, elevation } = this.look;
    const far = RADIUS * Math.cos((elevation * Math.PI) / 180);
    const [x, y] = [far * Math.cos((azimuth * Math.PI) / 180), -far * Math.sin((azimuth * Math.PI) / 180)];
    this.dot.setAttribute("cx", x);
    this.dot.setAttribute("cy", y);
    this.ray.setAttribute("x2", x);
    this.ray.setAttribute("y2", y);
    this.azimuth.value = azimuth;
    this.elevation.value = elevation;
    this.azimuth.setAttribute("aria-valuetext", `${azimuth}° counter-clockwise from the right`);
    this.elevation.setAttribute("aria-valuetext", `${elevation}° above the surface`);
  }
}
