// Requests to the viewer. A refusal becomes an Error with its sentence.

async function ask(path, options = {}) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error("The viewer does not answer: start retrosync view again.");
  }
  if (answer.ok) return answer;
  const kind = answer.headers.get("Content-Type") ?? "";
  if (kind.startsWith("application/json")) throw new Error((await answer.json()).error);
  if (answer.status >= 500) throw new Error("The viewer failed: see its terminal.");
  throw new Error("This tab's session has ended: open the link that retrosync view printed.");
}

const json = async (path, options) => (await ask(path, options)).json();

/** The entries that match; `apart` is what tells one from others with its title. */
export async function list(filters) {
  const listing = await json(`/api/list?${new URLSearchParams(filters)}`);
  const count = new Map();
  for (const { title } of listing.entries) count.set(title, (count.get(title) ?? 0) + 1);
  for (const one of listing.entries) {
    if (count.get(one.title) > 1) one.apart = [one.scan_id === one.title ? null : one.scan_id, one.place].filter(Boolean).join(", ");
  }
  return listing;
}

export const link = async () => (await json("/api/link")).link + location.hash;
export const facts = (key) => json(`/api/scan/${key}`);
export const live = () => json("/api/live");
export const palettes = () => json("/api/palettes");
export const thumbnail = (entry) => `/api/scan/${entry.key}/thumbnail?${entry.stamp}`;
export const height = (key, page, row, column) =>
  json(`/api/scan/${key}/height?${new URLSearchParams({ page, row, column })}`);
/** near: down_um, right_um, turn_deg and pinned ("1") as a person gave them, or nothing. */
export const compare = (first, second, near = {}) =>
  json(`/api/compare?${new URLSearchParams({ first, second, ...near })}`, { method: "POST" });

/** A measurement by a recipe ({ text } or its keys); samples: whether ± are computed, which takes longer. */
export const measure = (key, page, recipe, samples) => json(`/api/scan/${key}/measure?${new URLSearchParams({ page,
  samples: samples ? 1 : 0 })}`, { method: "POST", body: JSON.stringify(recipe) });

/** Give a scan of a library { name, tags, note, loaded }; loaded is the label that the change was made from. */
export const label = (key, words) => json(`/api/scan/${key}/label`, { method: "POST", body: JSON.stringify(words) });

/** The trend of { values, sigmas, unit, low, high, coverage_factor, warnings } over scans. */
export const trend = (numbers) => json("/api/trend", { method: "POST", body: JSON.stringify(numbers) });

/** Address of a profile; a line is { row_0, column_0, row_1, column_1 }. */
export const profileAddress = (key, page, line, form = "json") =>
  `/api/scan/${key}/profile?${new URLSearchParams({ ...line, page, form })}`;
export const text = async (path) => (await ask(path)).text();
export const profile = (key, page, line) => json(profileAddress(key, page, line));

/** Some rows of a level: half floats (4 a pixel) and bytes (1 a pixel). */
export async function levelRows(key, page, level, first, last, signal) {
  const words = new URLSearchParams({ page, first, last });
  const answer = await ask(`/api/scan/${key}/level/${level}?${words}`, { signal });
  const pixels = Number(answer.headers.get("X-Rows")) * Number(answer.headers.get("X-Columns"));
  const data = await answer.arrayBuffer();
  return { surface: new Uint16Array(data, 0, 4 * pixels), valid: new Uint8Array(data, 8 * pixels, pixels) };
}

/** The map of ±, reduced: { rows, columns, values }. */
export async function sigma(key) {
  const answer = await ask(`/api/scan/${key}/sigma`);
  const [rows, columns] = ["X-Rows", "X-Columns"].map((name) => Number(answer.headers.get(name)));
  return { rows, columns, values: new Float32Array(await answer.arrayBuffer()) };
}

export const frame = async (key) => createImageBitmap(await (await ask(`/api/scan/${key}/frame`)).blob());
