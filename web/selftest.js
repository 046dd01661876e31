// What the page found, as JSON in the document, and, of the example, how much of it is Python's.
import { fetched } from "./engine.js";
import { pixelsOf } from "./pictures.js";

const NEAR = 0.01;  // pixels

// The share of wanted keypoints with one of the found within NEAR.
function agreement(wanted, found) {
  const near = wanted.filter(([x, y]) => found.some(([u, v]) => Math.max(Math.abs(x - u), Math.abs(y - v)) <= NEAR));
  return wanted.length ? near.length / wanted.length : Number(found.length === 0);
}

function rows({ places, count }) {
  return Array.from({ length: count }, (_, i) => [places[2 * i], places[2 * i + 1]]);
}

// Median milliseconds of the model alone on a picture.
async function time(engine, bitmap, runs) {
  const times = [], longest = Number(document.getElementById("size").value);
  for (let i = 0; i < runs; i++) times.push((await engine.detect(pixelsOf(bitmap, longest))).ms);
  return times.sort((a, b) => a - b)[runs >> 1];
}

export async function report(engine, sides, pairs, known, runs) {
  const found = {
    model: engine.name, place: engine.place, isolated: crossOriginIsolated, matches: pairs || [],
    keypoints: sides.map((side) => rows({ places: side.found.places, count: side.count })),
    ms: await time(engine, sides[0].bitmap, runs),
  };
  const of = known && (await (await fetched("vendor/expected.json")).json())[engine.name];
  if (of) {
    found.equal = of.keypoints.map((wanted, i) => agreement(wanted, found.keypoints[i]));
    found.equalMatches = agreement(of.matches, found.matches);
  }
  const place = document.createElement("pre");
  [place.id, place.hidden] = ["selftest", true];
  place.textContent = JSON.stringify(found);
  document.body.append(place);
  const share = (value) => `${(100 * value).toFixed(1)} %`;
  if (of) {
    document.getElementById("status").textContent =
      `Self test: ${share(Math.min(...found.equal))} of Python's keypoints within ${NEAR} px, ` +
      `${share(found.equalMatches)} of its matches; ${found.ms.toFixed(0)} ms a picture, median of ${runs}.`;
  }
}
