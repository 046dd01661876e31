// A model in ONNX Runtime: pixels in, keypoints out.

const FOLDER = new URL("./vendor/", import.meta.url);
// The build with WebGPU is the larger one; the newer one, ort.webgpu, lacks Cast and so can't run the model.
const BUILDS = { wasm: "ort.wasm.min.mjs", webgpu: "ort.min.mjs" };
const WANTED = ["keypoints", "scores"];
const TRIAL = 96;  // pixels of the first image: some kernels refuse a model only when they run

// How many threads WebAssembly may have here: one, where the page is not isolated from other origins (see serve.py), else
// half of the processor's, whose other half waits for the same units and draws the page.
export function threadsHere() {
  return self.crossOriginIsolated ? Math.min(8, Math.ceil((navigator.hardwareConcurrency || 1) / 2)) : 1;
}

export async function openModel(bytes, provider, threads) {
  const ort = await import(new URL(BUILDS[provider], FOLDER));
  ort.env.wasm.wasmPaths = FOLDER.href;
  ort.env.wasm.numThreads = threads;
  ort.env.logLevel = "error";
  const options = { executionProviders: [provider], logSeverityLevel: 3 };
  const session = await ort.InferenceSession.create(bytes, options);
  const lacks = WANTED.filter((name) => !session.outputNames.includes(name));
  if (lacks.length || session.outputNames.includes("counts") || session.inputNames.join() !== "image") {
    throw new Error(
      `its inputs are ${session.inputNames.join(", ")}, its outputs ${session.outputNames.join(", ")}; this page ` +
      "takes models of elf-export --end-to-end, without batch",
    );
  }
  const model = { ort, session, type: session.inputMetadata[0].type };
  await detect(model, new Uint8ClampedArray(4 * TRIAL * TRIAL).fill(128), TRIAL, TRIAL);
  return model;
}

// An image of a canvas, RGBA, as the model takes it: blue, green, red.
function imageTensor(model, rgba, width, height) {
  const pixels = new (model.type === "uint8" ? Uint8Array : Float32Array)(3 * width * height);
  for (let i = 0, p = 0; i < pixels.length; i += 3, p += 4) {
    pixels[i] = rgba[p + 2];
    pixels[i + 1] = rgba[p + 1];
    pixels[i + 2] = rgba[p];
  }
  return new model.ort.Tensor(model.type, pixels, [1, height, width, 3]);
}

// Keypoints (x, y of each, integer = centre of a pixel), scores, the strongest first, descriptors of `dim` values, the
// saliency map, where the model gives it, and the milliseconds that it took.
export async function detect(model, rgba, width, height) {
  const image = imageTensor(model, rgba, width, height);
  const start = performance.now();
  const { keypoints, scores, descriptors, saliency } = await model.session.run({ image });
  return {
    ms: performance.now() - start,
    keypoints: keypoints.data,
    scores: scores.data,
    descriptors: descriptors ? descriptors.data : new Float32Array(0),
    dim: descriptors ? descriptors.dims[1] : 0,
    saliency: saliency ? { values: saliency.data, height: saliency.dims[1], width: saliency.dims[2] } : null,
  };
}
