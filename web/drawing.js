// What is drawn on the stage: one picture, or two side by side, with keypoints, saliency and matches.

const GAP = 12;
const STRENGTHS = [[150, 30, 165], [225, 95, 98], [252, 166, 54], [240, 249, 33]];  // weak to strong

function strength(share) {
  const at = share * (STRENGTHS.length - 1), i = Math.min(STRENGTHS.length - 2, Math.floor(at)), part = at - i;
  return STRENGTHS[i].map((value, k) => Math.round(value + part * (STRENGTHS[i + 1][k] - value)));
}

// Where pictures {width, height} lie on a stage of this size: {x, y, width, height, scale}.
export function layout(pictures, width, height) {
  const count = pictures.length, part = (width - GAP * (count - 1)) / count;
  return pictures.map((picture, side) => {
    const scale = Math.min(part / picture.width, height / picture.height);
    const [w, h] = [picture.width * scale, picture.height * scale];
    const x = count === 1 ? (width - w) / 2 : side === 0 ? part - w : part + GAP;
    return { x, y: 0, width: w, height: h, scale };
  });
}

// Keypoint i on the stage; pixels of the picture have their centres at whole numbers.
function onStage(box, { places }, i) {
  return [box.x + (places[2 * i] + 0.5) * box.scale, box.y + (places[2 * i + 1] + 0.5) * box.scale];
}

// The saliency as a picture: opaque and yellow where it is strong, on a darkened ground.
export function saliencyPicture({ values, width, height }) {
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
  const pixels = context.createImageData(width, height);
  let top = 1e-9;
  for (const value of values) if (value > top) top = value;
  for (let i = 0; i < values.length; i++) {
    const share = Math.sqrt(Math.max(0, values[i]) / top);
    pixels.data.set([...strength(share).map((value) => value * Math.min(1, 2 * share)), 110 + 145 * share], 4 * i);
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

function drawSide(context, box, side, count, overlay) {
  context.drawImage(side.bitmap, box.x, box.y, box.width, box.height);
  if (!side.found) return;
  if (overlay && side.found.saliency) {
    side.found.picture = side.found.picture || saliencyPicture(side.found.saliency);
    context.drawImage(side.found.picture, box.x, box.y, box.width, box.height);
  }
  // The strongest last, on top.
  for (let i = count - 1; i >= 0; i--) {
    const [x, y] = onStage(box, side.found, i);
    const color = `rgb(${strength(1 - i / Math.max(1, count - 1)).join(" ")})`;
    for (const [style, line] of [["rgb(20 20 20 / 75%)", 3.5], [color, 1.8]]) {
      Object.assign(context, { strokeStyle: style, lineWidth: line });
      context.beginPath();
      context.arc(x, y, 3.5, 0, 2 * Math.PI);
      context.stroke();
    }
  }
}

// Sides are {bitmap, found, count}; pairs are of indices of their keypoints.
export function drawStage(stage, sides, pairs, overlay) {
  const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = stage;
  [stage.width, stage.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const context = stage.getContext("2d");
  context.scale(ratio, ratio);
  const boxes = layout(sides.map((side) => side.bitmap), width, height);
  sides.forEach((side, i) => drawSide(context, boxes[i], side, side.count, overlay));
  context.strokeStyle = "rgb(60 190 100 / 60%)";
  context.lineWidth = 1.2;
  for (const [i, j] of pairs) {
    context.beginPath();
    context.moveTo(...onStage(boxes[0], sides[0].found, i));
    context.lineTo(...onStage(boxes[1], sides[1].found, j));
    context.stroke();
  }
}
