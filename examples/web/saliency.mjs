// Runs an ELF model with onnxruntime-web (WebAssembly): the same calls work in a browser, where `pixels` come from
// a canvas.
//
//     node saliency.mjs MODEL [PICTURE.ppm [OUTPUT.json]]
//
// Without a picture it takes one that it makes.  OUTPUT.json gets the shapes and all values of every output.
import { readFile, writeFile } from 'node:fs/promises';
import { argv, exit } from 'node:process';
import * as ort from 'onnxruntime-web';

// A binary PPM (P6, 8 bits) as { width, height, rgb }.
function parsePpm(bytes) {
  const head = /^P6(?:\s+|#.*\n)+(\d+)(?:\s+|#.*\n)+(\d+)(?:\s+|#.*\n)+255\s/.exec(bytes.toString('latin1', 0, 1000));
  if (!head) throw new Error('not a binary PPM (P6) of 8 bits');
  const [width, height] = [Number(head[1]), Number(head[2])];
  const rgb = bytes.subarray(head[0].length, head[0].length + 3 * width * height);
  if (rgb.length < 3 * width * height) throw new Error('the picture is cut off');
  return { width, height, rgb };
}

function madePicture(width = 160, height = 120) {
  const rgb = new Uint8Array(3 * width * height);
  for (let y = 0; y < height; y++)
    for (let x = 0; x < width; x++)
      for (let c = 0; c < 3; c++)
        rgb[3 * (y * width + x) + c] = 128 + 60 * Math.sin(x / (5 + c)) * Math.cos(y / (7 - c)) + (x > 80 ? 50 : 0);
  return { width, height, rgb };
}

// What the graph takes: float32 (1, H, W, 3), B G R, 0..255.  A canvas' RGBA needs 4 in place of 3 * i.
function toTensor({ width, height, rgb }) {
  const data = new Float32Array(3 * width * height);
  for (let i = 0; i < data.length; i += 3) {
    data[i] = rgb[i + 2];
    data[i + 1] = rgb[i + 1];
    data[i + 2] = rgb[i];
  }
  return new ort.Tensor('float32', data, [1, height, width, 3]);
}

if (argv.length < 3) {
  console.error('usage: node saliency.mjs MODEL [PICTURE.ppm [OUTPUT.json]]');
  exit(2);
}
ort.env.wasm.numThreads = 1; // in a browser more need cross-origin isolation
const session = await ort.InferenceSession.create(await readFile(argv[2]), { executionProviders: ['wasm'] });
const picture = argv[3] ? parsePpm(await readFile(argv[3])) : madePicture();
const start = performance.now();
const outputs = await session.run({ image: toTensor(picture) });
console.log(`${picture.width}x${picture.height} in ${Math.round(performance.now() - start)} ms`);
for (const [name, tensor] of Object.entries(outputs)) console.log(`${name} (${tensor.dims.join(', ')})`);
const saliency = outputs.saliency.data;
const best = saliency.reduce((at, value, i) => (value > saliency[at] ? i : at), 0);
console.log(`largest saliency ${saliency[best].toPrecision(5)} at x ${best % picture.width}, y ${Math.floor(best / picture.width)}`);
if (argv[4]) {
  const found = Object.entries(outputs).map(([name, t]) => [name, { dims: t.dims, data: Array.from(t.data) }]);
  await writeFile(argv[4], JSON.stringify(Object.fromEntries(found)));
}
