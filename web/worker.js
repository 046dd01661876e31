// Runs beside the page, which never waits for the network or the matching.
import { mutualMatches } from "./matching.js";
import { detect, openModel } from "./session.js";

let model = null;

const tasks = {
  async open({ bytes, provider, threads }) {
    model = await openModel(bytes, provider, threads);
    return { outputs: model.session.outputNames };
  },
  detect: ({ rgba, width, height }) => detect(model, rgba, width, height),
  match: ({ first, second, dim, ratio }) => mutualMatches(first, second, dim, ratio),
};

self.onmessage = async ({ data: { id, task, ...given } }) => {
  try {
    self.postMessage({ id, result: await tasks[task](given) });
  } catch (error) {
    self.postMessage({ id, error: String((error && error.message) || error) });
  }
};
