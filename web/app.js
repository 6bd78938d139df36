// The page: sources of frames, the two pictures, the scale, and the meters under the cursor.

import { canonicalFocal, metersPerUnit, valueAt } from "./depth.js";
import { colorOf, paint, ticks, visibleRange } from "./colors.js";

const MOST_PIXELS = 16e6; // of a photo: phones give up beyond
const SLOWNESS = 0.9; // share of the last range that the colors of a video keep from frame to frame
const element = (id) => document.getElementById(id);
const photo = element("photo").getContext("2d", { willReadFrequently: true });
const picture = element("depth").getContext("2d");
const worker = new Worker("./worker.js", { type: "module" });

// What is shown: the network, the last frame, its map, the cursor in shares of the picture.
export const state = {
  network: null, threads: 1, frame: null, map: null, focal: null, range: null, point: [0.5, 0.5],
  frames: 0, times: [],
};
let source = 0; // number of the source that runs; another one ends its loop
let waiting = null;

worker.onmessage = ({ data }) => (data.loading ? say(`loading the network: ${data.loading}`) : waiting?.(data));
worker.onerror = () => waiting?.({ error: "the network did not load: this browser lacks modules or WebAssembly" });
const answer = () => new Promise((resolve) => (waiting = resolve));

function say(text, wrong = false) {
  element("status").textContent = text;
  element("status").classList.toggle("wrong", wrong);
}

// --- meters ---

// fx of a frame [px], as the slider says; null: the canonical camera's.
const focal = ({ width, height }) => (state.focal === null ? null : state.focal * Math.max(width, height));

// The map times this is meters.
const factor = () => metersPerUnit(state.network, state.frame, state.map.width, focal(state.frame));

// Depth [m] at a pixel of the frame.
export function metersAt(x, y) {
  return valueAt(state.map, [state.frame.height, state.frame.width], x, y) * factor();
}

// --- pictures ---

function show() {
  if (!state.map) return;
  const times = factor();
  const meters = { ...state.map, values: state.map.values.map((value) => value * times) };
  const range = visibleRange(meters.values);
  state.range = state.range ? state.range.map((end, i) => SLOWNESS * end + (1 - SLOWNESS) * range[i]) : range;
  const { width, height } = meters;
  Object.assign(picture.canvas, { width, height });
  picture.putImageData(new ImageData(paint(meters, state.range, state.network.colors), width, height), 0, 0);
  for (const canvas of [photo.canvas, picture.canvas]) {
    canvas.style.aspectRatio = `${state.frame.width} / ${state.frame.height}`;
  }
  showScale();
  showFocal();
  showPoint();
}

function showScale() {
  const [near, far] = state.range;
  const bar = element("bar").getContext("2d");
  const pixels = new ImageData(256, 1);
  for (let place = 0; place < 256; place++) {
    const color = colorOf(near + ((far - near) * place) / 255, state.range, state.network.colors);
    pixels.data.set([...color, 255], 4 * place);
  }
  bar.putImageData(pixels, 0, 0);
  element("ticks").replaceChildren(
    ...ticks(state.range).map(([depth, label]) => {
      const tick = document.createElement("span");
      tick.textContent = label;
      tick.style.left = `${(100 * (depth - near)) / (far - near)}%`;
      return tick;
    }),
  );
}

function showFocal() {
  if (state.network.canonical_px === null) return;
  const { frame } = state;
  const pixels = focal(frame) ?? canonicalFocal(state.network, frame);
  const view = (2 * Math.atan(frame.width / 2 / pixels) * 180) / Math.PI;
  const kind = state.focal === null ? " (the network's own camera)" : "";
  element("focal").value = pixels / Math.max(frame.width, frame.height);
  element("focal-value").textContent = `fx ${pixels.toFixed(0)} px, ${view.toFixed(0)}° wide${kind}`;
}

function showPoint() {
  const [across, down] = state.point;
  const { width, height } = state.frame;
  const x = Math.min(Math.floor(across * width), width - 1);
  const y = Math.min(Math.floor(down * height), height - 1);
  const meters = metersAt(x, y);
  for (const pin of document.querySelectorAll(".pin")) {
    pin.hidden = false;
    pin.style.left = `${100 * across}%`;
    pin.style.top = `${100 * down}%`;
    pin.classList.toggle("left", across > 0.7);
  }
  element("label").textContent = `${meters.toFixed(2)} m`;
  element("readout").textContent = `${meters.toFixed(3)} m at column ${x}, row ${y}`;
  const [near, far] = state.range;
  element("mark").style.left = `${100 * Math.min(Math.max((meters - near) / (far - near), 0), 1)}%`;
}

// --- frames ---

// Depth of what `drawable` shows now; false if another source runs by then.
async function predict(drawable, width, height, mine) {
  const scale = Math.min(1, Math.sqrt(MOST_PIXELS / (width * height)));
  const size = { width: Math.round(width * scale), height: Math.round(height * scale) };
  const next = new OffscreenCanvas(size.width, size.height).getContext("2d", { willReadFrequently: true });
  next.drawImage(drawable, 0, 0, size.width, size.height);
  const frame = next.getImageData(0, 0, size.width, size.height);
  const answered = answer();
  worker.postMessage({ data: frame.data, ...size, focal: focal(size) });
  const { map, inference, whole, error } = await answered;
  if (error) say(error, true);
  if (error || mine !== source) return false;
  Object.assign(photo.canvas, size);
  photo.putImageData(frame, 0, 0);
  Object.assign(state, { frame, map });
  state.frames += 1;
  state.times = [...state.times.slice(-99), { inference, whole }];
  show();
  const times = state.times.map((each) => each.inference).sort((one, other) => one - other);
  const median = times[Math.floor(times.length / 2)];
  say(`${state.network.name}: ${median.toFixed(0)} ms a frame, ${state.threads} thread${state.threads > 1 ? "s" : ""}`);
  return true;
}

let busy = Promise.resolve(); // one source after the other

function begin(run) {
  const mine = ++source;
  busy = busy.then(async () => {
    if (mine !== source) return;
    Object.assign(state, { range: null, times: [], frames: 0 });
    element("stop").hidden = true;
    try {
      await run(mine);
    } catch (error) {
      say(error.message, true);
    }
  });
  return busy;
}

function openPicture(blob, name) {
  return begin(async (mine) => {
    const bitmap = await createImageBitmap(blob).catch(() => {
      throw new Error(`${name} is no picture that this browser reads: give a JPEG, PNG or WebP file`);
    });
    await predict(bitmap, bitmap.width, bitmap.height, mine);
    bitmap.close();
  });
}

async function play(video, mine) {
  element("stop").hidden = false;
  try {
    await video.play();
    while (mine === source) {
      if (!(await predict(video, video.videoWidth, video.videoHeight, mine))) break;
      await new Promise(requestAnimationFrame);
    }
  } finally {
    video.pause();
  }
}

function videoElement() {
  return Object.assign(document.createElement("video"), { muted: true, playsInline: true, loop: true });
}

function openVideo(blob, name) {
  return begin(async (mine) => {
    const video = Object.assign(videoElement(), { src: URL.createObjectURL(blob) });
    try {
      await new Promise((resolve, reject) => {
        video.onloadeddata = resolve;
        video.onerror = () => reject(new Error(`${name} is no video that this browser plays`));
      });
      await play(video, mine);
    } finally {
      URL.revokeObjectURL(video.src);
    }
  });
}

function openWebcam() {
  return begin(async (mine) => {
    if (!navigator.mediaDevices) throw new Error("the webcam needs https or localhost: open the page there");
    const wish = { video: { facingMode: "environment", width: { ideal: 640 }, height: { ideal: 480 } } };
    const stream = await navigator.mediaDevices.getUserMedia(wish).catch((error) => {
      throw new Error(`no webcam: ${error.message}`);
    });
    try {
      const video = Object.assign(videoElement(), { srcObject: stream });
      await new Promise((resolve) => (video.onloadeddata = resolve));
      await play(video, mine);
    } finally {
      stream.getTracks().forEach((track) => track.stop());
    }
  });
}

function openFile(file) {
  if (!file) return;
  (file.type.startsWith("video/") ? openVideo : openPicture)(file, file.name);
}

// --- what the user does ---

function connect() {
  element("file").onchange = ({ target }) => {
    openFile(target.files[0]);
    target.value = ""; // so that the same file can be opened again
  };
  element("webcam").onclick = openWebcam;
  element("stop").onclick = () => {
    source++;
    element("stop").hidden = true;
  };
  element("focal").oninput = ({ target }) => setFocal(Number(target.value));
  element("reset").onclick = () => setFocal(null);
  document.ondragover = (event) => event.preventDefault();
  document.ondrop = (event) => {
    event.preventDefault();
    openFile(event.dataTransfer.files[0]);
  };
  for (const canvas of [photo.canvas, picture.canvas]) {
    canvas.onpointermove = canvas.onpointerdown = (event) => {
      const box = canvas.getBoundingClientRect();
      const inside = (value) => Math.min(Math.max(value, 0), 1);
      state.point = [inside((event.clientX - box.left) / box.width), inside((event.clientY - box.top) / box.height)];
      if (state.map) showPoint();
    };
  }
}

// Focal length in longer sides of the picture; null: the canonical camera's.
export async function setFocal(sides) {
  state.focal = sides;
  state.range = null;
  const { canvas } = photo;
  // a network that sees the lens looks again; in a video at the next frame
  if (state.network.sees_rays && element("stop").hidden) {
    await begin((mine) => predict(canvas, canvas.width, canvas.height, mine));
  } else {
    show();
  }
}

async function start() {
  say("loading the network ...");
  const { network, threads, error } = await answer();
  if (error) return say(error, true);
  Object.assign(state, { network, threads });
  element("camera").hidden = network.canonical_px === null;
  element("about").textContent = `Network ${network.name}: ${network.license || "license not stated"}.`;
  connect();
  for (const button of document.querySelectorAll("button, input")) button.disabled = false;
  await openPicture(await (await fetch("./example.jpg")).blob(), "example.jpg");
}

start();
