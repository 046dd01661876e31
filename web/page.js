// The page: what is looked at, the settings, and the loop from a picture to what is drawn.
import { drawStage } from "./drawing.js";
import { fetched, startEngine } from "./engine.js";
import { Camera, pictureOf, pixelsOf } from "./pictures.js";
import { report } from "./selftest.js";

const byId = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
const EXAMPLE = ["vendor/palace.jpg", "vendor/view.png"];
const sides = [null, null];  // {name, bitmap, found}: the first is what the second, and the camera, is matched with
let engine = null, camera = null, pairs = null, own = null, frames = [], shown = 0, starts = 0;

function say(error) {
  byId("error").hidden = !error;
  byId("error").textContent = error ? String(error.message || error) : "";
}

// Do something that may fail, and show why it did.
async function attempt(action) {
  try {
    say(null);
    await action();
  } catch (error) {
    say(error);
  }
}

const setting = (id) => Number(byId(id).value);
const here = () => sides.filter((side) => side !== null);

async function start() {
  const mine = ++starts, threads = query.has("threads") ? Number(query.get("threads")) : undefined;
  engine?.close();
  engine = null;
  byId("runs-on").textContent = "Loading the model ...";
  let started;
  try {
    started = await startEngine(byId("provider").value, own, threads);
  } catch (error) {
    if (mine !== starts) return;
    byId("runs-on").textContent = "No model is loaded.";
    throw error;
  }
  if (mine !== starts) return started.close();  // another was asked for in the meantime
  engine = started;
  const settings = own ? "the settings that it was exported with" : "the settings \u201cfast\u201d: the network sees a third of the width and height";
  const refused = engine.refused ? ` WebGPU refused the model: ${engine.refused}.` : "";
  byId("runs-on").textContent = `${engine.name} on ${engine.place}, with ${settings}.${refused}`;
  await lookAgain();
}

// Keypoints of a side, their places in pixels of its picture.
async function look(side) {
  const pixels = pixelsOf(side.bitmap, setting("size"));
  const [x, y] = [side.bitmap.width / pixels.width, side.bitmap.height / pixels.height];
  const size = `${pixels.width}x${pixels.height}`;
  const found = await engine.detect(pixels);
  found.places = found.keypoints.map((place, i) => (place + 0.5) * (i % 2 ? y : x) - 0.5);
  side.found = { ...found, size };
}

async function lookAgain() {
  if (!engine) return;
  for (const side of here()) if (side.bitmap !== camera?.bitmap) await look(side);
  await matchAgain();
}

async function matchAgain() {
  const count = setting("count"), ready = here().filter((side) => side.found);
  for (const side of ready) side.count = Math.min(count, side.found.scores.length);
  pairs = null;
  if (engine && ready.length === 2 && byId("lines").checked) {
    const [first, second] = ready.map((side) => side.found.descriptors.subarray(0, side.count * side.found.dim));
    const found = await engine.match(first, second, ready[0].found.dim, setting("ratio"));
    if (ready.some((side) => !sides.includes(side))) return;  // something else is looked at by now
    pairs = found;
  }
  show();
}

function show() {
  const ready = here();
  drawStage(byId("stage"), ready, pairs || [], byId("overlay").checked);
  if (camera && performance.now() - shown < 400) return;  // numbers that change faster can't be read
  shown = performance.now();
  const texts = ready.filter((side) => side.found).map(({ name, count, found }) =>
    `${name}: ${count} keypoints, ${found.size}, ${found.ms.toFixed(0)} ms`);
  if (pairs) texts.push(`${pairs.length} matches`);
  if (camera && frames.length > 1) {
    texts.push(`${((1000 * (frames.length - 1)) / (frames.at(-1) - frames[0])).toFixed(1)} frames/s`);
  }
  byId("status").textContent = texts.join("   \u00b7   ") || "Nothing to look at yet: take the camera, images or the example.";
}

async function put(place, name, blob) {
  sides[place] = { name, bitmap: await pictureOf(blob, name), found: null, count: 0 };
}

// One image or two; with the camera on, the first is what it is matched with.
async function takeImages(named) {
  if (!camera || named.length > 1) stopCamera();
  const places = sides.length - (camera ? 1 : 0);
  for (const [i, { name, blob }] of named.slice(0, places).entries()) await put(i, name, blob);
  if (!camera && named.length === 1) sides[1] = null;
  pairs = null;
  show();
  await lookAgain();
}

async function takeAddresses(addresses) {
  const named = addresses.map(async (url) => ({ name: url.split("/").pop(), blob: await (await fetched(url)).blob() }));
  await takeImages(await Promise.all(named));
}

async function live(mine) {
  while (camera === mine) {
    const bitmap = await mine.frame(setting("size"));
    const next = { name: "camera", bitmap, found: null, count: 0 };
    const at = engine;
    try {
      if (at) await look(next);
    } catch (error) {
      if (engine === at) throw error;  // else it was closed for another, which sees the next frame
    }
    if (camera !== mine) return;
    if (sides[1]?.bitmap !== sides[0]?.bitmap) sides[1]?.bitmap.close();
    sides[1] = next;
    mine.bitmap = bitmap;
    frames = [...frames.slice(-29), performance.now()];
    await matchAgain();
    await new Promise(requestAnimationFrame);
  }
}

async function takeCamera() {
  if (camera) return stopCamera();
  const opened = await Camera.open();
  camera = opened;
  frames = [];
  sides[1] = null;
  pairs = null;
  cameraButtons();
  live(opened).catch((error) => {
    if (camera === opened) stopCamera();
    say(error);
  });
}

function stopCamera() {
  camera?.stop();
  camera = null;
  cameraButtons();
  show();
}

function cameraButtons() {
  byId("camera").setAttribute("aria-pressed", String(camera !== null));
  byId("keep").disabled = camera === null;
}

function listen() {
  const click = (id, action) => byId(id).addEventListener("click", () => attempt(action));
  click("camera", takeCamera);
  click("keep", () => {
    if (sides[1]) sides[0] = { ...sides[1], name: "kept frame" };
  });
  click("example", () => takeAddresses(EXAMPLE));
  click("clear", () => {
    stopCamera();
    sides.fill(null);
    pairs = null;
    show();
  });
  byId("images").addEventListener("change", () => attempt(async () => {
    const files = Array.from(byId("images").files, (blob) => ({ name: blob.name, blob }));
    byId("images").value = "";
    if (files.length) await takeImages(files);
  }));
  byId("model").addEventListener("change", () => attempt(async () => {
    const [file] = byId("model").files;
    own = file ? { name: file.name, bytes: await file.arrayBuffer() } : null;
    byId("model").value = "";
    await start();
  }));
  byId("provider").addEventListener("change", () => attempt(start));
  for (const [id, action] of [["size", lookAgain], ["count", matchAgain], ["ratio", matchAgain]]) {
    byId(id).addEventListener("input", showSettings);
    byId(id).addEventListener("change", () => attempt(action));
  }
  byId("overlay").addEventListener("change", show);
  byId("lines").addEventListener("change", () => attempt(matchAgain));
  window.addEventListener("resize", show);
}

function showSettings() {
  byId("size-value").textContent = `${setting("size")} px`;
  byId("count-value").textContent = setting("count");
  byId("ratio-value").textContent = setting("ratio") < 1 ? setting("ratio").toFixed(2) : "off";
}

// In the address: image (one or two), model, provider, threads, size, count, ratio, overlay, selftest (its runs).
async function begin() {
  for (const id of ["provider", "size", "count", "ratio"]) if (query.has(id)) byId(id).value = query.get(id);
  byId("overlay").checked = query.has("overlay");
  listen();
  showSettings();
  show();
  const model = query.get("model");
  if (model) own = { name: model.split("/").pop(), bytes: await (await fetched(model)).arrayBuffer() };
  await start();
  const images = query.getAll("image");
  if (images.length || query.has("selftest")) await takeAddresses(images.length ? images : EXAMPLE);
  if (query.has("selftest")) await report(engine, here(), pairs, images.length === 0, Number(query.get("selftest")) || 10);
}

attempt(begin);
