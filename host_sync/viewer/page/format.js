// Formatted numbers with their units.

/** A height, µm, with digits according to its size. */
export function micrometres(value, digits = null) {
  if (value === null || !Number.isFinite(value)) return "–";
  const places = digits ?? (Math.abs(value) >= 100 ? 1 : Math.abs(value) >= 1 ? 2 : 3);
  return `${value.toFixed(places).replace("-", "−")} µm`;
}

/** A height and its ±, to two digits of the ±. */
export function withSigma(value, sigma) {
  if (value === null || !Number.isFinite(value)) return "invalid";
  if (sigma === null || !Number.isFinite(sigma) || sigma <= 0) return micrometres(value);
  const places = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(sigma))));
  return `${value.toFixed(places).replace("-", "−")} ± ${sigma.toFixed(places)} µm`;
}

/** A lateral length. */
export function length(um) {
  return um >= 1000 ? `${Number((um / 1000).toPrecision(4))} mm` : `${Number(um.toPrecision(4))} µm`;
}

/** The largest number 1, 2 or 5 times a power of ten that does not exceed a positive value. */
export function roundBelow(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((step) => step * decade).find((step) => step <= value * (1 + 1e-9)) ?? decade;
}

/** Round values between two ends, about `most` of them. */
export function ticks(low, high, most = 6) {
  const span = high - low;
  if (!(span > 0)) return [low];
  let step = roundBelow(span / most);
  while (span / step > most) step = roundBelow(step * 2.6);
  const found = [];
  for (let index = Math.ceil(low / step - 1e-6); index * step <= high + step * 1e-6; index += 1) {
    found.push(Number((index * step).toPrecision(10)));
  }
  return found;
}

/** The label of a tick. */
export function plain(value) {
  return String(Number(value.toPrecision(6))).replace("-", "−");
}

/** Date and time by the device's clock. */
export function moment(text) {
  return text ? text.slice(0, 16).replace("T", " ") : "";
}

/** A fraction in percent. */
export function percent(share) {
  return `${Number((share * 100).toPrecision(2))} %`;
}

/** A measured number with its ±, which is not there yet before the answer is whole. */
export function numberText(one, whole) {
  return whole ? one.number : one.number.replace(", ± not known", " ± …");
}
