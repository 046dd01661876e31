"use strict";
// Keypoints of a stored map: threshold and non-maximum suppression as elf_runtime.detection has them.

function bytesOf(text) {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}

async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The arrays of an image's data: candidates, and the map if there is one.
async function unpacked(data) {
  const floats = (text) => new Float32Array(bytesOf(text).buffer);
  const { count, dim, places, scores, sizes, descriptors } = data.candidates;
  const image = {
    name: data.name, note: data.note, height: data.size[0], width: data.size[1], map: null,
    candidates: {
      count, dim, places: floats(places), scores: floats(scores), sizes: floats(sizes),
      descriptors: bytesOf(descriptors),
    },
  };
  if (data.map) {
    const bits = await inflated(data.map.permitted);
    const [height, width] = data.map.size;
    const permitted = new Uint8Array(height * width);
    for (let i = 0; i < permitted.length; i++) permitted[i] = (bits[i >> 3] >> (7 - (i & 7))) & 1;
    const values = new Uint16Array((await inflated(data.map.scores)).buffer);
    image.map = { ...data.map, height, width, values, permitted };
    image.byPixel = candidatesByPixel(image);
  }
  return image;
}

// The settings that an image was detected with.
function ownSettings(image) {
  if (image.map) return { level: image.map.level, count: image.map.count, radius: image.map.radius };
  return { level: 0, count: image.candidates.count, radius: null };
}

// The keypoints: {x, y, score, candidate, pixel}, the strongest first.  x and y are in pixels of the image; candidate is
// -1 where there is no descriptor.
function keypointsOf(image, settings) {
  if (!image.map) return strongestCandidates(image, settings);
  const { width, step } = image.map;
  return suppressed(image.map, settings).map((pixel) => {
    const x = pixel % width, y = (pixel - x) / width;
    const candidate = candidateAt(image, x, y);
    const place = candidate < 0 ? toSource(image, x, y) : placeOf(image.candidates, candidate);
    return { x: place[0], y: place[1], score: image.map.values[pixel] * step, candidate, pixel };
  });
}

function strongestCandidates(image, settings) {
  const found = [];
  const order = Array.from(image.candidates.scores.keys());
  order.sort((a, b) => image.candidates.scores[b] - image.candidates.scores[a]);
  for (const candidate of order) {
    const score = image.candidates.scores[candidate];
    if (found.length >= settings.count || score < settings.level) break;
    const [x, y] = placeOf(image.candidates, candidate);
    found.push({ x, y, score, candidate, pixel: -1 });
  }
  return found;
}

// The plain loop: pixels that pass by descending score, ties in raster order; each one taken strikes out its window.
// With "maxima" only a pixel that nothing in its window exceeds is taken.
function suppressed(map, settings) {
  const { width, height, values, permitted, step } = map;
  const radius = map.radii[settings.radius];
  const passing = [];
  for (let i = 0; i < values.length; i++) {
    if (permitted[i] && values[i] > 0 && values[i] * step >= settings.level) {
      if (!map.maximaOnly || isMaximum(map, i, radius)) passing.push(i);
    }
  }
  passing.sort((a, b) => values[b] - values[a] || a - b);
  const struck = new Uint8Array(values.length), taken = [];
  for (const pixel of passing) {
    if (taken.length >= settings.count) break;
    if (struck[pixel]) continue;
    taken.push(pixel);
    const x = pixel % width, y = (pixel - x) / width;
    const left = Math.max(0, x - radius), right = Math.min(width, x + radius + 1);
    for (let row = Math.max(0, y - radius); row < Math.min(height, y + radius + 1); row++) {
      struck.fill(1, row * width + left, row * width + right);
    }
  }
  return taken;
}

function isMaximum(map, pixel, radius) {
  const { width, height, values } = map;
  const x = pixel % width, y = (pixel - x) / width, value = values[pixel];
  // Neighbours first: most pixels fail there.
  for (const reach of radius > 1 ? [1, radius] : [radius]) {
    const right = Math.min(width - 1, x + reach), bottom = Math.min(height - 1, y + reach);
    for (let row = Math.max(0, y - reach); row <= bottom; row++) {
      for (let column = Math.max(0, x - reach); column <= right; column++) {
        if (values[row * width + column] > value) return false;
      }
    }
  }
  return true;
}

function placeOf(candidates, index) {
  return [candidates.places[2 * index], candidates.places[2 * index + 1]];
}

function toSource(image, x, y) {
  const { width, height } = image.map;
  return [((x + 0.5) / width) * image.width - 0.5, ((y + 0.5) / height) * image.height - 0.5];
}

function toWorking(image, x, y) {
  const { width, height } = image.map;
  return [((x + 0.5) / image.width) * width - 0.5, ((y + 0.5) / image.height) * height - 0.5];
}

function candidatesByPixel(image) {
  const found = new Map();
  for (let i = image.candidates.count - 1; i >= 0; i--) {
    const [x, y] = toWorking(image, ...placeOf(image.candidates, i)).map(Math.round);
    found.set(y * image.map.width + x, i);
  }
  return found;
}

// The candidate that belongs to a working pixel: its place was refined by half a pixel at most along each axis.
function candidateAt(image, x, y) {
  let best = -1, least = 0.51;
  for (let row = y - 1; row <= y + 1; row++) {
    for (let column = x - 1; column <= x + 1; column++) {
      const index = image.byPixel.get(row * image.map.width + column);
      if (index === undefined) continue;
      const [u, v] = toWorking(image, ...placeOf(image.candidates, index));
      const distance = Math.max(Math.abs(u - x), Math.abs(v - y));
      if (distance < least) [best, least] = [index, distance];
    }
  }
  return best;
}
