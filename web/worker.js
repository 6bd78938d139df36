// The network, in a thread of its own so that the page stays responsive.

import * as ort from "./runtime/ort.wasm.bundle.min.mjs";
import { cutOut, prepare } from "./depth.js";

const MOST_THREADS = 4;
const threads = self.crossOriginIsolated ? Math.min(MOST_THREADS, navigator.hardwareConcurrency || 1) : 1;
ort.env.wasm.wasmPaths = { wasm: new URL("./runtime/ort-wasm-simd-threaded.wasm", import.meta.url).href };
ort.env.wasm.numThreads = threads;

const started = start();
started.then(
  ({ network }) => self.postMessage({ network, threads }),
  (error) => self.postMessage({ error: `the network did not load: ${error.message}` }),
);

async function start() {
  const network = await (await fetch("./network.json")).json();
  const model = await (await fetch("./network.onnx")).arrayBuffer();
  const session = await ort.InferenceSession.create(model, { executionProviders: ["wasm"] });
  return { network, session };
}

// In: a frame {data, width, height}. Out: its depth map of the canonical camera, the network's milliseconds and
// those with the resize.
self.onmessage = async ({ data: frame }) => {
  try {
    const { network, session } = await started;
    const begin = performance.now();
    const { image, box } = prepare(frame, network);
    const ready = performance.now();
    const input = new ort.Tensor("float32", image, [1, 3, ...network.size]);
    const { depth } = await session.run({ [session.inputNames[0]]: input });
    const end = performance.now();
    const map = cutOut(depth.data, box, network.size[1]);
    self.postMessage({ map, inference: end - ready, whole: end - begin });
  } catch (error) {
    self.postMessage({ error: `no depth of this picture: ${error.message}` });
  }
};
