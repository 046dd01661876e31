// What is drawn on the stage: two pictures side by side with their keypoints, maps and matches.

const GAP = 12;
const STRENGTHS = [[150, 30, 165], [225, 95, 98], [252, 166, 54], [240, 249, 33]];  // weak to strong

function strengthColor(share) {
  const at = share * (STRENGTHS.length - 1), i = Math.min(STRENGTHS.length - 2, Math.floor(at)), part = at - i;
  return `rgb(${STRENGTHS[i].map((value, k) => Math.round(value + part * (STRENGTHS[i + 1][k] - value))).join(" ")})`;
}

// Where the pictures lie on a stage of this size: {x, y, width, height, scale}.
function layout(images, width, height) {
  const half = (width - GAP) / 2;
  return images.map((image, side) => {
    const scale = Math.min(half / image.width, height / image.height);
    const [w, h] = [image.width * scale, image.height * scale];
    const x = side === 0 ? half - w : half + GAP;
    return { x, y: 0, width: w, height: h, scale };
  });
}

// A place of the image, whose pixels have their centres at whole numbers, on the stage.
function onStage(box, point) {
  return [box.x + (point.x + 0.5) * box.scale, box.y + (point.y + 0.5) * box.scale];
}

// The map as a picture: brighter is stronger; blue is what reaches the level where keypoints may be.
function mapPicture(map, level) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [map.width, map.height];
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(map.width, map.height);
  let top = 1;
  for (const value of map.values) if (value > top) top = value;
  for (let i = 0; i < map.values.length; i++) {
    const passes = map.permitted[i] && map.values[i] > 0 && map.values[i] * map.step >= level;
    const share = Math.sqrt(map.values[i] / top);
    pixels.data.set(passes ? [10 + 140 * share, 60 + 160 * share, 255, 200] : [255 * share, 190 * share, 70 * share, 215], 4 * i);
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

function drawSide(context, box, side, overlay) {
  if (side.picture) context.drawImage(side.picture, box.x, box.y, box.width, box.height);
  else {
    context.fillStyle = "#999";
    context.fillRect(box.x, box.y, box.width, box.height);
  }
  if (overlay && side.image.map) {
    side.mapPicture = side.mapPicture || mapPicture(side.image.map, side.settings.level);
    context.drawImage(side.mapPicture, box.x, box.y, box.width, box.height);
  }
  // The strongest last, on top.
  for (let i = side.keypoints.length - 1; i >= 0; i--) {
    drawRing(context, box, side, i, 3.5, strengthColor(1 - i / Math.max(1, side.keypoints.length - 1)));
  }
}

// Rings grow with the keypoints' sizes; the smallest of the image has the same ring whatever its size is.
function drawRing(context, box, side, index, radius, color) {
  const keypoint = side.keypoints[index], sizes = side.image.candidates.sizes;
  const [x, y] = onStage(box, keypoint);
  const wide = keypoint.candidate < 0 ? radius : (radius * sizes[keypoint.candidate]) / side.smallest;
  for (const [style, line] of [["rgb(20 20 20 / 75%)", 3.5], [color, 1.8]]) {
    context.strokeStyle = style;
    context.lineWidth = line;
    context.beginPath();
    context.arc(x, y, wide, 0, 2 * Math.PI);
    context.stroke();
  }
}

function drawLine(context, from, to, color, width) {
  context.strokeStyle = color;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}
