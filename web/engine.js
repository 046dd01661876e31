// The page's side of the worker, and which provider and model it gets.
import { threadsHere } from "./session.js";

// 8 bits are faster in WebAssembly only; WebGPU has no kernels for them.
const MODELS = { wasm: "vendor/elf-fast-int8.onnx", webgpu: "vendor/elf-fast-fp32.onnx" };

// Whether there is a GPU for WebGPU; a software one would be slower than WebAssembly.
export async function hasGpu() {
  const adapter = navigator.gpu ? await navigator.gpu.requestAdapter().catch(() => null) : null;
  return Boolean(adapter) && !(adapter.info && adapter.info.isFallbackAdapter);
}

export async function fetched(url) {
  let answer;
  try {
    answer = await fetch(url);
  } catch (error) {
    throw new Error(`${url} can't be loaded (${error.message})`);
  }
  if (!answer.ok) throw new Error(`${url} can't be loaded (${answer.status}): "make web" puts there what the page needs`);
  return answer;
}

export class Engine {
  constructor(provider, threads, name) {
    Object.assign(this, { provider, threads, name, waiting: new Map(), last: 0 });
    this.worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.worker.onmessage = ({ data: { id, result, error } }) => {
      const [resolve, reject] = this.waiting.get(id);
      this.waiting.delete(id);
      error === undefined ? resolve(result) : reject(new Error(error));
    };
    this.worker.onerror = (event) => this.close(event.message || "the worker can't be started");
  }

  ask(task, given, moved = []) {
    return new Promise((resolve, reject) => {
      this.waiting.set(++this.last, [resolve, reject]);
      this.worker.postMessage({ id: this.last, task, ...given }, moved);
    });
  }

  detect({ data, width, height }) {
    return this.ask("detect", { rgba: data, width, height }, [data.buffer]);
  }

  match(first, second, dim, ratio) {
    return this.ask("match", { first, second, dim, ratio });
  }

  close(why = "stopped") {
    this.worker.terminate();
    for (const [, reject] of this.waiting.values()) reject(new Error(why));
    this.waiting.clear();
  }

  // In words: where it runs.
  get place() {
    if (this.provider === "webgpu") return "WebGPU";
    return `WebAssembly, ${this.threads} ${this.threads === 1 ? "thread" : "threads"}`;
  }
}

// An engine with a model: `wanted` is "auto", "webgpu" or "wasm", `own` a model {name, bytes} in place of the page's.
// With "auto" what WebGPU refuses runs in WebAssembly, and `refused` says why.
export async function startEngine(wanted, own, threads = threadsHere()) {
  // A model of one's own may have 8 bits, or be of an exporter whose files WebGPU computes wrongly.
  const provider = wanted === "auto" ? (!own && (await hasGpu()) ? "webgpu" : "wasm") : wanted;
  const url = MODELS[provider];
  const name = own ? own.name : url.split("/").pop();
  const bytes = own ? own.bytes : await (await fetched(url)).arrayBuffer();
  const engine = new Engine(provider, threads, name);
  try {
    await engine.ask("open", { bytes, provider, threads });
    return engine;
  } catch (error) {
    engine.close();
    if (wanted !== "auto" || provider === "wasm") throw new Error(`${name} can't be run: ${error.message}`);
    return Object.assign(await startEngine("wasm", own, threads), { refused: error.message });
  }
}
