// From a picture to what the network sees, and back to meters: the same steps as eldenet's DepthPredictor.
// Sizes are [height, width] in pixels. No part of this file needs a browser.

const SAME_ASPECT = 0.02; // share by which a resize may stretch one side

function sameAspect(one, other) {
  return Math.abs(Math.log((one[0] * other[1]) / (one[1] * other[0]))) <= SAME_ASPECT;
}

// Box {top, left, height, width} of a frame centered in size, aspect kept.
export function fitInto(size, frame) {
  if (sameAspect(size, frame)) return { top: 0, left: 0, height: size[0], width: size[1] };
  const scale = Math.min(size[0] / frame[0], size[1] / frame[1]);
  const [height, width] = frame.map((side) => Math.max(1, halfEven(side * scale)));
  return { top: Math.floor((size[0] - height) / 2), left: Math.floor((size[1] - width) / 2), height, width };
}

function halfEven(value) {
  const below = Math.floor(value);
  const rest = value - below;
  return rest < 0.5 || (rest === 0.5 && below % 2 === 0) ? below : below + 1;
}

// For each of `to` pixels: the first of `from` pixels that it covers, and their shares (OpenCV's INTER_AREA).
function areaTaps(from, to) {
  const scale = from / to;
  return Array.from({ length: to }, (_, pixel) => {
    const [start, end] = [pixel * scale, Math.min((pixel + 1) * scale, from)];
    const first = Math.floor(start + 1e-9);
    const shares = [];
    for (let source = first; source < end - 1e-3; source++) {
      shares.push((Math.min(end, source + 1) - Math.max(start, source)) / (end - start));
    }
    return { first, shares };
  });
}

// The same for bilinear interpolation with half-pixel centers (INTER_LINEAR).
function linearTaps(from, to) {
  const scale = from / to;
  return Array.from({ length: to }, (_, pixel) => {
    const place = Math.min(Math.max((pixel + 0.5) * scale - 0.5, 0), from - 1);
    const first = Math.floor(place);
    const share = place - first;
    return { first, shares: share > 0 ? [1 - share, share] : [1] };
  });
}

// RGBA bytes of `from` -> RGB values of `to`, whole numbers as OpenCV gives them; averaged by area if it shrinks.
export function resize(pixels, from, to) {
  const shrinks = from[0] >= to[0] && from[1] >= to[1];
  const [rows, columns] = [0, 1].map((axis) => (shrinks ? areaTaps : linearTaps)(from[axis], to[axis]));
  const halves = from[0] === 2 * to[0] && from[1] === 2 * to[1];
  const round = halves ? (value) => Math.floor(value + 0.5) : halfEven;
  const result = new Uint8Array(to[0] * to[1] * 3);
  const line = new Float64Array(from[1] * 3);
  let target = 0;
  for (const { first, shares } of rows) {
    line.fill(0);
    shares.forEach((share, number) => {
      let source = (first + number) * from[1] * 4;
      for (let place = 0; place < line.length; place += 3, source += 4) {
        line[place] += share * pixels[source];
        line[place + 1] += share * pixels[source + 1];
        line[place + 2] += share * pixels[source + 2];
      }
    });
    for (const column of columns) {
      let [red, green, blue] = [0, 0, 0];
      let place = column.first * 3;
      for (const share of column.shares) {
        red += share * line[place];
        green += share * line[place + 1];
        blue += share * line[place + 2];
        place += 3;
      }
      result[target++] = round(red);
      result[target++] = round(green);
      result[target++] = round(blue);
    }
  }
  return result;
}

// A frame {data: RGBA bytes, width, height} -> {image: (3, H, W) in [0, 1], box: where it lies in that image}.
export function prepare(frame, network) {
  const [height, width] = network.size;
  const box = fitInto(network.size, [frame.height, frame.width * network.stretch]);
  const small = resize(frame.data, [frame.height, frame.width], [box.height, box.width]);
  const plane = height * width;
  const image = new Float32Array(3 * plane);
  for (let channel = 0; channel < 3; channel++) {
    image.fill(network.border[channel] / 255, channel * plane, (channel + 1) * plane);
    for (let row = 0; row < box.height; row++) {
      const target = channel * plane + (row + box.top) * width + box.left;
      const source = row * box.width * 3 + channel;
      for (let column = 0; column < box.width; column++) {
        image[target + column] = small[source + column * 3] / 255;
      }
    }
  }
  return { image, box };
}

// The part of the network's map (H, W) that lies in the box, as {values, height, width}.
export function cutOut(map, box, width) {
  const values = new Float32Array(box.height * box.width);
  for (let row = 0; row < box.height; row++) {
    const start = (row + box.top) * width + box.left;
    values.set(map.subarray(start, start + box.width), row * box.width);
  }
  return { values, height: box.height, width: box.width };
}

// Value of a map at a pixel (x, y) of a frame of `size`: bilinear, as if the map were enlarged to that frame.
export function valueAt(map, size, x, y) {
  const column = Math.min(Math.max(((x + 0.5) * map.width) / size[1] - 0.5, 0), map.width - 1);
  const row = Math.min(Math.max(((y + 0.5) * map.height) / size[0] - 0.5, 0), map.height - 1);
  const [left, top] = [Math.floor(column), Math.floor(row)];
  const right = Math.min(left + 1, map.width - 1);
  const bottom = Math.min(top + 1, map.height - 1);
  const along = (line) => {
    const [one, other] = [map.values[line * map.width + left], map.values[line * map.width + right]];
    return one + (other - one) * (column - left);
  };
  const upper = along(top);
  return upper + (along(bottom) - upper) * (row - top);
}

// fx [px of the frame] that the network assumes if none is given; null if it knows no focal lengths.
export function canonicalFocal(network, frameWidth, boxWidth) {
  return network.canonical_px === null ? null : (network.canonical_px * frameWidth) / boxWidth;
}
