// One recipe on many scans: a table of numbers with verdicts, and the trend of one of them.

import * as api from "./api.js";
import { chart, polyline } from "./charts.js";
import { announce, button, copy, field, h, harmless, svg, tabbed } from "./dom.js";
import { plain } from "./format.js";
import { KEPT } from "./measure.js";
import { nameOf } from "./scan.js";

const SIGNS = { pass: "✓", fail: "✗", undecided: "?" };

export async function batchPage() {
  const text = sessionStorage.getItem(KEPT);
  if (!text) throw new Error("There is no recipe yet: open a scan, choose Measure, and draw what is to be measured.");
  const { entries } = await api.list({});
  return new BatchPage(text, entries.filter((entry) => entry.kind === "result" || entry.kind === "quick look"));
}

class BatchPage {
  constructor(text, entries) {
    this.title = "Measure many scans";
    this.text = text;
    this.entries = [...entries].sort((one, other) => (one.taken ?? one.title).localeCompare(other.taken ?? other.title));
    this.answers = new Map();
    this.columns = new Map();
    this.search = h("input", { type: "search", placeholder: "part, job, id …", autocomplete: "off", oninput: () => this.layOut() });
    this.status = h("p", { class: "count", role: "status" });
    this.startButton = h("button", { type: "button", onclick: () => (this.running ? this.stop() : this.run()) }, "Measure");
    this.saved = h("a", { class: "button small", download: "numbers.csv", hidden: true }, "Save table as CSV");
    this.copying = button("Copy table", () => copy(tabbed(this.rows), "Table"), { hidden: true });
    this.shown = h("select", { onchange: () => this.trend() });
    this.chart = h("div", { class: "trend", hidden: true });
    this.table = h("table", { class: "numbers" });
    const recipe = h("details", {}, h("summary", {}, "Recipe"), h("pre", { tabindex: 0 }, text));
    this.element = h("div", { class: "library" }, h("h1", {}, this.title), h("p", { class: "root" },
      "The recipe that was drawn last, on the scans of the list, in the order in which they were taken."), recipe,
      h("div", { class: "filters" }, field("Scans with", this.search), field("Trend of", this.shown)),
      h("div", { class: "row between" }, this.status, h("div", { class: "row" }, this.startButton, this.saved, this.copying)), this.chart,
      h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Numbers" }, this.table));
    this.layOut();
  }

  start() {}

  get chosen() {
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.entries.filter((entry) => {
      const known = [entry.title, entry.kind, entry.scan_id, entry.taken, entry.job, entry.part, entry.gel, entry.operator, entry.device, entry.verdict];
      return words.every((word) => known.join("\n").toLowerCase().includes(word));
    });
  }

  async run() {
    this.running = true;
    this.startButton.textContent = "Stop";
    const chosen = this.chosen;
    for (const [at, entry] of chosen.entries()) {
      if (!this.running || this.gone) break;
      this.status.textContent = `${at + 1} of ${chosen.length}: ${entry.title}`;
      if (this.answers.get(entry.key)?.quantities) continue;
      try {
        this.take(entry, await api.measure(entry.key, Math.floor((entry.pages ?? 1) / 2), { text: this.text }, true));
      } catch (error) {
        this.answers.set(entry.key, { error: error.message });
      }
      this.layOut();
    }
    this.stop();
  }

  stop() {
    this.running = false;
    this.startButton.textContent = "Measure";
    this.layOut();
    announce(this.status.textContent);
  }

  take(entry, found) {
    this.answers.set(entry.key, found);
    for (const one of found.quantities) {
      const key = `${one.subject}: ${one.name}`;
      if (this.columns.has(key)) continue;
      this.columns.set(key, { unit: one.unit, limits: one.limits });
      this.shown.append(h("option", { value: key }, key));
    }
    if (!this.picked) {
      const judged = found.quantities.find((one) => one.limits);
      if (judged) this.shown.value = `${judged.subject}: ${judged.name}`;
      this.picked = true;
    }
  }

  /** The scan whose very numbers another one repeats: copies of one press are no two measurements. */
  copied(entry) {
    const numbers = (one) => JSON.stringify((this.answers.get(one.key)?.quantities ?? []).map(({ value }) => value));
    const first = this.chosen.find((one) => this.answers.get(one.key)?.quantities?.length && numbers(one) === numbers(entry));
    return first && first !== entry ? nameOf(first) : null;
  }

  quantity(entry, key) {
    return (this.answers.get(entry.key)?.quantities ?? []).find((one) => `${one.subject}: ${one.name}` === key);
  }

  layOut() {
    const chosen = this.chosen;
    const keys = [...this.columns.keys()];
    const done = chosen.filter((entry) => this.answers.has(entry.key)).length;
    const failing = chosen.filter((entry) => (this.answers.get(entry.key)?.quantities ?? []).some((one) => one.limits?.verdict === "fail")).length;
    if (!this.running) this.status.textContent = `${done} of ${chosen.length} scans measured${failing ? `, ${failing} with a number that fails` : ""}`;
    const head = h("tr", {}, h("th", { scope: "col" }, "Scan"), ...keys.map((key) => h("th", { scope: "col" }, key)), h("th", { scope: "col" }, "Doubts"));
    const rows = chosen.map((entry) => {
      const found = this.answers.get(entry.key);
      const cells = keys.map((key) => {
        const one = this.quantity(entry, key);
        const verdict = one?.limits?.verdict;
        return h("td", { class: verdict ?? null }, one ? `${verdict ? `${SIGNS[verdict]} ` : ""}${one.number}` : "");
      });
      const words = found?.error ?? (found?.doubts ?? entry.doubts).map((doubt) => doubt.split(":")[0]).join(", ");
      const copied = this.copied(entry);
      return h("tr", {}, h("th", { scope: "row" }, h("a", { href: `#/scan/${entry.key}` }, nameOf(entry))), ...cells, h("td", { class: "doubt" }, copied ? `copy of ${copied}` : words));
    });
    this.table.replaceChildren(h("caption", { class: "unseen" }, "Numbers of each scan"), h("thead", {}, head), h("tbody", {}, rows));
    this.save(chosen, keys);
    this.trend();
  }

  save(chosen, keys) {
    const cell = (value) => {
      const safe = harmless(value);
      return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
    };
    const head = ["scan", "taken", ...keys.flatMap((key) => [`${key}${this.columns.get(key).unit ? `, ${this.columns.get(key).unit}` : ""}`, `± of ${key}`, `verdict of ${key}`]), "doubts"];
    const rows = chosen.filter((entry) => this.answers.get(entry.key)?.quantities).map((entry) => [[entry.title, entry.apart].filter(Boolean).join(", "), entry.taken ?? "",
      ...keys.flatMap((key) => {
        const one = this.quantity(entry, key);
        return [one?.value, one?.uncertainty, one?.limits?.verdict];
      }), this.answers.get(entry.key).doubts.join("; ")]);
    if (this.address) URL.revokeObjectURL(this.address);
    this.address = URL.createObjectURL(new Blob([[head, ...rows].map((row) => row.map(cell).join(",")).join("\n"), "\n"], { type: "text/csv" }));
    this.saved.href = this.address;
    this.saved.hidden = this.copying.hidden = !rows.length;
    this.rows = [head, ...rows];
  }

  async trend() {
    const key = this.shown.value;
    const shown = this.chosen.map((entry) => [entry, this.quantity(entry, key)]).filter(([entry, one]) => one && !this.copied(entry));
    this.chart.hidden = shown.length < 2;
    if (shown.length < 2) return;
    const { low = null, high = null } = shown[0][1].limits ?? {};
    const asked = { unit: shown[0][1].unit, low, high, values: shown.map(([, one]) => one.value),
      sigmas: shown.map(([, one]) => (one.uncertainty === null ? null : one.uncertainty / one.coverage_factor)),
      coverage_factor: shown[0][1].coverage_factor, warnings: shown.map(([, one]) => one.doubts ?? []) };
    this.latest = asked;
    try {
      const found = await api.trend(asked);
      if (this.latest === asked && !this.gone) this.draw(key, shown, found, asked);
    } catch (error) {
      this.chart.replaceChildren(h("p", { class: "problem" }, error.message));
    }
  }

  draw(key, shown, found, asked) {
    const { low, high, unit } = asked;
    const bounds = [low, high, found.control_low, found.control_high].filter((one) => Number.isFinite(one));
    const ends = shown.filter(([, one]) => one.value !== null).flatMap(([, one]) => [one.value - (one.uncertainty ?? 0), one.value + (one.uncertainty ?? 0)]);
    const [least, most] = [Math.min(...ends, ...bounds), Math.max(...ends, ...bounds)];
    const room = 0.06 * (most - least || 1);
    const level = (x, y, value, kind) => Number.isFinite(value) ? [svg("line", { class: kind, x1: x(0.5), x2: x(shown.length + 0.5), y1: y(value), y2: y(value) })] : [];
    const drawing = chart(`Trend of ${key}: ${found.text}`, { low: 0.5, high: shown.length + 0.5, words: "scan, in the order taken", labels: (value) => (Number.isInteger(value) ? plain(value) : "") },
      { low: least - room, high: most + room, words: unit ? `${key}, ${unit}` : key }, (x, y) => [
        ...level(x, y, found.mean, "core-line"), ...level(x, y, found.control_low, "core-level"), ...level(x, y, found.control_high, "core-level"),
        ...level(x, y, low, "limit"), ...level(x, y, high, "limit"),
        polyline(shown.flatMap(([, one], at) => (one.value === null ? [] : [[x(at + 1), y(one.value)]])), "thread"),
        ...shown.flatMap(([entry, one], at) => (one.value === null ? [] : [this.point(x(at + 1), y, one, entry)])),
      ], { width: 900, height: 300 });
    this.chart.replaceChildren(drawing, h("p", {}, found.text.replaceAll("-", "−")),
      h("p", { class: "hint" }, `Line: mean; dotted: control limits of individuals; red: tolerance; bars: ± (k = ${asked.coverage_factor}). ✗ squares fail, ? rings are undecided.`));
  }

  point(x, y, one, entry) {
    const verdict = one.limits?.verdict ?? "";
    const half = one.uncertainty ?? 0;
    const title = svg("title");
    title.textContent = [`${entry.title}: ${one.number} ${verdict}`, ...(one.doubts ?? [])].join("\n");
    const mark = verdict === "fail" ? svg("rect", { x: x - 5, y: y(one.value) - 5, width: 10, height: 10 }) : svg("circle", { cx: x, cy: y(one.value), r: 5 });
    return svg("g", { class: `dot ${verdict}` }, title, svg("line", { x1: x, x2: x, y1: y(one.value - half), y2: y(one.value + half) }), mark);
  }

  dispose() {
    this.gone = true;
    this.running = false;
    if (this.address) URL.revokeObjectURL(this.address);
  }
}
