// The list: thumbnails, filters, search; two selected scans can be compared.

import * as api from "./api.js";
import { announce, field, h } from "./dom.js";
import { length, moment } from "./format.js";

const WAIT_MS = 180;
const MAX_SHOWN = 240;

export async function libraryPage() {
  const listing = await api.list({});
  return new LibraryPage(listing);
}

class LibraryPage {
  constructor(listing) {
    this.title = "";
    this.chosen = new Map();
    this.filters = {};
    this.count = h("p", { class: "count", role: "status" });
    this.cards = h("ul", { class: "cards" });
    this.more = h("button", { type: "button", class: "quiet", hidden: true, onclick: () => this.showMore() }, "Show more");
    this.compareLink = h("a", { class: "button small", hidden: true }, "Compare the two");
    this.complaints = h("div", {});
    const inputs = [
      ["q", "Search", h("input", { type: "search", placeholder: "part, job, id …", autocomplete: "off" })],
      ...(listing.is_library ? [
        ["verdict", "Verdict", h("select", {}, [["", "any"], ["good", "good"], ["doubtful", "doubtful"], ["retake", "retake"]]
          .map(([value, words]) => h("option", { value }, words)))],
        ["job", "Job", h("input", { type: "text", autocomplete: "off" })],
        ["part", "Part", h("input", { type: "text", autocomplete: "off" })],
        ["tag", "Tag", h("input", { type: "text", autocomplete: "off" })],
        ["gel", "Gel", h("input", { type: "text", autocomplete: "off" })],
        ["operator", "Operator", h("input", { type: "text", autocomplete: "off" })],
        ["since", "From day", h("input", { type: "date" })],
        ["until", "To day", h("input", { type: "date" })],
      ] : []),
    ];
    for (const [name, , input] of inputs) input.addEventListener("input", () => this.filter(name, input.value));
    const fields = inputs.map(([, label, input]) => field(label, input));
    const form = h("form", { class: "filters", role: "search", onsubmit: (event) => event.preventDefault() }, ...fields);
    this.element = h("div", { class: "library" }, h("h1", {}, listing.is_library ? "Library" : "Results"),
      h("p", { class: "root" }, listing.root), form, h("div", { class: "row between" }, this.count, this.compareLink),
      this.cards, this.more, this.complaints);
    this.show(listing);
  }

  start() {}

  filter(name, value) {
    this.filters[name] = value;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.ask(), WAIT_MS);
  }

  async ask() {
    const asked = Object.fromEntries(Object.entries(this.filters).filter(([, value]) => value !== ""));
    this.latest = asked;
    try {
      const listing = await api.list(asked);
      if (this.latest === asked) this.show(listing);
    } catch (error) {
      this.count.textContent = error.message;
    }
  }

  show({ entries, complaints }) {
    this.entries = entries;
    this.shown = 0;
    this.cards.replaceChildren();
    this.count.textContent = entries.length === 1 ? "1 scan" : `${entries.length} scans`;
    this.showMore();
    this.complaints.replaceChildren(...(complaints.length ? [h("details", { class: "complaints" },
      h("summary", {}, `${complaints.length} cannot be shown`),
      h("ul", {}, complaints.map((words) => h("li", {}, words))))] : []));
  }

  showMore() {
    const next = this.entries.slice(this.shown, this.shown + MAX_SHOWN);
    this.cards.append(...next.map((entry) => this.card(entry)));
    this.shown += next.length;
    this.more.hidden = this.shown >= this.entries.length;
  }

  card(entry) {
    const facts = [entry.apart, entry.kind === "result" ? null : entry.kind, moment(entry.taken),
      entry.job && `job ${entry.job}`, entry.tags?.length ? entry.tags.map((tag) => `#${tag}`).join(" ") : null, `${length(entry.columns * entry.pitch_um)} × ${length(entry.rows * entry.pitch_um)}`];
    const warned = entry.doubts.length ? entry.doubts.map((words) => words.split(":")[0]).join(", ") : null;
    const box = h("input", { type: "checkbox", checked: this.chosen.has(entry.key), "aria-label": ["Compare", entry.title, entry.apart].filter(Boolean).join(" "),
      onchange: () => this.tick(entry, box) });
    return h("li", { class: "card" },
      h("a", { href: `#/scan/${entry.key}` },
        h("span", { class: "thumb" }, h("img", { src: api.thumbnail(entry), alt: "", loading: "lazy", decoding: "async" })),
        h("span", { class: "name" }, entry.title),
        h("span", { class: "facts" }, facts.filter(Boolean).join(" · ")),
        entry.verdict || warned ? h("span", { class: "chips" }, entry.verdict ? verdict(entry.verdict) : null,
          warned && h("span", { class: "chip warn" }, "⚠ ", warned)) : null),
      h("label", { class: "pick" }, box, h("span", {}, "Compare")));
  }

  tick(entry, box) {
    if (box.checked) this.chosen.set(entry.key, entry);
    else this.chosen.delete(entry.key);
    const keys = [...this.chosen.keys()];
    this.compareLink.hidden = keys.length !== 2;
    this.compareLink.href = `#/compare/${keys.slice(0, 2).join("/")}`;
    announce(keys.length === 2 ? "Two scans are chosen: they can be compared" : `${keys.length} chosen; two can be compared`);
  }

  dispose() {
    clearTimeout(this.waiting);
  }
}

const SIGNS = { good: "✓", doubtful: "?", retake: "↻" };

function verdict(level) {
  return h("span", { class: `chip ${level}` }, `${SIGNS[level] ?? ""} ${level}`);
}
