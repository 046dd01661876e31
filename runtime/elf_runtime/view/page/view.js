// The page: which images are chosen, the settings, and what the pointer is on.

const elements = Array.from(document.querySelectorAll("script.image"));
const byId = (id) => document.getElementById(id);
const sliders = ["level", "count", "radius"];
const changed = { level: null, count: null, radius: null };  // null: each image's own
const chosen = [0, Math.min(1, elements.length - 1)];
let sides = [], boxes = [], pairs = null, hover = null, turn = 0;

function pictureOf(source) {
  if (!source) return Promise.resolve(null);
  const picture = new Image();
  picture.src = source;
  return picture.decode().then(() => picture);
}

async function loaded(number) {
  const data = JSON.parse(elements[number].textContent);
  const [image, picture] = await Promise.all([unpacked(data), pictureOf(data.picture)]);
  return { number, image, picture, smallest: image.candidates.sizes.reduce((a, b) => Math.min(a, b), Infinity) };
}

// Load what is chosen and not there; only the two chosen images are kept.
async function choose(side, number) {
  chosen[side] = (number + elements.length) % elements.length;
  const mine = ++turn;
  const next = [];
  for (const wanted of chosen) {
    const there = [...sides, ...next].find((one) => one.number === wanted);
    next.push(there ? { ...there } : await loaded(wanted));
  }
  if (mine !== turn) return;
  sides = next;
  markGallery();
  recompute();
}

function recompute() {
  for (const side of sides) {
    side.settings = ownSettings(side.image);
    for (const name of sliders) if (changed[name] !== null) side.settings[name] = changed[name];
    side.keypoints = keypointsOf(side.image, side.settings);
    side.mapPicture = null;
  }
  pairs = hover = null;
  showSettings();
  draw();
}

function showSettings() {
  for (const name of sliders) {
    const values = sides.map((side) => side.settings[name]).filter((value) => value !== null);
    const shown = [...new Set(values.map((value) => String(Math.round(100 * value) / 100)))];
    byId(name).disabled = values.length === 0;
    byId(`${name}-value`).textContent = shown.join(" / ") + (name === "radius" && shown.length ? " px" : "");
    if (changed[name] === null && values.length) byId(name).value = values[0];
  }
}

function draw() {
  const stage = byId("stage"), ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = stage;
  [stage.width, stage.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const context = stage.getContext("2d");
  context.scale(ratio, ratio);
  boxes = layout(sides.map((side) => side.image), width, height);
  sides.forEach((side, i) => drawSide(context, boxes[i], side, byId("overlay").checked));
  const at = (side, index) => onStage(boxes[side], sides[side].keypoints[index]);
  if (byId("lines").checked) {
    pairs = pairs || mutualMatches(sides[0].image, sides[0].keypoints, sides[1].image, sides[1].keypoints);
    const color = `rgb(60 170 90 / ${hover ? 12 : 45}%)`;  // the line of what is pointed at stands out
    for (const [i, j] of pairs) drawLine(context, at(0, i), at(1, j), color, 1);
  }
  if (hover) {
    const other = 1 - hover.side;
    if (hover.match >= 0) {
      drawLine(context, at(hover.side, hover.index), at(other, hover.match), "#fff", 4.5);
      drawLine(context, at(hover.side, hover.index), at(other, hover.match), "#d0245c", 2.5);
      drawRing(context, boxes[other], sides[other], hover.match, 7, "#fff");
    }
    drawRing(context, boxes[hover.side], sides[hover.side], hover.index, 7, "#fff");
  }
  byId("status").textContent = hover ? told(hover) : summary();
}

function summary() {
  const texts = sides.map(({ image, keypoints }) => {
    const size = `${image.name}: ${keypoints.length} keypoints, ${image.width}x${image.height}`;
    return image.note ? `${size} (${image.note})` : size;
  });
  if (byId("lines").checked && pairs) texts.push(`${pairs.length} mutual matches`);
  return texts.join("   \u00b7   ");
}

function told({ side, index, match, mutual }) {
  const { image, keypoints } = sides[side], other = sides[1 - side], keypoint = keypoints[index];
  const where = `${image.name}: x ${keypoint.x.toFixed(1)}, y ${keypoint.y.toFixed(1)}, score ${keypoint.score.toFixed(1)}`;
  if (match < 0) return `${where}; ${keypoint.candidate < 0 ? "no descriptor stored" : "no match"}`;
  const found = other.keypoints[match];
  const alike = similarity(image.candidates, keypoint.candidate, other.image.candidates, found.candidate).toFixed(3);
  const what = mutual ? "each other's nearest" : "nearest, not mutual";
  return `${where}; ${what} in ${other.image.name}: x ${found.x.toFixed(1)}, y ${found.y.toFixed(1)}, similarity ${alike}`;
}

// The keypoint under the pointer, within 10 pixels of the screen, with its best match in the other image.
function pointed(x, y) {
  let best = null, least = 10;
  sides.forEach((side, number) => side.keypoints.forEach((keypoint, index) => {
    const [u, v] = onStage(boxes[number], keypoint), distance = Math.hypot(u - x, v - y);
    if (distance < least) [best, least] = [{ side: number, index }, distance];
  }));
  if (!best) return null;
  const mine = sides[best.side], other = sides[1 - best.side];
  const match = nearest(mine.image, mine.keypoints[best.index], other.image, other.keypoints);
  const back = match < 0 ? -1 : nearest(other.image, other.keypoints[match], mine.image, mine.keypoints);
  return { ...best, match, mutual: back === best.index };
}

function markGallery() {
  Array.from(byId("gallery").children).forEach((button, number) => {
    button.classList.toggle("left", number === chosen[0]);
    button.classList.toggle("right", number === chosen[1]);
  });
}

function fillGallery() {
  elements.forEach((element, number) => {
    const data = JSON.parse(element.textContent), button = document.createElement("button");
    const name = document.createElement("span");
    name.textContent = button.title = data.name;
    if (data.thumbnail) {
      const picture = document.createElement("img");
      [picture.src, picture.alt] = [data.thumbnail, ""];
      button.append(picture);
    }
    button.append(name);
    button.addEventListener("click", (event) => choose(event.shiftKey ? 1 : 0, number));
    byId("gallery").append(button);
  });
}

function listen() {
  for (const name of sliders) {
    byId(name).addEventListener("input", () => {
      changed[name] = Number(byId(name).value);
      recompute();
    });
  }
  byId("reset").addEventListener("click", () => {
    for (const name of sliders) changed[name] = null;
    recompute();
  });
  for (const name of ["overlay", "lines"]) byId(name).addEventListener("change", draw);
  byId("stage").addEventListener("mousemove", (event) => {
    const before = JSON.stringify(hover);
    hover = pointed(event.offsetX, event.offsetY);
    if (JSON.stringify(hover) !== before) draw();
  });
  byId("stage").addEventListener("mouseleave", () => {
    hover = null;
    draw();
  });
  document.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, -1], ArrowDown: [1, 1] }[event.key];
    if (!step || (event.target.type === "range")) return;
    event.preventDefault();
    choose(step[0], chosen[step[0]] + step[1]);
  });
  window.addEventListener("resize", draw);
}

fillGallery();
listen();
choose(0, 0);
