// Plays the height maps of a video; each frame is shown when it has arrived.

import { field, h } from "./dom.js";

export class Player {
  /** onpage: shows a page and resolves when it is drawn; onplaying: whether it plays. */
  constructor(facts, first, { onpage, onplaying }) {
    this.facts = facts;
    this.onpage = onpage;
    this.onplaying = onplaying;
    this.page = first;
    this.button = h("button", { type: "button", onclick: () => this.toggle() }, "Play");
    this.slider = h("input", { type: "range", min: 0, max: facts.pages - 1, step: 1, value: first,
      oninput: () => this.go(Number(this.slider.value)) });
    this.words = h("output", { class: "unit wide" });
    this.speed = h("select", {}, [0.1, 0.25, 0.5, 1, 2].map((speed) =>
      h("option", { value: speed, selected: speed === 1 }, `×${speed}`)));
    this.element = h("div", { class: "player" }, this.button, field("Frame", this.slider), this.words,
      field("Speed", this.speed));
    this.show();
  }

  toggle() {
    if (this.running) this.pause();
    else this.play();
  }

  async play() {
    const run = {};
    this.running = run;
    this.button.textContent = "Pause";
    this.onplaying(true);
    while (this.running === run) {
      const due = performance.now() + 1000 / (this.facts.rate_hz * Number(this.speed.value));
      await this.turn((this.page + 1) % this.facts.pages);
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, due - performance.now())));
    }
  }

  pause() {
    if (!this.running) return;
    this.running = null;
    this.button.textContent = "Play";
    this.onplaying(false);
  }

  go(page) {
    this.pause();
    return this.turn(page);
  }

  async turn(page) {
    this.page = page;
    this.show();
    this.element.setAttribute("aria-busy", "true");
    try {
      await this.onpage(page);
    } finally {
      if (this.page === page) this.element.setAttribute("aria-busy", "false");
    }
  }

  show() {
    this.slider.value = this.page;
    const seconds = (this.page / this.facts.rate_hz).toFixed(2);
    this.words.textContent = `${this.page + 1} of ${this.facts.pages}, ${seconds} s`;
    this.slider.setAttribute("aria-valuetext", this.words.textContent);
  }

  dispose() {
    this.running = null;
  }
}
