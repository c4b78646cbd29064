// Draws a recipe's shapes over the relief, and turns drags into new and moved ones.

import { svg } from "./dom.js";
import { numberText } from "./format.js";
import { drawn, handles, KINDS, nextName, shapeHandles, sorted } from "./recipe_shapes.js";

const REGION = { form: "rectangle", key: "region_um" };
const SIGN_PX = 8; // at most, of a label's letters
const LINE_PX = 17;
const MARKS = { pass: "✓", fail: "✗", undecided: "?" };

export class Shapes {
  /**
   * history : of the recipe
   * onchange : called after each change; with true when the change is complete
   */
  constructor(stage, history, onchange) {
    this.stage = stage;
    this.history = history;
    this.onchange = onchange;
    this.tool = null;
    this.brush_um = 40 * stage.facts.pitch_um;
    this.found = null;
  }

  get field() {
    const { rows, columns, pitch_um } = this.stage.facts;
    return [(columns - 1) * pitch_um, (rows - 1) * pitch_um];
  }

  um({ row, column }) {
    return [column * this.stage.facts.pitch_um, row * this.stage.facts.pitch_um];
  }

  screen([right, down]) {
    const { pitch_um } = this.stage.facts;
    return this.stage.relief.eye.screen(down / pitch_um, right / pitch_um);
  }

  /** Begin a drag; false when it is not for a shape. */
  begin(at, event) {
    const name = event.target.dataset?.handle;
    const { recipe } = this.history;
    if (name) {
      const [kind, index, number] = name.split(":");
      this.drag = (to) => {
        const now = this.history.recipe;
        if (kind === "region") return { ...now, ...shapeHandles(REGION, now)[number].moved(to) };
        if (kind === "level") return { ...now, level: { ...now.level, points_um: now.level.points_um.map((old, i) => (i === Number(number) ? to : old)) } };
        return { ...now, [kind]: now[kind].map((item, i) => (i === Number(index) ? handles(kind, item)[number].moved(to) : item)) };
      };
      return true;
    }
    if (!this.tool || this.stage.tool !== "measure") return false;
    const from = this.um(at);
    if (this.tool === "mask") {
      const points = [from];
      this.drag = (to) => {
        points.push(to);
        return { ...recipe, mask: [...(recipe.mask ?? []), { points_um: points.map((one) => one.map(Math.round)), width_um: this.brush_um }] };
      };
      this.move(at);
    } else if (this.tool === "points") {
      const before = recipe.level?.on === "points" ? recipe.level.points_um : this.waiting ?? [];
      this.drag = (to) => this.levelled(recipe, [...before, to]);
      this.move(at);
    } else this.drag = (to) => this.made(this.tool, from, to, recipe);
    return true;
  }

  /** The recipe with a point more to level on; fewer than three wait. */
  levelled(recipe, points) {
    this.waiting = points.length < 3 ? points : null;
    return points.length < 3 ? recipe : { ...recipe, level: { on: "points", points_um: points } };
  }

  /** The recipe with a new shape between two places. */
  made(kind, from, to, recipe) {
    if (kind === "region") return { ...recipe, region_um: sorted([...from, ...to]) };
    if (kind === "level line") return { ...recipe, level: { on: "line", points_um: [from, to] } };
    if (kind === "level plane") {
      return { ...recipe, level: { on: "plane", regions_um: [sorted([...from, ...to])] } };
    }
    return { ...recipe, [kind]: [...(recipe[kind] ?? []), { name: nextName(recipe, kind), ...drawn(kind, from, to, this.field) }] };
  }

  move(at) {
    const next = this.drag(this.um(at));
    this.history.draft(next);
    this.onchange(false);
  }

  end() {
    this.drag = null;
    this.history.commit(this.history.recipe);
    this.onchange(true);
  }

  /** A shape of the chosen tool in the middle of the view, for those who do not draw. */
  place() {
    const { eye } = this.stage.relief;
    const [right, down] = this.um(eye.centre);
    const reach = (0.2 * Math.min(eye.view.width, eye.view.height) * this.stage.facts.pitch_um) / eye.scale;
    const keep = ([x, y]) => [Math.min(this.field[0], Math.max(0, x)), Math.min(this.field[1], Math.max(0, y))];
    const { recipe } = this.history;
    const lines = ["step", "profile", "distance", "level line"].includes(this.tool);
    let from = keep([right - reach, lines ? down : down - reach]);
    const to = keep([right + reach, lines ? down : down + reach]);
    let next;
    if (this.tool === "mask") next = { ...recipe, mask: [...(recipe.mask ?? []), { points_um: [[right, down]], width_um: this.brush_um }] };
    else if (this.tool === "points") next = { ...recipe, level: { on: "points", points_um: [from, [to[0], from[1]], to] } };
    else {
      if (this.tool === "circle") from = [right, down];
      next = this.made(this.tool, from, this.tool === "circle" ? [Math.min(right + reach, this.field[0]), down] : to, recipe);
    }
    this.history.commit(next);
    this.onchange(true);
  }

  /** Elements of the overlay. */
  draw() {
    if (this.stage.relief.eye.space) return [];
    this.labels = [];
    const { recipe } = this.history;
    const parts = (recipe.mask ?? []).map((stroke) => this.stroke(stroke));
    for (const region of recipe.level?.regions_um ?? []) parts.push(...this.outline(this.rectangle(region), "level"));
    const points = recipe.level?.points_um ?? this.waiting ?? [];
    if (recipe.level?.on === "line") parts.push(...this.outline(this.path(points), "level"));
    parts.push(...points.map((at, number) => this.handle(at, recipe.level ? `level:0:${number}` : null)));
    if (recipe.region_um) {
      parts.push(...this.outline(this.rectangle(recipe.region_um), "region"));
      parts.push(...shapeHandles(REGION, recipe).map(({ at }, number) => this.handle(at, `region:0:${number}`)));
    }
    for (const kind of Object.keys(KINDS)) (recipe[kind] ?? []).forEach((item, index) => parts.push(...this.item(kind, item, index)));
    return parts;
  }

  item(kind, item, index) {
    const numbers = (this.found?.quantities ?? []).filter((one) => one.subject === item.name);
    const verdicts = numbers.map((one) => one.limits?.verdict).filter(Boolean);
    const verdict = ["fail", "undecided", "pass"].find((one) => verdicts.includes(one)) ?? "";
    const parts = KINDS[kind].forms.flatMap((shape) => this.outline(this.shape(shape, item), verdict));
    for (const um of this.found?.steps?.find((one) => one.name === item.name)?.edges_um ?? []) parts.push(this.edge(item, um));
    const main = numbers[0]?.value === null || !numbers.length ? "" : `: ${numberText(numbers[0], this.found.whole)}`;
    const words = `${MARKS[verdict] ? `${MARKS[verdict]} ` : ""}${item.name}${main}`;
    return [...parts, this.label(words, this.screen(handles(kind, item).at(-1).at)), ...handles(kind, item).map((one, number) => this.handle(one.at, `${kind}:${index}:${number}`))];
  }

  /** Words beside a handle, below those of other shapes that would lie over them. */
  label(words, handle) {
    const left = handle.x + 12;
    const right = left + SIGN_PX * words.length;
    let y = handle.y - 8;
    const covered = (one) => left < one.right && one.left < right && Math.abs(one.y - y) < LINE_PX;
    while (this.labels.some(covered)) y += LINE_PX;
    this.labels.push({ left, right, y });
    const element = svg("text", { x: left, y, class: "label" });
    element.textContent = words;
    return element;
  }

  shape({ form, key, keys }, item) {
    if (form === "line") return this.path(keys.map((name) => item[name]));
    if (form === "rectangle") return this.rectangle(item[key]);
    const middle = this.screen(item[keys[0]]);
    const radius = Math.hypot(...[this.screen([item[keys[0]][0] + item[keys[1]], item[keys[0]][1]])].map((end) => end.x - middle.x));
    return `M${middle.x - radius} ${middle.y}a${radius} ${radius} 0 1 0 ${2 * radius} 0a${radius} ${radius} 0 1 0 ${-2 * radius} 0Z`;
  }

  path(places) {
    return `M${places.map((one) => this.screen(one)).map(({ x, y }) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}`;
  }

  rectangle([left, top, right, bottom]) {
    return `${this.path([[left, top], [right, top], [right, bottom], [left, bottom]])}Z`;
  }

  outline(d, kind) {
    return [svg("path", { d, class: "under" }), svg("path", { d, class: `over ${kind}` })];
  }

  edge({ from_um, to_um }, um) {
    const share = um / Math.hypot(to_um[0] - from_um[0], to_um[1] - from_um[1]);
    const { x, y } = this.screen([0, 1].map((axis) => from_um[axis] + share * (to_um[axis] - from_um[axis])));
    return svg("path", { d: `M${x - 5} ${y - 5}L${x + 5} ${y + 5}M${x - 5} ${y + 5}L${x + 5} ${y - 5}`, class: "edge" });
  }

  stroke({ points_um, width_um }) {
    const at = points_um.length > 1 ? points_um : [points_um[0], points_um[0]];
    const width = (width_um / this.stage.facts.pitch_um) * this.stage.relief.eye.scale;
    return svg("path", { d: this.path(at), class: "painted", "stroke-width": Math.max(1, width) });
  }

  handle(at, name) {
    const { x, y } = this.screen(at);
    return svg("circle", { cx: x, cy: y, r: 7, class: "end", ...(name ? { "data-handle": name } : {}) });
  }
}
