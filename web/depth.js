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

// Size at which a network of `size` sees a whole frame of another aspect, if it may see any size.
export function sizeOfAspect(size, frame) {
  if (sameAspect(size, frame)) return size;
  const narrower = (size[1] * frame[0]) / (size[0] * frame[1]);
  const height = size[0] * (narrower > 1 ? narrower ** 0.25 : Math.sqrt(narrower));
  return [height, (height * frame[1]) / frame[0]].map((side) => Math.max(1, halfEven(side)));
}

function halfEven(value) {
  const below = Math.floor(value);
  const rest = value - below;
  return rest < 0.5 || (rest === 0.5 && below % 2 === 0) ? below : below + 1;
}

// RGBA bytes of `from` -> RGB bytes of `to`, averaged by area if they shrink. The same values as OpenCV's
// INTER_AREA and INTER_LINEAR, so with their precision: float32, and fixed point.
export function resize(pixels, from, to) {
  return (from[0] >= to[0] && from[1] >= to[1] ? resizeArea : resizeLinear)(pixels, from, to);
}

// For each of `to` pixels: the first of `from` pixels that it covers, and their shares.
function areaTaps(from, to) {
  const scale = from / to;
  return Array.from({ length: to }, (_, pixel) => {
    const [start, end] = [pixel * scale, Math.min((pixel + 1) * scale, from)];
    const first = Math.floor(start + 1e-3);
    const shares = [];
    for (let source = first; source < end - 1e-3; source++) {
      shares.push(Math.fround((Math.min(end, source + 1) - Math.max(start, source)) / (end - start)));
    }
    return { first, shares };
  });
}

function resizeArea(pixels, from, to) {
  const [rows, columns] = [0, 1].map((axis) => areaTaps(from[axis], to[axis]));
  const halves = from[0] === 2 * to[0] && from[1] === 2 * to[1];
  const round = halves ? (value) => Math.floor(value + 0.5) : halfEven;
  const result = new Uint8Array(to[0] * to[1] * 3);
  const [line, sum] = [new Float32Array(to[1] * 3), new Float32Array(to[1] * 3)];
  rows.forEach(({ first, shares }, row) => {
    sum.fill(0);
    shares.forEach((share, number) => {
      shrinkLine(pixels, (first + number) * from[1] * 4, columns, line);
      for (let place = 0; place < sum.length; place++) sum[place] += Math.fround(share * line[place]);
    });
    for (let place = 0; place < sum.length; place++) result[row * sum.length + place] = round(sum[place]);
  });
  return result;
}

function shrinkLine(pixels, start, columns, line) {
  let target = 0;
  for (const { first, shares } of columns) {
    let [red, green, blue] = [0, 0, 0];
    let source = start + first * 4;
    for (let number = 0; number < shares.length; number++, source += 4) {
      red = Math.fround(red + Math.fround(shares[number] * pixels[source]));
      green = Math.fround(green + Math.fround(shares[number] * pixels[source + 1]));
      blue = Math.fround(blue + Math.fround(shares[number] * pixels[source + 2]));
    }
    line[target++] = red;
    line[target++] = green;
    line[target++] = blue;
  }
}

// For each of `to` pixels: its two neighbors among `from` pixels, and their shares in 1/2048.
function linearTaps(from, to) {
  return Array.from({ length: to }, (_, pixel) => {
    const place = ((pixel + 0.5) * from) / to - 0.5;
    const below = Math.floor(place);
    const other = halfEven((place - below) * 2048);
    return { first: Math.max(below, 0), second: Math.min(below + 1, from - 1), one: 2048 - other, other };
  });
}

function resizeLinear(pixels, from, to) {
  const [rows, columns] = [0, 1].map((axis) => linearTaps(from[axis], to[axis]));
  const result = new Uint8Array(to[0] * to[1] * 3);
  let target = 0;
  for (const row of rows) {
    for (const column of columns) {
      for (let channel = 0; channel < 3; channel++) {
        const along = (line) => {
          const start = line * from[1] * 4 + channel;
          const [left, right] = [pixels[start + column.first * 4], pixels[start + column.second * 4]];
          return (left * column.one + right * column.other) >> 4;
        };
        const [upper, lower] = [(row.one * along(row.first)) >> 16, (row.other * along(row.second)) >> 16];
        result[target++] = (upper + lower + 2) >> 2;
      }
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

// What the session takes. `focal` is fx [px of the frame], or null. A network that sees rays is told it in pixels of
// the image, 0 for null, and answers in meters. Other networks answer with depth of the canonical camera.
export function inputs(ort, network, image, frame, box, focal) {
  const given = { image: new ort.Tensor("float32", image, [1, 3, ...network.size]) };
  const seen = ((focal ?? 0) * box.width) / frame.width;
  if (network.sees_rays) given.focal = new ort.Tensor("float32", [seen], [1]);
  return given;
}

// Meters per unit of the network's map, for fx [px of the frame]; null: for the canonical camera.
export function metersPerUnit(network, frame, boxWidth, focal) {
  if (network.canonical_px === null || (network.sees_rays && focal !== null)) return 1;
  return ((focal ?? canonicalFocal(network, frame)) * boxWidth) / (network.canonical_px * frame.width);
}

// fx [px of the frame] of the network's canonical camera, whose pixels are those of its training.
export function canonicalFocal(network, frame) {
  const [, width] = sizeOfAspect(network.trained_size, [frame.height, frame.width * network.stretch]);
  return (network.canonical_px * frame.width) / width;
}
