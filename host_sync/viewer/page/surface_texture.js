// A height map on the GPU: one texture whose levels are the server's means, uploaded from coarse to fine.
//
// The finest level that has arrived is drawn; nothing waits for the last one.

import { ExternalTexture } from "./vendor/three.module.js";
import { levelRows } from "./api.js";

const BAND_PIXELS = 2 ** 21;
const NEAREST_ZOOM = 3;

export class SurfaceTexture {
  /** facts: the entry's facts from the server; onlevel: called when a finer level has arrived. */
  constructor(renderer, facts, onlevel) {
    this.facts = facts;
    this.count = facts.levels;
    this.finest = this.count;
    this.page = null;
    this.renderer = renderer;
    this.gl = renderer.getContext();
    this.onlevel = onlevel;
    this.skipped = this.finestPossible;
    this.surface = new ExternalTexture(this.make(this.gl.RGBA16F));
    this.valid = new ExternalTexture(this.make(this.gl.R8));
    this.wanted = this.count - 1;
    this.loading = null;
  }

  make(form) {
    const { gl } = this;
    const texture = gl.createTexture();
    this.bind(texture);
    const [rows, columns] = this.levelSize(this.skipped);
    gl.texStorage2D(gl.TEXTURE_2D, this.count - this.skipped, form, columns, rows);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, this.count - 1 - this.skipped);
    this.sharpen(8);
    return texture;
  }

  /** Anisotropic filtering of the bound texture. */
  sharpen(times) {
    const { gl } = this;
    const how = gl.getExtension("EXT_texture_filter_anisotropic");
    if (!how) return;
    const most = gl.getParameter(how.MAX_TEXTURE_MAX_ANISOTROPY_EXT);
    gl.texParameterf(gl.TEXTURE_2D, how.TEXTURE_MAX_ANISOTROPY_EXT, Math.min(times, most));
  }

  bind(texture) {
    const { gl, renderer } = this;
    renderer.state.activeTexture(gl.TEXTURE0);
    renderer.state.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  }

  levelSize(level) {
    return this.facts.padded.map((side) => side >> level);
  }

  /** Finest level that the GPU's largest texture allows. */
  get finestPossible() {
    const most = this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE);
    let level = 0;
    while (Math.max(...this.levelSize(level)) > most && level < this.count - 1) level += 1;
    return level;
  }

  /** Show single pixels as squares when they are large; returns whether they are. */
  showSquares(screenPerPixel) {
    const way = screenPerPixel >= NEAREST_ZOOM && this.finest === 0 ? this.gl.NEAREST : this.gl.LINEAR;
    if (way !== this.way) {
      this.way = way;
      for (const texture of [this.surface, this.valid]) {
        this.bind(texture.sourceTexture);
        this.gl.texParameteri(this.gl.TEXTURE_2D, this.gl.TEXTURE_MAG_FILTER, way);
        this.sharpen(way === this.gl.NEAREST ? 1 : 8); // together with squares it is not defined what is seen
      }
    }
    return way === this.gl.NEAREST;
  }

  /** Request levels down to this one; missing ones are loaded from coarse to fine. */
  want(level, page = 0) {
    if (this.facts.kind === "live") return Promise.resolve();
    this.wanted = Math.max(this.skipped, Math.min(this.count - 1, level));
    if (page !== this.page) {
      this.stop();
      this.page = page;
      this.fresh = true;
    }
    if (!this.loading && (this.fresh || this.finest > this.wanted)) this.loading = this.load(page);
    return this.loading ?? Promise.resolve();
  }

  async load(page) {
    const stopper = new AbortController();
    this.stopper = stopper;
    try {
      // A new page replaces the old one only when its levels are as fine, so that a video does not flicker.
      if (this.fresh && this.finest < this.count) await this.replace(page, stopper.signal);
      else {
        this.fresh = false;
        while (this.finest > this.wanted) await this.loadLevel(this.finest - 1, page, stopper.signal);
      }
    } finally {
      if (this.stopper === stopper) this.loading = null;
    }
  }

  async loadLevel(level, page, signal) {
    const [rows, columns] = this.levelSize(level);
    const step = Math.max(2, Math.floor(BAND_PIXELS / columns / 2) * 2);
    for (let first = 0; first < rows; first += step) {
      const last = Math.min(first + step, rows);
      const part = await levelRows(this.facts.key, page, level, first, last, signal);
      if (signal.aborted) return;
      this.put(level, first, last - first, columns, part);
    }
    this.show(level);
  }

  /** All levels of another page, uploaded together. */
  async replace(page, signal) {
    const parts = [];
    for (let level = this.count - 1; level >= this.wanted; level -= 1) {
      const [rows] = this.levelSize(level);
      parts.push([level, await levelRows(this.facts.key, page, level, 0, rows, signal)]);
    }
    if (signal.aborted) return;
    for (const [level, part] of parts) this.put(level, 0, ...this.levelSize(level), part);
    this.fresh = false;
    this.show(this.wanted);
  }

  /** Show another surface, whose levels lie in a buffer from an offset on, fine to coarse; returns the finest. */
  receive(buffer, offset) {
    let at = offset;
    const parts = [];
    for (let level = 0; level < this.count; level += 1) {
      const [rows, columns] = this.levelSize(level);
      const pixels = rows * columns;
      parts.push({ surface: new Uint16Array(buffer, at, 4 * pixels), valid: new Uint8Array(buffer, at + 8 * pixels, pixels) });
      at += 8 * pixels + 8 * Math.ceil(pixels / 8);
    }
    for (let level = this.count - 1; level >= this.skipped; level -= 1) this.put(level, 0, ...this.levelSize(level), parts[level]);
    this.show(this.skipped);
    return parts[0];
  }

  /** Upload some rows of a level. */
  put(level, first, rows, columns, part) {
    const { gl } = this;
    const at = level - this.skipped;
    this.bind(this.surface.sourceTexture);
    gl.texSubImage2D(gl.TEXTURE_2D, at, 0, first, columns, rows, gl.RGBA, gl.HALF_FLOAT, part.surface);
    this.bind(this.valid.sourceTexture);
    gl.texSubImage2D(gl.TEXTURE_2D, at, 0, first, columns, rows, gl.RED, gl.UNSIGNED_BYTE, part.valid);
  }

  show(level) {
    this.finest = level;
    for (const texture of [this.surface, this.valid]) {
      this.bind(texture.sourceTexture);
      this.gl.texParameteri(this.gl.TEXTURE_2D, this.gl.TEXTURE_BASE_LEVEL, level - this.skipped);
    }
    this.onlevel(level);
  }

  stop() {
    this.stopper?.abort();
    this.loading = null;
  }

  dispose() {
    this.stop();
    for (const texture of [this.surface, this.valid]) {
      this.gl.deleteTexture(texture.sourceTexture);
      texture.dispose();
    }
  }
}
