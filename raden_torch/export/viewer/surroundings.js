// Light from all around: lat-long maps {width, height, rgb}, linear; lamps and a blurred map of one.
// First row up (+y), middle column along −z, x to the right, as brdf/shading/latlong.py has it.
const LUMINANCE = [0.2126, 0.7152, 0.0722];

function toTexel(column, row, width, height) {
  const polar = ((row + 0.5) / height) * Math.PI, turn = ((column + 0.5) / width - 0.5) * 2 * Math.PI;
  return [Math.sin(polar) * Math.sin(turn), Math.cos(polar), -Math.sin(polar) * Math.cos(turn)];
}

// of one texel of each row, in sr
function solidAngles(width, height) {
  const edge = (row) => Math.cos((row / height) * Math.PI);
  return Array.from({ length: height }, (_, row) => (edge(row) - edge(row + 1)) * ((2 * Math.PI) / width));
}

// a vector turned about +y, counter-clockwise seen from above
function aboutY([x, y, z], radians) {
  const c = Math.cos(radians), s = Math.sin(radians);
  return [c * x + s * z, y, c * z - s * x];
}

function painted(colourTowards, width = 128) {
  const height = width / 2, rgb = new Float32Array(3 * width * height);
  for (let i = 0; i < width * height; i++)
    rgb.set(colourTowards(toTexel(i % width, Math.floor(i / width), width, height)), 3 * i);
  return { width, height, rgb };
}

const step = (low, high, x) => {
  const t = Math.min(Math.max((x - low) / (high - low), 0), 1);
  return t * t * (3 - 2 * t);
};
const mixed = (a, b, share) => a.map((x, i) => x + (b[i] - x) * share);
// 1 within a rectangle of directions about `middle`, of half sizes in tangents; soft at the edge
function panel(d, middle, across, up, soft = 0.06) {
  const side = unit(cross([0, 1, 0], middle)), top = cross(middle, side), ahead = dot(d, middle);
  if (ahead <= 0) return 0;
  const x = Math.abs(dot(d, side) / ahead), y = Math.abs(dot(d, top) / ahead);
  return (1 - step(across - soft, across + soft, x)) * (1 - step(up - soft, up + soft, y));
}

const WINDOW = unit([-1, 0.45, 0.75]), SOFTBOX = unit([-0.75, 0.7, 0.8]), STRIP = unit([1, 0.1, 0.25]);
const BUILT_IN = {
  // cloth lit from above over a light table; the hole of the camera is dark
  tent: () => painted((d) => {
    const cloth = mixed([0.55, 0.55, 0.56], [1.25, 1.24, 1.2], step(-0.5, 0.9, d[1]));
    return mixed(cloth, [0.03, 0.03, 0.03], step(0.975, 0.99, d[2]));
  }),
  // a room with a window of four panes in the sky's colour, a warm floor
  window: () => painted((d) => {
    const room = mixed([0.13, 0.1, 0.075], [0.22, 0.21, 0.2], step(-0.4, 0.4, d[1]));
    const side = unit(cross([0, 1, 0], WINDOW)), ahead = Math.max(dot(d, WINDOW), 1e-6);
    const bar = 1 - step(0.025, 0.05, Math.min(Math.abs(dot(d, side) / ahead), Math.abs(dot(d, cross(WINDOW, side)) / ahead)));
    return mixed(room, mixed([6, 7, 8.6], room, bar), panel(d, WINDOW, 0.5, 0.6));
  }),
  // a softbox, a strip light and a dark room
  studio: () => painted((d) => {
    const room = mixed([0.05, 0.05, 0.05], [0.12, 0.12, 0.13], step(-1, 1, d[1]));
    return mixed(mixed(room, [9, 9, 8.7], panel(d, SOFTBOX, 0.42, 0.42)), [5, 5.2, 5.6], panel(d, STRIP, 0.12, 0.9));
  }),
};

// a coarser map of at most `widest` columns, means over whole blocks by solid angle
function reduced(map, widest) {
  const by = Math.ceil(map.width / widest);
  if (by <= 1) return map;
  const width = Math.ceil(map.width / by), height = Math.ceil(map.height / by);
  const rgb = new Float32Array(3 * width * height), weights = new Float32Array(width * height);
  const solid = solidAngles(map.width, map.height);
  for (let row = 0; row < map.height; row++)
    for (let column = 0; column < map.width; column++) {
      const to = Math.floor(row / by) * width + Math.floor(column / by), from = row * map.width + column;
      weights[to] += solid[row];
      for (let c = 0; c < 3; c++) rgb[3 * to + c] += solid[row] * map.rgb[3 * from + c];
    }
  for (let i = 0; i < rgb.length; i++) rgb[i] /= weights[Math.floor(i / 3)];
  return { width, height, rgb };
}

// distant lamps with the irradiance of the whole map, by median cut (Debevec 2005), as
// brdf/shading/environment.py cuts it: always the part with the most energy times width
function lampsOf({ width, height, rgb }, count) {
  const solid = solidAngles(width, height), energy = new Float64Array(width * height);
  const sums = new Float64Array((width + 1) * (height + 1));
  for (let i = 0; i < energy.length; i++)
    for (let c = 0; c < 3; c++) energy[i] += LUMINANCE[c] * rgb[3 * i + c] * solid[Math.floor(i / width)];
  for (let row = 0; row < height; row++)
    for (let column = 0, line = 0; column < width; column++) {
      line += energy[row * width + column];
      sums[(row + 1) * (width + 1) + column + 1] = sums[row * (width + 1) + column + 1] + line;
    }
  const total = sums[sums.length - 1];
  const inside = ([top, bottom, left, right]) => {
    const at = (row, column) => sums[row * (width + 1) + column];
    return at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left);
  };
  const part = (box) => {
    const [top, bottom, left, right] = box;
    const high = ((bottom - top) * Math.PI) / height;
    const wide = Math.sin((Math.PI * (top + bottom)) / 2 / height) * (right - left) * ((2 * Math.PI) / width);
    const whole = bottom - top < 2 && right - left < 2;
    return { box, high, wide, rank: whole ? -1 : (inside(box) + 1e-12 * total) * Math.max(high, wide) };
  };
  const parts = [part([0, height, 0, width])];
  while (parts.length < count) {
    const most = parts.reduce((best, other, i) => (other.rank > parts[best].rank ? i : best), 0);
    if (parts[most].rank < 0) break;
    parts.push(...halves(parts.splice(most, 1)[0], inside).map(part));
  }
  return parts.map(({ box }) => lampOf(box, { width, height, rgb }, energy, solid, total));
}

// two boxes of nearly equal energy, cut across the longer side
function halves({ box: [top, bottom, left, right], high, wide }, inside) {
  const byRows = bottom - top > 1 && (high >= wide || right - left === 1);
  const first = byRows ? top : left, last = byRows ? bottom : right;
  const one = (cut) => (byRows ? [top, cut, left, right] : [top, bottom, left, cut]);
  const all = inside([top, bottom, left, right]);
  let cut = first + Math.max(1, (last - first) >> 1);
  if (all > 0)
    for (let i = first + 1, least = Infinity; i < last; i++) {
      const off = Math.abs(inside(one(i)) - all / 2);
      if (off < least) [least, cut] = [off, i];
    }
  return [one(cut), byRows ? [cut, bottom, left, right] : [top, bottom, cut, right]];
}

function lampOf([top, bottom, left, right], { width, height, rgb }, energy, solid, total) {
  const direction = [0, 0, 0], irradiance = [0, 0, 0];
  for (let row = top; row < bottom; row++)
    for (let column = left; column < right; column++) {
      const i = row * width + column, at = toTexel(column, row, width, height);
      const mass = energy[i] + (1e-9 * total) / energy.length + 1e-300;
      for (let c = 0; c < 3; c++) {
        direction[c] += mass * at[c];
        irradiance[c] += solid[row] * rgb[3 * i + c];
      }
    }
  return { direction: unit(direction), irradiance };
}

// what a GGX surface of this α mirrors: the map over its lobe about each mirror direction, seen
// from there (N = V = R); 64 x 32
function glossy(map, alpha) {
  const { width, height, rgb } = reduced(map, 64), solid = solidAngles(width, height);
  const towards = new Float32Array(3 * width * height);
  for (let i = 0; i < width * height; i++) towards.set(toTexel(i % width, Math.floor(i / width), width, height), 3 * i);
  return painted((r) => {
    let weights = 0, red = 0, green = 0, blue = 0;
    for (let i = 0; i < towards.length; i += 3) {
      const c = towards[i] * r[0] + towards[i + 1] * r[1] + towards[i + 2] * r[2];
      if (c <= 0) continue;
      const weight = (solid[Math.floor(i / 3 / width)] * c) / (((1 + c) / 2) * (alpha * alpha - 1) + 1) ** 2;
      weights += weight;
      red += weight * rgb[i];
      green += weight * rgb[i + 1];
      blue += weight * rgb[i + 2];
    }
    return [red / weights, green / weights, blue / weights];
  }, 64);
}
