// The page: chooses its part by the address.

import * as api from "./api.js";
import { batchPage } from "./batch.js";
import { comparePage } from "./compare.js";
import { copy, h } from "./dom.js";
import { setUpKeys } from "./keys.js";
import { libraryPage } from "./library.js";
import { livePage } from "./live.js";
import { scanPage } from "./scan.js";
import { setUpTheme } from "./theme.js";

const main = document.getElementById("main");
const where = document.getElementById("where");
let shown = null;
let turn = 0;
let palettes = null;

async function open(address) {
  palettes ??= await api.palettes();
  const [, place, first, second] = address.split("/");
  if (place === "scan" && first) return scanPage(first, palettes);
  if (place === "compare" && first && second) return comparePage(first, second, palettes);
  if (place === "live") return livePage(palettes);
  if (place === "batch") return batchPage();
  return libraryPage();
}

async function show() {
  turn += 1;
  const mine = turn;
  let page = null;
  let problem = null;
  try {
    page = await open(location.hash.slice(1));
  } catch (error) {
    problem = error;
  }
  if (mine !== turn) return;
  shown?.dispose();
  shown = page;
  where.textContent = page?.title ?? "";
  document.title = page?.title ? `${page.title} – Retrograph` : "Retrograph";
  main.replaceChildren(page ? page.element : h("div", { class: "library" }, h("h1", {}, "Not shown"),
    h("p", { class: "problem", role: "alert" }, problem.message), h("p", {}, h("a", { href: "#/" }, "Back to the list"))));
  try {
    page?.start();
  } catch (error) {
    const words = error.message.includes("WebGL")
      ? "This browser cannot draw in three dimensions (WebGL 2): switch hardware acceleration on, or use another browser."
      : error.message;
    main.prepend(h("p", { class: "problem", role: "alert" }, words));
  }
  main.scrollTop = 0;
  if (mine > 1) main.focus({ preventScroll: true });
}

/** A recipe that is dropped on a scan measures it. */
function drop(event) {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file && shown?.drop) shown.drop(file);
  else main.prepend(h("p", { class: "problem", role: "alert" }, "Open a scan first: a recipe that is dropped there measures it."));
}

async function begin() {
  setUpTheme(document.getElementById("theme-button"));
  setUpKeys(document.getElementById("keys-button"));
  document.getElementById("link-button").addEventListener("click", async () => copy(await api.link(), "Link to this page"));
  addEventListener("hashchange", show);
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", drop);
  if (!location.hash) {
    const { only, live } = await api.list({}).catch(() => ({ only: null }));
    if (live) history.replaceState(null, "", "#/live");
    else if (only) history.replaceState(null, "", `#/scan/${only}`);
  }
  await show();
}

begin();
