// Charts of the measured surface: material ratio with the construction of Sk, histogram of heights, power spectrum.

import { h, svg } from "./dom.js";
import { plain, ticks } from "./format.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [58, 12, 10, 36];
const [WIDTH, HEIGHT] = [340, 210];

/** A chart with axes: x and y are { low, high, words, labels? }, draw gets functions from values to places. */
export function chart(title, x, y, draw, { width = WIDTH, height = HEIGHT } = {}) {
  const across = (value) => LEFT + ((value - x.low) / (x.high - x.low || 1)) * (width - LEFT - RIGHT);
  const up = (value) => height - BOTTOM - ((value - y.low) / (y.high - y.low || 1)) * (height - TOP - BOTTOM);
  const drawing = svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
  const label = (axis, value) => (axis.labels ? axis.labels(value) : plain(value));
  for (const value of ticks(y.low, y.high, 6)) {
    drawing.append(svg("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: up(value), y2: up(value) }),
      word(LEFT - 6, up(value) + 4, label(y, value), "end"));
  }
  for (const value of ticks(x.low, x.high, Math.floor(width / 70))) {
    drawing.append(svg("line", { class: "grid", x1: across(value), x2: across(value), y1: TOP, y2: height - BOTTOM }),
      word(across(value), height - BOTTOM + 15, label(x, value), "middle"));
  }
  drawing.append(word((LEFT + width - RIGHT) / 2, height - 4, x.words, "middle", "axis"));
  const turned = word(12, (TOP + height - BOTTOM) / 2, y.words, "middle", "axis");
  turned.setAttribute("transform", `rotate(-90 12 ${(TOP + height - BOTTOM) / 2})`);
  drawing.append(turned, ...draw(across, up));
  return drawing;
}

export function word(x, y, text, anchor, kind = "tick") {
  const element = svg("text", { x, y, "text-anchor": anchor, class: kind });
  element.textContent = text;
  return element;
}

export const polyline = (points, kind) => svg("path", { class: kind, d: points.length ? `M${points.map(([x, y]) => `${x.toFixed(2)} ${y.toFixed(2)}`).join("L")}` : "" });

/** The figures of a measurement's answer. */
export function figures(found) {
  const shown = [];
  if (found.ratio) shown.push(figure("Material ratio (Abbott curve) with the construction of Sk", ratioChart(found.ratio), ratioWords(found.ratio)));
  if (found.histogram) shown.push(figure("Histogram of heights", histogramChart(found.histogram), ""));
  if (found.spectrum) shown.push(figure("Power spectral density", spectrumChart(found.spectrum), ""));
  return shown;
}

function figure(title, drawing, words) {
  return h("figure", { class: "figure" }, drawing, h("figcaption", {}, title, words ? `: ${words}` : ""));
}

function ratioWords({ parameters }) {
  const { Sk, Spk, Svk, Smr1, Smr2 } = parameters;
  const um = (value) => `${plain(Number(value.toPrecision(4)))} µm`;
  return `Sk ${um(Sk)}, Spk ${um(Spk)}, Svk ${um(Svk)}, Smr1 ${Smr1.toFixed(1)} %, Smr2 ${Smr2.toFixed(1)} %`;
}

function ratioChart({ percent, height_um, core_um, parameters }) {
  const [top, bottom] = core_um;
  const { Spk, Svk, Smr1, Smr2 } = parameters;
  const low = Math.min(height_um.at(-1), bottom - Svk);
  const high = Math.max(height_um[0], top + Spk);
  return chart("Material ratio curve: height over the share of the area that lies above it", { low: 0, high: 100, words: "material ratio, %" },
    { low, high, words: "height, µm" }, (x, y) => {
      const level = (um, kind) => svg("line", { class: kind, x1: x(0), x2: x(100), y1: y(um), y2: y(um) });
      const triangle = (points) => svg("path", { class: "core-area", d: `M${points.map(([a, b]) => `${x(a)} ${y(b)}`).join("L")}Z` });
      return [
        triangle([[0, top], [0, top + Spk], [Smr1, top]]), triangle([[100, bottom], [100, bottom - Svk], [Smr2, bottom]]),
        level(top, "core-level"), level(bottom, "core-level"),
        polyline([[x(0), y(top)], [x(100), y(bottom)]], "core-line"),
        polyline(percent.map((share, at) => [x(share), y(height_um[at])]), "curve"),
        word(x(0) + 4, Math.max(TOP + 10, y(top) - 5), "Spk", "start", "axis"), word(x(100) - 4, (y(top) + y(bottom)) / 2 + 4, "Sk", "end", "axis"),
        word(x(100) - 4, Math.min(HEIGHT - BOTTOM - 4, y(bottom) + 14), "Svk", "end", "axis"),
      ];
    });
}

function histogramChart({ edges_um, percent }) {
  return chart("Histogram: share of the area by height", { low: edges_um[0], high: edges_um.at(-1), words: "height from the mean, µm" },
    { low: 0, high: Math.max(...percent), words: "area, %" }, (x, y) => percent.map((share, at) => svg("rect", { class: "column",
      x: x(edges_um[at]), width: Math.max(0.5, x(edges_um[at + 1]) - x(edges_um[at]) - 0.5), y: y(share), height: y(0) - y(share) })));
}

function spectrumChart({ frequency_per_um, density_um3 }) {
  const points = frequency_per_um.map((one, at) => [Math.log10(one), Math.log10(density_um3[at])]).filter(([a, b]) => Number.isFinite(a) && Number.isFinite(b));
  const range = (axis) => [Math.min(...points.map((one) => one[axis])), Math.max(...points.map((one) => one[axis]))];
  const [[left, right], [low, high]] = [range(0), range(1)];
  const labels = (value) => plain(Number((10 ** value).toPrecision(2)));
  return chart("Power spectral density over spatial frequency, both logarithmic", { low: left, high: right, words: "frequency, 1/µm", labels },
    { low, high, words: "density, µm³", labels }, (x, y) => [polyline(points.map(([a, b]) => [x(a), y(b)]), "curve")]);
}
