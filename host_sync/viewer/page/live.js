// A live view: the relief of a running source, what touches it, and how fast it comes.

import { DataUtils } from "./vendor/three.module.js";
import * as api from "./api.js";
import { announce, check, h, svg } from "./dom.js";
import { plain, withSigma } from "./format.js";
import { keysEverywhere } from "./keys.js";
import { firstLook, LookPanel } from "./look.js";
import { Stage } from "./stage.js";

const AGAIN_MS = 1000;
const CHART_S = 20;
const CHART = { width: 300, height: 84 };

export async function livePage(palettes) {
  return new LivePage(await api.live(), palettes);
}

class LivePage {
  constructor(facts, palettes) {
    this.facts = facts;
    this.title = `${facts.title}, live`;
    this.palettes = palettes;
    this.look = firstLook(facts);
    this.follows = true;
    this.history = [];
    this.stage = new Stage(facts, this.look, palettes, {
      label: this.title,
      onlight: () => this.panel.changed(),
      height: (row, column) => Promise.resolve({ z_um: this.heightAt(row, column) }),
    });
    this.panel = new LookPanel(facts, this.look, { onchange: () => this.stage.relief && this.stage.apply() });
    this.record = h("button", { type: "button", "aria-pressed": "false", title: "Record every frame (R)", onclick: () => this.toggle() }, "Record");
    this.recorded = h("p", { class: "hint", role: "status" });
    this.values = Object.fromEntries(["Largest depth", "Contact area", "Centre", "Pictures", "Age of the picture", "Dropped"]
      .map((name) => [name, h("dd", {}, "–")]));
    this.line = svg("path", { class: "trace" });
    this.most = h("span", { class: "hint" });
    const chart = svg("svg", { viewBox: `0 0 ${CHART.width} ${CHART.height}`, class: "trend", role: "img", "aria-label": `Largest depth over the last ${CHART_S} s` }, this.line);
    const follow = check("Colours follow the heights", true, (on) => (this.follows = on)).element;
    const numbers = h("details", { open: true }, h("summary", {}, "Contact"), h("div", { class: "inside" },
      h("dl", { class: "live" }, Object.entries(this.values).flatMap(([name, value]) => [h("dt", {}, name), value])),
      chart, this.most, follow, h("div", { class: "row" }, this.record), this.recorded));
    this.element = h("div", { class: "scan" },
      h("div", { class: "view" }, h("h1", { class: "unseen" }, this.title), this.stage.element),
      h("aside", { class: "panel", "aria-label": "What touches, and how it is shown" }, numbers, this.panel.element));
    this.keys = (event) => this.key(event);
  }

  start() {
    this.stage.start(this.palettes);
    document.addEventListener("keydown", this.keys);
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live/pictures`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = () => {
      if (this.gone || this.ended) return;
      this.say("The live view does not answer: start retrosync live again.");
      this.waiting = setTimeout(() => this.connect(), AGAIN_MS);
    };
    this.socket = socket;
  }

  receive(data) {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    this.state(header);
    if (header.number === undefined) return;
    this.range(header);
    if (data.byteLength > 4 + length) {
      this.finest = this.stage.relief.texture.receive(data, 4 + length);
      this.stage.come(0);
      requestAnimationFrame(() => this.send({ drawn: header.number }));
    }
    this.numbers(header);
  }

  /** Colours and the pivot of the 3-D view follow the heights: up at once, down slowly. */
  range({ low_um, high_um, steep }) {
    if (!this.follows || this.held) return;
    const eased = (old, now, outwards) => (outwards ? now : old + 0.02 * (now - old));
    const low = eased(this.look.low, Math.min(low_um, 0), low_um < this.look.low);
    const high = eased(this.look.high, Math.max(high_um, low + 2 * this.facts.pitch_um), high_um > this.look.high || !this.begun);
    this.begun = true;
    if (Math.abs(high - this.look.high) + Math.abs(low - this.look.low) < 0.01 * (high - low)) return;
    Object.assign(this.facts, { low_um: low, high_um: high, steep });
    Object.assign(this.look, { low, high });
    this.panel.show();
    this.stage.apply();
  }

  numbers(header) {
    const { values } = this;
    const touched = header.centre !== null;
    values["Largest depth"].textContent = header.depth_um === null ? "–" : withSigma(header.depth_um, header.depth_sigma_um);
    const spread = header.area_sigma_mm2 ? ` ± ${plain(Number(header.area_sigma_mm2.toPrecision(2)))}` : "";
    values["Contact area"].textContent = touched ? `${plain(Number(header.area_mm2.toPrecision(3)))}${spread} mm²` : "nothing touches";
    values.Centre.textContent = touched ? `row ${header.centre[0].toFixed(1)}, column ${header.centre[1].toFixed(1)}` : "–";
    this.history.push([header.time_s, header.depth_um ?? 0]);
    while (this.history.length && (this.history[0][0] < header.time_s - CHART_S || this.history[0][0] > header.time_s)) this.history.shift();
    const most = Math.max(1, ...this.history.map(([, depth]) => depth));
    const place = ([time, depth]) => `${(CHART.width * (1 - (header.time_s - time) / CHART_S)).toFixed(1)} ${(CHART.height - 2 - ((CHART.height - 6) * Math.max(0, depth)) / most).toFixed(1)}`;
    this.line.setAttribute("d", `M${this.history.map(place).join("L")}`);
    this.most.textContent = `Depth over ${CHART_S} s, up to ${plain(Number(most.toPrecision(3)))} µm`;
  }

  state(header) {
    const { values } = this;
    const rate = (value) => (value === null ? "–" : value.toFixed(1));
    values.Pictures.textContent = `${rate(header.shown_hz)} a second (${rate(header.solved_hz)} solved)`;
    values["Age of the picture"].textContent = header.age_ms === null ? "–" : `${Math.round(header.age_ms)} ms`;
    values.Dropped.textContent = `${header.dropped} of ${header.read} frames`;
    const { folder, frames, lost, problem } = header.recording;
    this.recording = folder !== null;
    this.record.setAttribute("aria-pressed", String(this.recording));
    this.record.textContent = this.recording ? "Stop" : "Record";
    if (folder) this.kept = folder;
    this.recorded.textContent = problem ?? (this.kept ? `${frames} frames in ${this.kept}${lost ? `, ${lost} lost: the disk is too slow` : ""}` : "");
    this.ended = header.ended;
    if (header.lost) this.say(header.ended ? header.lost : `${header.lost}. It is looked for again.`);
    else if (header.ended) this.say("The source has ended.");
    else if (header.problem) this.say(header.problem);
    else if (header.relative) this.say("No untouched skin is seen: heights are relative to each other.");
    else this.say("");
  }

  say(words) {
    if (words === this.stage.problem.textContent) return;
    this.stage.problem.textContent = words;
    this.stage.problem.hidden = !words;
  }

  send(words) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(words));
  }

  toggle() {
    this.send({ record: !this.recording });
    announce(this.recording ? "Recording ends" : "Recording");
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.key.toLowerCase() !== "r" || !keysEverywhere()) return;
    if (event.target.matches("input, select, textarea") || document.querySelector("dialog[open]")) return;
    this.toggle();
    event.preventDefault();
  }

  /** Height of a pixel of the picture that is shown, µm. */
  heightAt(row, column) {
    if (!this.finest) return null;
    const at = row * this.facts.padded[1] + column;
    if (!this.finest.valid[at]) return null;
    return DataUtils.fromHalfFloat(this.finest.surface[4 * at + 2]) + DataUtils.fromHalfFloat(this.finest.surface[4 * at + 3]);
  }

  dispose() {
    this.gone = true;
    clearTimeout(this.waiting);
    document.removeEventListener("keydown", this.keys);
    this.socket?.close();
    this.stage.dispose();
  }
}
