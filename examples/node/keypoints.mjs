// Keypoints of a picture, or matches of two, in Node: an end-to-end ELF model (elf-export --end-to-end) run by
// onnxruntime-node, with sharp for the files.
//
//     node keypoints.mjs MODEL.onnx PICTURE                        prints x, y and score, the strongest first
//     node keypoints.mjs MODEL.onnx FIRST SECOND ELF-MATCH.onnx    prints x, y, x, y of the matches
//
// ELF-MATCH.onnx is what elf-export --match writes.  Places are in pixels, (0, 0) being the centre of the first one.
import { argv, env, exit } from 'node:process';
import sharp from 'sharp';

env.ORT_DISABLE_TELEMETRY ??= '1'; // ONNX Runtime reads it when it is loaded
const ort = await import('onnxruntime-node');

function open(path) {
  return ort.InferenceSession.create(path, { logSeverityLevel: 3 });
}

// A picture as (1, H, W, 3) in the order B G R, of the model's type of pixels, 0 to 255.
async function readImage(path, type) {
  const { data, info } = await sharp(path).autoOrient().flatten().toColourspace('srgb').raw().toBuffer({ resolveWithObject: true });
  const count = info.width * info.height;
  const pixels = type === 'float32' ? new Float32Array(3 * count) : new Uint8Array(3 * count);
  for (let i = 0; i < count; i++)
    for (let c = 0; c < 3; c++) pixels[3 * i + c] = data[info.channels * i + (info.channels < 3 ? 0 : 2 - c)];
  return new ort.Tensor(type, pixels, [1, info.height, info.width, 3]);
}

// { keypoints (K, 2), scores (K), descriptors (K, D) } as tensors.
async function detect(session, path) {
  return session.run({ image: await readImage(path, session.inputMetadata[0].type) });
}

async function main(model, first, second, matcher) {
  const session = await open(model);
  if (!session.outputNames.includes('keypoints') || session.outputNames.includes('counts'))
    throw new Error(`${model}: not an end-to-end model for one image (elf-export --end-to-end makes them)`);
  const a = await detect(session, first);
  const at = ({ keypoints: { data } }, i) => `${data[2 * i]} ${data[2 * i + 1]}`;
  if (!second) {
    a.scores.data.forEach((score, i) => console.log(`${at(a, i)} ${score}`));
    return;
  }
  const b = await detect(session, second);
  const found = await (await open(matcher)).run({ descriptors_a: a.descriptors, descriptors_b: b.descriptors });
  const rows = Array.from(found.matches.data, Number); // int64: pairs of a row of a and one of b
  for (let i = 0; i < rows.length; i += 2) console.log(`${at(a, rows[i])} ${at(b, rows[i + 1])}`);
}

const files = argv.slice(2);
if (files.length !== 2 && files.length !== 4) {
  console.error('usage: node keypoints.mjs MODEL.onnx PICTURE\n       node keypoints.mjs MODEL.onnx FIRST SECOND ELF-MATCH.onnx');
  exit(2);
}
main(...files).catch((error) => {
  console.error(`keypoints: ${error.message}`);
  exit(1);
});
