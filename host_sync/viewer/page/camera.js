// Camera: the map from above, or orbit around a point. Lengths are pixels of the height map.

import { MathUtils, OrthographicCamera, PerspectiveCamera, Vector3 } from "./vendor/three.module.js";

const FIELD_DEG = 28;
const MAX_ZOOM = 64;

export class Eye {
  constructor(size) {
    this.size = size; // { rows, columns }
    this.space = false;
    this.flat = new OrthographicCamera(-1, 1, 1, -1, -1e6, 1e6);
    this.deep = new PerspectiveCamera(FIELD_DEG, 1, 1, 1e6);
    this.deep.up.set(0, 0, 1);
    this.view = { width: 1, height: 1 };
    this.fit();
  }

  get camera() {
    return this.space ? this.deep : this.flat;
  }

  resize(width, height) {
    const fitted = Math.abs(this.zoom - this.fittingZoom) < 1e-6 * this.zoom;
    const before = this.reach;
    this.view = { width: Math.max(1, width), height: Math.max(1, height) };
    this.distance *= this.reach / before;
    if (fitted) this.zoom = this.fittingZoom;
  }

  get fittingZoom() {
    return 0.94 * Math.min(this.view.width / this.size.columns, this.view.height / this.size.rows);
  }

  /** Show everything. */
  fit() {
    this.centre = { row: (this.size.rows - 1) / 2, column: (this.size.columns - 1) / 2 };
    this.zoom = this.fittingZoom;
    this.azimuth = -62;
    this.elevation = 42;
    this.distance = this.reach;
  }

  /** Distance in space from which everything is seen. */
  get reach() {
    const half = Math.hypot(this.size.rows, this.size.columns) / 2;
    return (half / Math.tan(MathUtils.degToRad(FIELD_DEG / 2))) * Math.max(1, (1.25 * this.view.height) / this.view.width) * 0.87;
  }

  /** Screen pixels per pixel of the height map, at the centre of the view. */
  get scale() {
    if (!this.space) return this.zoom;
    return this.view.height / (2 * this.distance * Math.tan(MathUtils.degToRad(FIELD_DEG / 2)));
  }

  setScale(scale) {
    const bounded = Math.min(MAX_ZOOM, Math.max(this.fittingZoom / 8, scale));
    if (this.space) this.distance *= this.scale / bounded;
    else this.zoom = bounded;
  }

  /** Zoom by a factor about a fixed place of the screen. */
  zoomAt(factor, x = this.view.width / 2, y = this.view.height / 2) {
    const before = this.place(x, y);
    this.setScale(this.scale * factor);
    if (this.space) return;
    const after = this.place(x, y);
    this.centre.row += before.row - after.row;
    this.centre.column += before.column - after.column;
    this.keepInside();
  }

  /** Pan by screen pixels. */
  pan(right, down) {
    const scale = this.scale;
    if (!this.space) {
      this.centre.column -= right / scale;
      this.centre.row -= down / scale;
    } else {
      const turn = MathUtils.degToRad(this.azimuth);
      const far = down / Math.max(0.25, Math.sin(MathUtils.degToRad(this.elevation)));
      this.centre.column += (Math.sin(turn) * right - Math.cos(turn) * far) / scale;
      this.centre.row += (Math.cos(turn) * right + Math.sin(turn) * far) / scale;
    }
    this.keepInside();
  }

  orbit(turn, rise) {
    this.azimuth = ((((this.azimuth + turn + 180) % 360) + 360) % 360) - 180;
    this.elevation = Math.min(89.9, Math.max(3, this.elevation + rise));
  }

  keepInside() {
    this.centre.row = Math.min(this.size.rows, Math.max(0, this.centre.row));
    this.centre.column = Math.min(this.size.columns, Math.max(0, this.centre.column));
  }

  /** The place of the height map under a place of the screen; map view only. */
  place(x, y) {
    return {
      row: this.centre.row + (y - this.view.height / 2) / this.zoom,
      column: this.centre.column + (x - this.view.width / 2) / this.zoom,
    };
  }

  /** The place of the screen of a place of the height map; `z` in pixels. */
  screen(row, column, z = 0) {
    const { width, height } = this.view;
    const seen = new Vector3(column, -row, z).project(this.camera);
    return { x: ((seen.x + 1) / 2) * width, y: ((1 - seen.y) / 2) * height, inFront: seen.z < 1 };
  }

  /** Place the camera; `z` is the middle of the heights, px. */
  update(z = 0) {
    const { width, height } = this.view;
    const { row, column } = this.centre;
    if (this.space) {
      const [turn, rise] = [this.azimuth, this.elevation].map(MathUtils.degToRad);
      const away = new Vector3(Math.cos(turn) * Math.cos(rise), Math.sin(turn) * Math.cos(rise), Math.sin(rise));
      this.deep.aspect = width / height;
      this.deep.near = Math.max(0.5, this.distance / 200);
      this.deep.far = this.distance * 20 + 10 * Math.hypot(this.size.rows, this.size.columns);
      this.deep.position.set(column, -row, z).addScaledVector(away, this.distance);
      this.deep.lookAt(column, -row, z);
    } else {
      this.flat.left = -width / 2 / this.zoom;
      this.flat.right = width / 2 / this.zoom;
      this.flat.top = height / 2 / this.zoom;
      this.flat.bottom = -height / 2 / this.zoom;
      this.flat.position.set(column, -row, 0);
    }
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }
}
