// Depth as colors with a scale in meters: near is warm, far is cool. The colors come with the network.

// 2nd and 98th percentile of the depth [m], at least 5 cm apart.
export function visibleRange(values) {
  const sorted = values.filter((value) => Number.isFinite(value) && value > 0).sort();
  if (!sorted.length) return [0, 1];
  const percentile = (share) => {
    const place = share * (sorted.length - 1);
    const below = Math.floor(place);
    const above = Math.min(below + 1, sorted.length - 1);
    return sorted[below] + (sorted[above] - sorted[below]) * (place - below);
  };
  const near = percentile(0.02);
  return [near, Math.max(percentile(0.98), near + 0.05)];
}

// Color [red, green, blue] of a depth [m].
export function colorOf(depth, [near, far], colors) {
  const share = 1 - (depth - near) / (far - near);
  return colors[Math.floor(255 * Math.min(Math.max(share, 0), 1))];
}

// RGBA bytes of a map {values, height, width} [m].
export function paint(map, range, colors) {
  const pixels = new Uint8ClampedArray(map.values.length * 4);
  map.values.forEach((depth, place) => {
    const [red, green, blue] = colorOf(depth, range, colors);
    pixels[4 * place] = red;
    pixels[4 * place + 1] = green;
    pixels[4 * place + 2] = blue;
    pixels[4 * place + 3] = 255;
  });
  return pixels;
}

// Three to eight round numbers within the range, as [[number, label], ...].
export function ticks([near, far]) {
  const power = 10 ** Math.floor(Math.log10((far - near) / 3));
  const step = [5, 2, 1].map((times) => times * power).find((each) => (far - near) / each >= 3) ?? power;
  const digits = Math.max(0, Math.min(2, -Math.floor(Math.log10(step) + 1e-9)));
  const found = [];
  for (let number = Math.ceil(near / step - 1e-9); number * step <= far + step * 1e-9; number++) {
    found.push([number * step, `${(number * step).toFixed(digits)} m`]);
  }
  return found;
}
