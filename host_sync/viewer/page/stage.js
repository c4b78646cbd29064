// A relief with its overlays: tools, legend, scale, reading, profile line; and its keys.

import { height as askHeight } from "./api.js";
import { announce, h, svg } from "./dom.js";
import { length, withSigma } from "./format.js";
import { listenToGestures } from "./gestures.js";
import { keysEverywhere } from "./keys.js";
import { ColourLegend, ScaleBar } from "./legend.js";
import { picture } from "./picture.js";
import { Relief } from "./relief.js";

const STEP_PX = 48;
const STEP_DEG = 6;

export class Stage {
  /**
   * look: of this relief, changed by the light tool through `onlight`
   * online: called with the line when its ends move; null when profiles are not drawn here
   * ontool: called with the tool that was chosen
   * onview: called when one of several linked views moves
   * first: whether keys are for this relief when none has the focus
   * height: gives { z_um } of a row and a column; by default as the server knows it
   */
  constructor(facts, look, palettes, { onlight, online = null, ontool = () => {}, onview = () => {}, label, first = true,
    height = (row, column) => askHeight(facts.key, this.relief.page, row, column) }) {
    this.facts = facts;
    this.look = look;
    this.onlight = onlight;
    this.online = online;
    this.moved = onview;
    this.ontool = ontool;
    this.tool = "move";
    this.line = null;
    this.shapes = null;
    this.first = first;
    this.height = height;
    this.keys = (event) => this.key(event);
    this.canvas = h("canvas", { tabindex: 0, role: "application", "aria-roledescription": "relief", "aria-label":
      `${label}: arrow keys move, plus and minus zoom, Shift with arrow keys moves the light, question mark lists all keys` });
    this.lines = svg("svg", { class: "lines", "aria-hidden": "true" });
    this.reading = h("p", { class: "reading" });
    this.doubts = h("p", { class: "warning doubts", hidden: !facts.doubts.length },
      `⚠ Doubt: ${facts.doubts.join("; ")}`);
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.legend = new ColourLegend(palettes);
    this.scale = new ScaleBar();
    this.cross = h("span", { class: "cross", "aria-hidden": "true" });
    this.surface = h("div", { class: "surface" }, this.canvas, this.lines, this.cross);
    this.element = h("div", { class: "stage" }, this.toolbar(), this.problem, this.surface,
      h("div", { class: "feet" }, this.legend.element, this.scale.element, this.reading, this.doubts));
    this.surface.dataset.tool = this.tool;
  }

  /** Call when the element is part of the page. */
  start(palettes) {
    this.relief = new Relief(this.canvas, this.facts, palettes, {
      onview: () => this.overlay(),
      oncoming: (level) => this.come(level),
      onerror: (error) => this.fail(error),
    });
    this.listen();
    this.apply();
    return this;
  }

  come(level) {
    this.element.dataset.level = level;
    if (level <= this.relief.wantedLevel) this.element.dataset.ready = "yes";
  }

  fail(error) {
    this.problem.textContent = error.message;
    this.problem.hidden = false;
  }

  apply() {
    this.relief.apply(this.look);
    const { look } = this;
    if (look.uncertainty && this.relief.sigmaHigh !== undefined) {
      this.legend.show("cividis", 0, this.relief.sigmaHigh, "Uncertainty ±, µm");
    } else if (look.colour === "height") {
      this.legend.show(look.palette, look.low, look.high, this.facts.kind === "difference" ? "Difference, µm" : "Height, µm");
    } else this.legend.show(null);
  }

  toolbar() {
    const button = (name, words, onclick, pressed = null) => {
      const element = h("button", { type: "button", "aria-pressed": pressed, onclick, title: words }, name);
      return element;
    };
    this.tools = new Map([
      ["move", button("Move", "Drag to move or turn (M)", () => this.choose("move"), "true")],
      ["light", button("Light", "Drag the light (L)", () => this.choose("light"), "false")],
    ]);
    if (this.online) this.tools.set("line", button("Profile", "Draw a profile (P)", () => this.choose("line"), "false"));
    this.spaceButton = button("3-D", "Map or space (3)", () => this.setSpace(!this.relief.eye.space), "false");
    return h("div", { class: "toolbar", role: "group", "aria-label": "View" },
      h("div", { class: "set" }, ...this.tools.values()),
      h("div", { class: "set" }, this.spaceButton),
      h("div", { class: "set" },
        button("Fit", "Show everything (0)", () => this.fit()),
        button("1:1", "A screen pixel for each pixel (1)", () => this.natural()),
        button("−", "Zoom out (−)", () => this.zoom(1 / 1.5)),
        button("+", "Zoom in (+)", () => this.zoom(1.5))),
      h("div", { class: "set" }, button("Save picture", "Save what is seen as a PNG", () => this.savePicture())));
  }

  async savePicture() {
    const name = `${this.facts.title.replace(/[^\p{L}\p{N}._-]+/gu, "_")}.png`;
    const href = URL.createObjectURL(await picture(this));
    h("a", { href, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(href), 60_000);
  }

  choose(tool) {
    if (["line", "measure"].includes(tool) && this.relief.eye.space) this.setSpace(false);
    this.tool = tool;
    this.surface.dataset.tool = tool;
    this.ontool(tool);
    for (const [name, button] of this.tools) button.setAttribute("aria-pressed", String(name === tool));
    announce({ move: "Dragging moves the view", light: "Dragging moves the light", line: "Dragging draws a profile",
      measure: "Dragging draws what is measured" }[tool]);
  }

  setSpace(space) {
    this.relief.setSpace(space);
    this.spaceButton.setAttribute("aria-pressed", String(space));
    if (["line", "measure"].includes(this.tool) && space) this.choose("move");
    announce(space ? "Seen in space" : "Seen as a map");
    this.changed();
  }

  fit() {
    this.relief.eye.fit();
    this.changed();
  }

  natural() {
    this.relief.eye.setScale(1 / this.relief.renderer.getPixelRatio());
    this.changed();
  }

  zoom(factor, x, y) {
    this.relief.eye.zoomAt(factor, x, y);
    this.changed();
  }

  changed() {
    this.relief.draw();
    this.moved(this.relief.eye);
  }

  listen() {
    const { eye } = this.relief;
    let action = "move";
    listenToGestures(this.surface, {
      begin: (at, event) => {
        if (event.button === 0 && !eye.space && this.shapes?.begin(this.inside(at), event)) {
          action = "shape";
          return;
        }
        action = event.button === 2 ? (eye.space ? "pan" : "light") : event.shiftKey && eye.space ? "pan" : this.tool;
        const end = event.target.dataset?.end;
        if (end) action = `end-${end}`;
        else if (action === "line") this.begun = this.inside(at);
        else if (action === "light") this.lightAt(at);
      },
      drag: (at, right, down) => {
        if (action === "light") this.lightAt(at);
        else if (action === "shape") this.shapes.move(this.inside(at));
        else if (action === "line") this.setLine({ from: this.begun, to: this.inside(at) });
        else if (action === "end-from" || action === "end-to") this.setLine({ ...this.line, [action.slice(4)]: this.inside(at) });
        else if (eye.space && action !== "pan") eye.orbit(-right * 0.35, down * 0.35);
        else eye.pan(right, down);
        if (action === "move" || action === "pan") this.changed();
      },
      pinch: (factor, at, right, down) => {
        eye.pan(right, down);
        this.zoom(factor, at.x, at.y);
      },
      hover: (at) => eye.space || this.read(eye.place(at.x, at.y)),
      leave: () => this.say(""),
      end: () => {
        if (action === "shape") this.shapes.end();
        action = "move";
      },
    });
    document.addEventListener("keydown", this.keys);
    this.canvas.addEventListener("focus", () => this.canvas.matches(":focus-visible") && this.readMiddle());
    this.canvas.addEventListener("blur", () => this.say(""));
  }

  /** Whether a key is for this relief: it has the focus, or it is in sight and nothing else takes the key. */
  hears(event) {
    const { target } = event;
    if (target === this.canvas) return true;
    if (!this.first || !keysEverywhere() || !this.canvas.checkVisibility() || document.querySelector("dialog[open]")) return false;
    if (target.matches("input, select, textarea") || target.closest("canvas")) return false;
    return !event.key.startsWith("Arrow") || !target.matches("button, a, summary, [tabindex='0']");
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.hears(event)) return;
    const { eye } = this.relief;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[event.key];
    const actions = {
      "+": () => this.zoom(1.25), "=": () => this.zoom(1.25), "-": () => this.zoom(0.8), 0: () => this.fit(),
      1: () => this.natural(), 3: () => this.setSpace(!eye.space), m: () => this.choose("move"),
      l: () => this.choose("light"), p: () => this.online && this.choose("line"),
    };
    if (arrow && event.shiftKey) {
      this.look.azimuth = (this.look.azimuth - STEP_DEG * arrow[0] + 360) % 360;
      this.look.elevation = Math.min(90, Math.max(3, this.look.elevation - STEP_DEG * arrow[1]));
      this.onlight();
    } else if (arrow) {
      if (eye.space) eye.orbit(-STEP_DEG * arrow[0], -STEP_DEG * arrow[1]);
      else eye.pan(-STEP_PX * arrow[0], -STEP_PX * arrow[1]);
      this.changed();
      this.readMiddle();
    } else if (actions[event.key]) actions[event.key]();
    else return;
    event.preventDefault();
  }

  lightAt(at) {
    const { width, height } = this.relief.eye.view;
    const [right, down, radius] = [at.x - width / 2, at.y - height / 2, Math.min(width, height) / 2];
    const far = Math.min(1, Math.hypot(right, down) / radius);
    this.look.azimuth = Math.round(((Math.atan2(-down, right) * 180) / Math.PI + 360) % 360);
    this.look.elevation = Math.max(3, Math.round((Math.acos(far) * 180) / Math.PI));
    this.onlight();
  }

  /** The pixel's place under a place of the screen, kept on the height map. */
  inside(at) {
    const { row, column } = this.relief.eye.place(at.x, at.y);
    return {
      row: Math.min(this.facts.rows - 1, Math.max(0, Math.round(row))),
      column: Math.min(this.facts.columns - 1, Math.max(0, Math.round(column))),
    };
  }

  setLine(line) {
    this.line = line;
    this.profile = null;
    this.overlay();
    this.online(line);
  }

  async read({ row, column }) {
    const at = { row: Math.round(row), column: Math.round(column) };
    if (at.row < 0 || at.column < 0 || at.row >= this.facts.rows || at.column >= this.facts.columns) return this.say("");
    this.asked = at;
    if (this.asking) return undefined;
    this.asking = true;
    try {
      const found = await this.height(at.row, at.column);
      const { pitch_um } = this.facts;
      this.say(`row ${at.row}, column ${at.column} · ${length(at.row * pitch_um)} down, ` +
        `${length(at.column * pitch_um)} right · ${withSigma(found.z_um, this.sigmaAt(at))}`);
    } catch (error) {
      this.fail(error);
    } finally {
      this.asking = false;
    }
    return this.asked === at || !this.asked ? undefined : this.read(this.asked);
  }

  sigmaAt({ row, column }) {
    if (!this.sigma) return null;
    const { rows, columns, values } = this.sigma;
    const at = [Math.floor((row / this.facts.rows) * rows), Math.floor((column / this.facts.columns) * columns)];
    return values[at[0] * columns + at[1]];
  }

  readMiddle() {
    const { eye } = this.relief;
    if (!eye.space) this.read(eye.centre).then(() => announce(this.reading.textContent));
  }

  say(words) {
    if (!words) this.asked = null;
    this.reading.textContent = words;
  }

  /** Draw the overlays again. */
  overlay() {
    if (!this.relief) return;
    const { eye } = this.relief;
    const { width, height } = eye.view;
    this.scale.show(eye.space ? null : this.facts.pitch_um / eye.scale);
    this.lines.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.lines.replaceChildren(...(this.line ? this.drawnLine() : []), ...(this.shapes ? this.shapes.draw() : []));
  }

  drawnLine() {
    const { eye } = this.relief;
    const { from, to } = this.line;
    const points = eye.space && this.profile ? this.risenLine() : [from, to].map((end) => eye.screen(end.row, end.column));
    const d = `M${points.map((point) => `${point.x.toFixed(1)} ${point.y.toFixed(1)}`).join("L")}`;
    const parts = [svg("path", { d, class: "under" }), svg("path", { d, class: "over" })];
    if (this.cursor) {
      const at = eye.screen(this.cursor.row, this.cursor.column, this.cursor.z);
      parts.push(svg("circle", { cx: at.x, cy: at.y, r: 5, class: "cursor" }));
    }
    if (eye.space) return parts;
    return parts.concat([["from", from], ["to", to]].map(([name, end]) => {
      const { x, y } = eye.screen(end.row, end.column);
      return svg("circle", { cx: x, cy: y, r: 8, class: "end", "data-end": name });
    }));
  }

  /** Height of a place above the pivot of the 3-D view, px of the map. */
  raised(z_um) {
    const { raise, base } = this.relief.material.uniforms;
    return raise.value * ((z_um ?? base.value) - base.value);
  }

  risenLine() {
    const { from, to } = this.line;
    const { z_um } = this.profile;
    const step = Math.max(1, Math.floor(z_um.length / 240));
    const points = [];
    for (let index = 0; index < z_um.length; index += step) {
      const share = index / (z_um.length - 1);
      points.push(this.relief.eye.screen(from.row + share * (to.row - from.row),
        from.column + share * (to.column - from.column), this.raised(z_um[index])));
    }
    return points;
  }

  /** Mark a point of the profile, by its index; null removes the mark. */
  markPoint(index) {
    if (index === null || !this.profile || !this.line) this.cursor = null;
    else {
      const share = index / Math.max(1, this.profile.z_um.length - 1);
      const { from, to } = this.line;
      this.cursor = { row: from.row + share * (to.row - from.row), column: from.column + share * (to.column - from.column),
        z: this.relief.eye.space ? this.raised(this.profile.z_um[index]) : 0 };
    }
    this.overlay();
  }

  dispose() {
    document.removeEventListener("keydown", this.keys);
    this.relief?.dispose();
  }
}
