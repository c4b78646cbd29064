// A relief on a canvas: appearance, camera, and drawing on changes.

import {
  BufferAttribute, BufferGeometry, Color, ColorManagement, DataTexture, DataUtils, DoubleSide, GLSL3, HalfFloatType, LinearFilter,
  LinearMipmapLinearFilter, LinearSRGBColorSpace, Mesh, NearestFilter, NoColorSpace, RGBAFormat, RGFormat, Scene, ShaderMaterial, Texture,
  UnsignedByteType, Vector2, Vector3, WebGLRenderer,
} from "./vendor/three.module.js";
import { Eye } from "./camera.js";
import { FRAGMENT, VERTEX } from "./relief_shader.js";
import { SurfaceTexture } from "./surface_texture.js";
import { styleColour } from "./theme.js";

const FIRST_MESH = 192;
const FINEST_MESH = 1280;
const QUICK_MS = 10;

/** Light from an azimuth (counter-clockwise from the right) and an elevation, in rows that grow downwards. */
export function lightVector(azimuth, elevation) {
  const [turn, rise] = [azimuth, elevation].map((angle) => (angle * Math.PI) / 180);
  return new Vector3(Math.cos(turn) * Math.cos(rise), -Math.sin(turn) * Math.cos(rise), Math.sin(rise));
}

export class Relief {
  /** onview: called after each drawing; oncoming: called with the finest level there is. */
  constructor(canvas, facts, palettes, { onview = () => {}, oncoming = () => {}, onerror = () => {} }) {
    this.facts = facts;
    this.canvas = canvas;
    this.palettes = palettes;
    this.onview = onview;
    this.oncoming = oncoming;
    this.onerror = onerror;
    this.page = Math.floor(facts.pages / 2);
    this.playing = false;
    ColorManagement.enabled = false; // the shader writes what the screen shows
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: false, preserveDrawingBuffer: true });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.eye = new Eye({ rows: facts.rows, columns: facts.columns });
    this.texture = this.newTexture();
    this.scene = new Scene();
    this.material = this.newMaterial();
    this.meshSize = 0;
    this.mesh = new Mesh(new BufferGeometry(), this.material);
    this.mesh.frustumCulled = false;
    this.scene.add(this.mesh);
    this.fullMesh = FIRST_MESH;
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(canvas.parentElement);
    this.themed = () => this.draw();
    document.addEventListener("themechange", this.themed);
    canvas.addEventListener("webglcontextlost", () =>
      this.onerror(new Error("The graphics card gave this view up: load the page again.")),
    );
    this.resize();
  }

  newTexture() {
    return new SurfaceTexture(this.renderer, this.facts, (level) => {
      this.oncoming(level);
      this.draw();
    });
  }

  newMaterial() {
    const { facts } = this;
    const blank = dataTexture(new Uint8Array([255, 255, 255, 255]), 1, 1);
    const uniforms = {
      surface: this.texture.surface, valid: this.texture.valid, palette: blank, frame: blank, sigma: blank,
      sigmaPalette: paletteTexture(this.palettes.cividis),
      padded: new Vector2(facts.padded[1], facts.padded[0]), size: new Vector2(facts.columns, facts.rows),
      light: new Vector3(0, 0, 1), exaggeration: 1, low: 0, high: 1, interval: 1, sigmaHigh: 1, pixelSize: 1,
      colour: 0, shading: true, curves: false, hatch: true, uncertainty: false, space: false, grid: false, squares: false,
      backdrop: new Vector3(), ink: new Vector3(), lod: 0, raise: 0, base: 0,
    };
    return new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: DoubleSide,
      uniforms: Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }])),
    });
  }

  /** Change its appearance; names as in look.js. */
  apply(look) {
    const set = (name, value) => (this.material.uniforms[name].value = value);
    if (look.palette !== this.paletteName) {
      this.paletteName = look.palette;
      set("palette", paletteTexture(this.palettes[look.palette]));
    }
    set("light", lightVector(look.azimuth, look.elevation));
    for (const name of ["exaggeration", "low", "high", "interval", "shading", "curves", "hatch"]) set(name, look[name]);
    set("colour", ["height", "white", "frame"].indexOf(look.colour === "frame" && !this.hasFrame ? "white" : look.colour));
    set("uncertainty", look.uncertainty && this.sigmaHigh !== undefined);
    this.draw();
  }

  setFrame(bitmap) {
    const texture = new Texture(bitmap);
    texture.colorSpace = NoColorSpace;
    texture.flipY = false;
    texture.generateMipmaps = true;
    texture.minFilter = LinearMipmapLinearFilter;
    texture.needsUpdate = true;
    this.material.uniforms.frame.value = texture;
    this.hasFrame = true;
  }

  /** The map of ±: its colours end at `high` µm. */
  setSigma({ rows, columns, values }, high) {
    const data = new Uint16Array(2 * values.length);
    values.forEach((value, index) => {
      const known = Number.isFinite(value);
      data[2 * index] = DataUtils.toHalfFloat(known ? Math.min(value, 6e4) : 0);
      data[2 * index + 1] = DataUtils.toHalfFloat(known ? 1 : 0);
    });
    const texture = new DataTexture(data, columns, rows, RGFormat, HalfFloatType);
    texture.minFilter = texture.magFilter = LinearFilter;
    texture.needsUpdate = true;
    this.material.uniforms.sigma.value = texture;
    this.material.uniforms.sigmaHigh.value = high;
    this.sigmaHigh = high;
  }

  setSpace(space) {
    this.eye.space = space;
    this.draw();
  }

  setPage(page) {
    this.page = page;
    this.draw();
    return this.texture.want(this.wantedLevel, page).catch((error) => this.failed(error));
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.eye.resize(clientWidth, clientHeight);
    this.drawNow();
  }

  get wantedLevel() {
    const perPixel = this.eye.scale * this.renderer.getPixelRatio();
    const level = Math.floor(Math.log2(1 / perPixel) + 0.15);
    return Math.max(this.playing ? 1 : 0, Math.min(this.facts.levels - 1, level));
  }

  draw() {
    this.pending ??= requestAnimationFrame(() => this.drawNow());
  }

  drawNow() {
    if (this.pending) cancelAnimationFrame(this.pending);
    this.pending = null;
    if (this.gone) return;
    this.texture.want(this.wantedLevel, this.page).catch((error) => this.failed(error));
    const { uniforms } = this.material;
    const { space, scale } = this.eye;
    uniforms.space.value = space;
    uniforms.grid.value = !space && scale >= 12 && this.texture.finest === 0;
    uniforms.pixelSize.value = this.renderer.getPixelRatio();
    uniforms.backdrop.value.set(...styleColour("--stage"));
    uniforms.ink.value.set(...styleColour("--ink"));
    uniforms.raise.value = space ? uniforms.exaggeration.value / this.facts.pitch_um : 0;
    uniforms.base.value = (this.facts.low_um + this.facts.high_um) / 2;
    uniforms.squares.value = this.texture.showSquares(space ? 1 : scale);
    this.setMesh(space ? this.fullMesh : 1);
    const shownLevel = Math.log2(this.facts.columns / Math.max(2, this.meshSize));
    uniforms.lod.value = Math.max(0, shownLevel - this.texture.finest);
    this.renderer.setClearColor(new Color().setRGB(...uniforms.backdrop.value.toArray()), 1);
    this.eye.update(0);
    if (this.texture.finest < this.facts.levels) this.render(space);
    else this.renderer.clear();
    this.onview();
  }

  render(space) {
    const began = performance.now();
    this.renderer.render(this.scene, this.eye.camera);
    if (!space || this.fullMesh >= FINEST_MESH) return;
    this.renderer.getContext().finish();
    if (performance.now() - began < QUICK_MS) this.quick = (this.quick ?? 0) + 1;
    if (this.quick >= 4) {
      this.quick = 0;
      this.fullMesh = Math.min(FINEST_MESH, this.fullMesh * 2);
    }
  }

  /** A grid of cells with the aspect ratio of the height map. */
  setMesh(across) {
    if (across === this.meshSize) return;
    this.meshSize = across;
    this.mesh.geometry.dispose();
    this.mesh.geometry = net(across, Math.max(1, Math.round((across * this.facts.rows) / this.facts.columns)));
  }

  failed(error) {
    if (error.name !== "AbortError" && !this.gone) this.onerror(error);
  }

  dispose() {
    this.gone = true;
    this.observer.disconnect();
    document.removeEventListener("themechange", this.themed);
    this.texture.dispose();
    this.mesh.geometry.dispose();
    this.material.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

function net(across, down) {
  const position = new Float32Array(3 * (across + 1) * (down + 1));
  let next = 0;
  for (let row = 0; row <= down; row += 1) {
    for (let column = 0; column <= across; column += 1) {
      position[next] = column / across;
      position[next + 1] = row / down;
      next += 3;
    }
  }
  const index = new Uint32Array(6 * across * down);
  next = 0;
  for (let row = 0; row < down; row += 1) {
    for (let column = 0; column < across; column += 1) {
      const corner = row * (across + 1) + column;
      const below = corner + across + 1;
      index.set([corner, below, corner + 1, corner + 1, below, below + 1], next);
      next += 6;
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setIndex(new BufferAttribute(index, 1));
  return geometry;
}

function dataTexture(data, width, height) {
  const texture = new DataTexture(data, width, height, RGBAFormat, UnsignedByteType);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

function paletteTexture(colours) {
  return dataTexture(new Uint8Array(colours.flatMap((colour) => [...colour, 255])), colours.length, 1);
}
