// The network, in a thread of its own so that the page stays responsive.

import * as ort from "./runtime/ort.wasm.bundle.min.mjs";
import { cutOut, inputs, prepare } from "./depth.js";

const MOST_THREADS = 4;
const threads = self.crossOriginIsolated ? Math.min(MOST_THREADS, navigator.hardwareConcurrency || 1) : 1;
ort.env.wasm.numThreads = threads;

const started = start();
started.then(
  ({ network }) => self.postMessage({ network, threads }),
  (error) => self.postMessage({ error: `the network did not load: ${error.message}` }),
);

async function start() {
  const network = await (await fetch("./network.json")).json();
  const [model, wasm] = await load("./network.onnx", "./runtime/ort-wasm-simd-threaded.wasm");
  ort.env.wasm.wasmBinary = wasm;
  const session = await ort.InferenceSession.create(model, { executionProviders: ["wasm"] });
  return { network, session };
}

// The bytes of files; says how many megabytes have come.
async function load(...names) {
  const answers = await Promise.all(names.map((name) => fetch(name)));
  const failed = answers.find((answer) => !answer.ok);
  if (failed) throw new Error(`${failed.url} gives ${failed.status}`);
  // a compressed file does not say how long it is
  const sizes = answers.map(({ headers }) => (headers.has("Content-Encoding") ? NaN : +headers.get("Content-Length")));
  const whole = sizes.reduce((sum, size) => sum + size, 0);
  let [come, said] = [0, -1];
  const read = async (answer) => {
    const [reader, parts] = [answer.body.getReader(), []];
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
      parts.push(next.value);
      come += next.value.length;
      const megabytes = Math.round(come / 1e6);
      if (megabytes !== said) {
        said = megabytes;
        self.postMessage({ loading: `${megabytes}${whole > 0 ? ` of ${Math.round(whole / 1e6)}` : ""} MB` });
      }
    }
    return new Uint8Array(await new Blob(parts).arrayBuffer());
  };
  return Promise.all(answers.map(read));
}

// In: a frame {data, width, height, focal}, with fx [px] or null. Out: its depth map (see depth.js, `inputs`), the
// network's milliseconds and those with the resize.
self.onmessage = async ({ data: frame }) => {
  try {
    const { network, session } = await started;
    const begin = performance.now();
    const { image, box } = prepare(frame, network);
    const ready = performance.now();
    const { depth } = await session.run(inputs(ort, network, image, frame, box, frame.focal));
    const end = performance.now();
    const map = cutOut(depth.data, box, network.size[1]);
    self.postMessage({ map, inference: end - ready, whole: end - begin });
  } catch (error) {
    self.postMessage({ error: `no depth of this picture: ${error.message}` });
  }
};
