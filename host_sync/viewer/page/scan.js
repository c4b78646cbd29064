// One scan: the relief, the panel beside it, the profile and, for a video, the player below it.

import * as api from "./api.js";
import { announce, button, copy, field, h } from "./dom.js";
import { length, micrometres, moment, percent } from "./format.js";
import { firstLook, LookPanel } from "./look.js";
import { MeasurePanel } from "./measure.js";
import { Player } from "./player.js";
import { ProfilePlot } from "./profile_plot.js";
import { Stage } from "./stage.js";

export async function scanPage(key, palettes) {
  const facts = await api.facts(key);
  return new ScanPage(facts, palettes);
}

class ScanPage {
  constructor(facts, palettes) {
    this.facts = facts;
    this.title = facts.title;
    this.palettes = palettes;
    this.look = firstLook(facts);
    this.stage = new Stage(facts, this.look, palettes, {
      label: facts.title,
      onlight: () => this.panel.changed(),
      online: (line) => this.profile(line),
      ontool: (tool) => {
        if (tool === "line") this.plotBox.hidden = false; // before drawing: nothing may move meanwhile
        if (tool !== "measure") this.measure.left();
      },
    });
    this.panel = new LookPanel(facts, this.look, {
      onchange: () => this.stage.relief && this.stage.apply(),
      onframe: facts.has_frame ? () => this.loadFrame() : null,
      onuncertainty: facts.has_sigma ? () => this.loadSigma() : null,
    });
    this.plot = new ProfilePlot((index) => this.stage.markPoint(index));
    this.plotBox = h("section", { class: "drawer", "aria-label": "Profile", hidden: true }, this.plot.element);
    this.below = h("div", { class: "below" });
    this.charts = h("section", { class: "drawer charts", "aria-label": "Charts", hidden: true });
    this.measure = new MeasurePanel(this.stage, this.charts);
    this.views = h("div", { class: "sections" }, this.panel.element, this.profileSection(), this.compareSection(),
      ...(facts.scan_id ? [labelSection(facts)] : []), aboutSection(facts),
      ...(facts.has_calibration_overview ? [calibrationSection(facts)] : []));
    this.measure.element.hidden = true;
    this.tabs = ["Look", "Measure"].map((words, index) => h("button", { type: "button", "aria-pressed": String(index === 0),
      onclick: () => this.turnTo(index) }, words));
    this.element = h("div", { class: "scan" },
      h("div", { class: "view" }, h("h1", { class: "unseen" }, facts.title), this.stage.element, this.below, this.plotBox, this.charts),
      h("aside", { class: "panel", "aria-label": "How it is shown and measured" },
        h("div", { class: "set tabs", role: "group", "aria-label": "Panel" }, ...this.tabs), this.views, this.measure.element));
  }

  start() {
    this.stage.start(this.palettes);
    if (this.facts.pages > 1) {
      this.player = new Player(this.facts, this.stage.relief.page, {
        onpage: async (page) => {
          await this.stage.relief.setPage(page);
          if (this.stage.line && !this.player.running) this.profile(this.stage.line);
        },
        onplaying: (playing) => {
          this.stage.relief.playing = playing;
          this.stage.relief.draw();
        },
      });
      this.below.append(this.player.element);
    }
    if (this.facts.has_sigma) this.loadSigma().catch((error) => this.stage.fail(error));
  }

  turnTo(index) {
    this.tabs.forEach((button, at) => button.setAttribute("aria-pressed", String(at === index)));
    this.views.hidden = index === 1;
    this.measure.element.hidden = index === 0;
    this.plotBox.hidden = index === 1 || !this.asked;
    this.charts.hidden = index === 0 || !this.charts.childElementCount;
    if (index === 0) this.measure.left();
    else if (!this.measuring) {
      this.measuring = true;
      this.measure.start();
    }
  }

  drop(file) {
    this.turnTo(1);
    this.measure.load(file);
  }

  async loadFrame() {
    this.frame ??= api.frame(this.facts.key).then((bitmap) => this.stage.relief.setFrame(bitmap));
    await this.frame.catch((error) => this.stage.fail(error));
  }

  async loadSigma() {
    this.sigma ??= api.sigma(this.facts.key).then((found) => {
      const known = Array.from(found.values).filter(Number.isFinite).sort((a, b) => a - b);
      this.stage.sigma = found;
      this.stage.relief.setSigma(found, Math.max(1e-3, known[Math.floor(known.length * 0.98)] ?? 1));
    });
    await this.sigma;
  }

  profileSection() {
    this.ends = Object.fromEntries(["row_0", "column_0", "row_1", "column_1"].map((name) => [
      name, h("input", { type: "number", min: 0, step: 1, onchange: () => this.takeEnds(),
        max: (name.startsWith("row") ? this.facts.rows : this.facts.columns) - 1 })]));
    this.save = h("a", { class: "small button", download: "", hidden: true }, "Save as CSV");
    this.copy = button("Copy", async () => copy(await api.text(this.save.href), "Profile"), { hidden: true });
    return h("details", { open: true }, h("summary", {}, "Profile"), h("div", { class: "inside" },
      h("p", { class: "hint" }, "Draw with the Profile tool, or give both ends in pixels."),
      h("div", { class: "pair" }, field("Row", this.ends.row_0), field("Column", this.ends.column_0)),
      h("div", { class: "pair" }, field("to row", this.ends.row_1), field("to column", this.ends.column_1)),
      h("div", { class: "row" },
        h("button", { type: "button", class: "small", onclick: () => this.middleLine() }, "Through the middle"),
        h("button", { type: "button", class: "small", onclick: () => this.clearLine() }, "Clear"), this.save, this.copy)));
  }

  takeEnds() {
    const [row_0, column_0, row_1, column_1] = Object.values(this.ends).map((input) => (input.value === "" ? NaN : Number(input.value)));
    if ([row_0, column_0, row_1, column_1].every(Number.isFinite)) {
      this.stage.setLine({ from: { row: row_0, column: column_0 }, to: { row: row_1, column: column_1 } });
    }
  }

  middleLine() {
    const row = Math.floor(this.facts.rows / 2);
    this.stage.setLine({ from: { row, column: 0 }, to: { row, column: this.facts.columns - 1 } });
  }

  clearLine() {
    this.stage.line = this.stage.profile = this.stage.cursor = null;
    this.asked = null;
    this.plotBox.hidden = this.save.hidden = this.copy.hidden = true;
    for (const input of Object.values(this.ends)) input.value = "";
    this.stage.overlay();
  }

  /** Request the heights along a line; while one answer is awaited, only the latest line is kept. */
  async profile({ from, to }) {
    const line = { row_0: from.row, column_0: from.column, row_1: to.row, column_1: to.column };
    for (const [name, input] of Object.entries(this.ends)) input.value = line[name];
    this.asked = line;
    if (this.asking || (from.row === to.row && from.column === to.column)) return;
    this.asking = true;
    this.plotBox.setAttribute("aria-busy", "true");
    const page = this.stage.relief.page;
    try {
      const found = await api.profile(this.facts.key, page, line);
      if (!this.asked) return;
      this.plotBox.hidden = this.save.hidden = this.copy.hidden = false;
      this.save.href = api.profileAddress(this.facts.key, page, line, "csv");
      this.stage.profile = this.asked === line ? found : null;
      this.stage.problem.hidden = true;
      this.plot.show(found);
      if (this.asked === line) announce(this.plot.summary.textContent);
    } catch (error) {
      this.stage.fail(error);
    } finally {
      this.asking = false;
      this.plotBox.setAttribute("aria-busy", String(Boolean(this.asked) && this.asked !== line));
    }
    if (this.asked && this.asked !== line) this.profile(this.stage.line);
  }

  compareSection() {
    const select = h("select", {});
    const button = h("button", { type: "button", class: "small", disabled: true,
      onclick: () => (location.hash = `#/compare/${this.facts.key}/${select.value}`) }, "Compare");
    api.list({}).then(({ entries }) => {
      const others = entries.filter((entry) => entry.key !== this.facts.key);
      select.append(...others.map((entry) => h("option", { value: entry.key }, nameOf(entry))));
      button.disabled = !others.length;
    }).catch((error) => this.stage.fail(error));
    return h("details", {}, h("summary", {}, "Compare"), h("div", { class: "inside" },
      field("With", select), h("div", { class: "row" }, button)));
  }

  dispose() {
    this.player?.dispose();
    this.measure.dispose();
    this.plot.dispose();
    this.stage.dispose();
  }
}

/** Facts that distinguish an entry. */
export function nameOf(entry) {
  return [entry.title, entry.apart, moment(entry.taken), entry.kind === "result" ? null : entry.kind].filter(Boolean).join(" · ");
}

/** Name, tags and note, which the library keeps beside its scans. */
function labelSection(facts) {
  const labelOf = (from) => ({ name: from.name ?? "", tags: from.tags ?? [], note: from.note ?? "" });
  let loaded = labelOf(facts);
  const name = h("input", { type: "text", value: facts.name ?? "", maxlength: 120, autocomplete: "off" });
  const tags = h("input", { type: "text", value: (facts.tags ?? []).join(" "), autocomplete: "off" });
  const note = h("textarea", { rows: 3, maxlength: 4000 }, facts.note ?? "");
  const said = h("p", { class: "hint", role: "status" });
  const problem = h("p", { class: "problem", role: "alert", hidden: true });
  const save = h("button", { type: "submit", class: "small" }, "Save label");
  const form = h("form", { class: "inside", onsubmit: async (event) => {
    event.preventDefault();
    save.disabled = true;
    problem.hidden = true;
    try {
      const found = await api.label(facts.key, { name: name.value.trim(), tags: tags.value.split(/[\s,]+/).filter(Boolean), note: note.value.trim(), loaded });
      loaded = labelOf(found);
      tags.value = found.tags.join(" ");
      said.textContent = `Saved. Lists call it ${found.title}.`;
    } catch (error) {
      said.textContent = "";
      problem.textContent = error.message;
      problem.hidden = false;
    }
    save.disabled = false;
  } }, field("Name", name), field("Tags", tags), field("Note", note), h("div", { class: "row" }, save), said, problem);
  return h("details", {}, h("summary", {}, "Label"), form);
}

/** The presses that the scan's calibration was made from, what became of each, and the error by place. */
function calibrationSection(facts) {
  const place = `/api/scan/${facts.key}/calibration`;
  const alt = "Presses of the calibration, its error by place, and the reference read as a scan";
  const picture = h("a", { href: place, target: "_blank", rel: "noopener" }, h("img", { src: place, loading: "lazy", alt }));
  return h("details", { class: "calibration" }, h("summary", {}, "Calibration"), picture);
}

function aboutSection(facts) {
  const { record } = facts;
  const rows = [
    ["Kind", { result: "Reconstruction", video: "Video", "quick look": "Quick look of the device (reduced)" }[facts.kind]],
    ["Scan", facts.scan_id], ["Taken", moment(facts.taken)], ["Verdict", facts.verdict && `${facts.verdict}: ${facts.reason}`],
    ["Job", facts.job], ["Part", facts.part], ["Operator", facts.operator], ["Gel", facts.gel], ["Device", facts.device],
    ["Tags", facts.tags?.join(", ")], ["Note", facts.note],
    ["Size", `${facts.columns} × ${facts.rows} pixels, ${length(facts.columns * facts.pitch_um)} × ${length(facts.rows * facts.pitch_um)}`],
    ["Pixel pitch", micrometres(facts.pitch_um)],
    ["Heights", Number.isFinite(record.height_min_um) ? `${micrometres(record.height_min_um)} to ${micrometres(record.height_max_um)}` : null],
    ["± (median)", Number.isFinite(record.height_sigma_median_um) ? micrometres(record.height_sigma_median_um) : null],
    ["Masked", percent(record.masked_share ?? facts.masked_share)],
    ["Calibration", record.calibration_id && `${record.calibration_id}${record.calibration_passed === false ? ", did not pass" : ""}`],
    ["Frame set", record.frame_set], ["Method", record.method], ["Program", record.program],
  ].filter(([, value]) => value);
  const warnings = facts.doubts.map((words) => h("p", { class: "warning" }, String(words)));
  return h("details", { open: true }, h("summary", {}, "About this scan"), h("div", { class: "inside" }, ...warnings,
    h("dl", {}, rows.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, String(value))]))));
}
