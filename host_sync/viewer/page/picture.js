// The stage as a picture: relief, what is drawn on it, title, doubts, colour bar and scale bar.

import { h } from "./dom.js";

const STYLES = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-opacity", "stroke-dasharray", "stroke-linecap", "paint-order", "font-family", "font-size"];
const LINE_PX = 20;
const SIDE_PX = 16;

/** A PNG of a stage, in pixels of the screen. */
export async function picture({ facts, surface, canvas, lines, legend, scale }) {
  const { clientWidth: width, clientHeight: height } = surface;
  const said = facts.doubts.map((words) => `⚠ Doubt: ${words}`);
  const ratio = canvas.width / width;
  const tall = height + 84 + said.length * LINE_PX;
  const whole = h("canvas", { width: Math.round(width * ratio), height: Math.round(tall * ratio) });
  const draw = whole.getContext("2d");
  const style = getComputedStyle(document.body);
  draw.scale(ratio, ratio);
  draw.fillStyle = style.backgroundColor;
  draw.fillRect(0, 0, width, tall);
  draw.drawImage(canvas, 0, 0, width, height);
  draw.drawImage(await drawn(lines, width, height), 0, 0, width, height);
  draw.fillStyle = draw.strokeStyle = style.color;
  draw.font = `14px ${style.fontFamily}`;
  draw.fillText(facts.title, SIDE_PX, height + 22, width - 2 * SIDE_PX);
  said.forEach((words, at) => draw.fillText(words, SIDE_PX, height + 22 + (at + 1) * LINE_PX, width - 2 * SIDE_PX));
  const foot = height + 36 + said.length * LINE_PX;
  if (!legend.element.hidden) {
    draw.fillText(legend.title.textContent, SIDE_PX, foot + 10);
    draw.drawImage(legend.canvas, SIDE_PX, foot + 16, 190, 10);
    draw.drawImage(await drawn(legend.marks, 206, 20), SIDE_PX, foot + 26, 206, 20);
  }
  if (!scale.element.hidden) {
    const long = parseFloat(scale.bar.style.width);
    draw.fillRect(width - SIDE_PX - long, foot + 16, long, 4);
    draw.textAlign = "right";
    draw.fillText(scale.words.textContent, width - SIDE_PX, foot + 38);
  }
  return new Promise((done) => whole.toBlob(done, "image/png"));
}

/** A drawing as an image, with the style that it has on the page. */
async function drawn(element, width, height) {
  const copy = element.cloneNode(true);
  const [inside, copies] = [element, copy].map((one) => one.querySelectorAll("*"));
  copies.forEach((one, at) => STYLES.forEach((name) => one.style.setProperty(name, getComputedStyle(inside[at]).getPropertyValue(name))));
  for (const [name, value] of Object.entries({ width, height, viewBox: `0 0 ${width} ${height}`, xmlns: "http://www.w3.org/2000/svg" })) copy.setAttribute(name, value);
  const href = URL.createObjectURL(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
  const image = new Image(width, height);
  image.src = href;
  await image.decode();
  URL.revokeObjectURL(href);
  return image;
}
