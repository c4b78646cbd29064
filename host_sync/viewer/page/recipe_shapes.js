// Shapes of a recipe: how each kind is drawn, moved and typed. Places are µm: [right, down].

const line = { forms: [{ form: "line", keys: ["from_um", "to_um"] }] };
const rectangle = (...keys) => ({ forms: keys.map((key) => ({ form: "rectangle", key })) });

/** Kinds that have a name: tool's words, first name, geometry. */
export const KINDS = {
  step: { words: "Step", ...line, defaults: { kind: "step" } },
  profile: { words: "Line", ...line, defaults: {} },
  distance: { words: "Distance", ...line, defaults: {} },
  circle: { words: "Circle", forms: [{ form: "circle", keys: ["centre_um", "radius_um"] }], defaults: {} },
  radius: { words: "Sphere", ...rectangle("region_um"), defaults: {} },
  angle: { words: "Angle", ...rectangle("first_um", "second_um"), defaults: {} },
  volume: { words: "Volume", ...rectangle("region_um"), defaults: {} },
};

const round = (um) => Math.round(um * 10) / 10;
const place = ([right, down]) => [round(right), round(down)];

export function sorted([left, top, right, bottom]) {
  return [Math.min(left, right), Math.min(top, bottom), Math.max(left, right), Math.max(top, bottom)].map(round);
}

/** A new item of a kind from the two ends of a drag; field: [right, down] of the last pixel. */
export function drawn(kind, from, to, field) {
  const rect = sorted([...from, ...to]);
  const make = {
    step: () => ({ from_um: place(from), to_um: place(to) }),
    circle: () => ({ centre_um: place(from), radius_um: Math.max(1, round(Math.hypot(to[0] - from[0], to[1] - from[1]))) }),
    radius: () => ({ region_um: rect }),
    volume: () => ({ region_um: rect, border_um: Math.max(1, round((rect[2] - rect[0]) / 20)) }),
    angle: () => ({ first_um: rect, second_um: beside(rect, field) }),
  };
  return { ...KINDS[kind].defaults, ...(make[kind] ?? make.step)() };
}

/** A rectangle of the same size beside another, inside the field. */
function beside([left, top, right, bottom], field) {
  const width = right - left;
  const shift = right + 1.2 * width <= field[0] ? 1.2 * width : -Math.min(1.2 * width, left);
  return [left + shift, top, right + shift, bottom].map(round);
}

/** Handles of an item: where each is, and the item after it was moved. */
export function handles(kind, item) {
  return KINDS[kind].forms.flatMap((shape) => shapeHandles(shape, item));
}

export function shapeHandles({ form, key, keys }, item) {
  if (form === "line") {
    return keys.map((name) => ({ at: item[name], moved: (to) => ({ ...item, [name]: place(to) }) }));
  }
  if (form === "circle") {
    const [centre, radius] = [item[keys[0]], item[keys[1]]];
    return [
      { at: centre, moved: (to) => ({ ...item, [keys[0]]: place(to) }) },
      { at: [centre[0] + radius, centre[1]], moved: (to) => ({ ...item,
        [keys[1]]: Math.max(1, round(Math.hypot(to[0] - centre[0], to[1] - centre[1]))) }) },
    ];
  }
  const [left, top, right, bottom] = item[key];
  return [
    { at: [left, top], moved: (to) => ({ ...item, [key]: sorted([...to, right, bottom]) }) },
    { at: [right, bottom], moved: (to) => ({ ...item, [key]: sorted([left, top, ...to]) }) },
  ];
}

/** Numbers of an item that can be typed: words, value, the item after it was changed. */
export function numbers(kind, item) {
  const names = { from_um: ["from right", "from down"], to_um: ["to right", "to down"], centre_um: ["centre right", "centre down"] };
  const sides = ["left", "top", "right", "bottom"];
  const found = [];
  for (const [key, value] of Object.entries(item)) {
    if (!key.endsWith("_um") || key === "edges_um") continue;
    if (Array.isArray(value)) {
      const words = names[key] ?? sides.map((side) => (kind === "angle" ? `${key.replace("_um", "")} ${side}` : side));
      value.forEach((number, at) => found.push({ words: words[at], value: number, changed: (next) => ({ ...item,
        [key]: value.map((old, index) => (index === at ? next : old)) }) }));
    } else found.push({ words: key.replace("_um", "").replaceAll("_", " "), value, changed: (next) => ({ ...item, [key]: next }) });
  }
  if (["step", "profile"].includes(kind) && item.width_um === undefined) {
    found.push({ words: "width", value: 0, changed: (next) => ({ ...item, width_um: next }) });
  }
  return found;
}

/** The name of the next item of a kind. */
export function nextName(recipe, kind) {
  const used = new Set(Object.keys(KINDS).flatMap((one) => (recipe[one] ?? []).map((item) => item.name)));
  let number = 1;
  while (used.has(`${KINDS[kind].words.toLowerCase()} ${number}`)) number += 1;
  return `${KINDS[kind].words.toLowerCase()} ${number}`;
}
