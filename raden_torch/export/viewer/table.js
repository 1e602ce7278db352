// A shell's tables: as textures, and read here for the numbers under the pointer.
function decoded(text) {
  const binary = atob(text), bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return new Uint16Array(bytes.buffer);
}

function fromHalf(h) {
  const sign = h & 0x8000 ? -1 : 1, exponent = (h >> 10) & 31, fraction = h & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

// RGB halves → RGBA halves for a texture, alpha 1
function texels(halves) {
  const rgba = new Uint16Array((halves.length / 3) * 4).fill(0x3c00);
  for (let i = 0, j = 0; i < halves.length; i += 3, j += 4) rgba.set(halves.subarray(i, i + 3), j);
  return rgba;
}

class Table {
  constructor({ sides, warp, rgb }) {
    Object.assign(this, { sides, warp, halves: decoded(rgb) });
    this.values = Float32Array.from(this.halves, fromHalf);
  }

  // f_r in 1/sr at angles in radians: the address of runtime_table.address_of_angles, then trilinear
  at(a, r, t) {
    let half = (a + r) / 2, across = (a - r) / 2;
    if (half < 0) [half, across, t] = [-half, -across, -t];
    const x = Math.cos(t) * Math.cos(across), y = Math.cos(t) * Math.sin(across), z = Math.sin(t);
    const least = Math.max(x * Math.cos(half) - Math.abs(y) * Math.sin(half), 0);
    const v = y / Math.max(Math.abs(y) + this.warp[0] * least, 1e-30);
    const w = z / Math.max(Math.abs(z) + this.warp[1] * Math.max(x, 0), 1e-30);
    return this.read([Math.tan(half / 2), (v + 1) / 2, (w + 1) / 2]);
  }

  read(shares) {
    const low = [], part = [];
    shares.forEach((share, i) => {
      const place = Math.min(Math.max(share, 0), 1) * (this.sides[i] - 1);
      low[i] = Math.min(Math.floor(place), this.sides[i] - 2);
      part[i] = place - low[i];
    });
    const sum = [0, 0, 0];
    for (let corner = 0; corner < 8; corner++) {
      let weight = 1, index = 0;
      for (let i = 0; i < 3; i++) {
        const up = (corner >> i) & 1;
        weight *= up ? part[i] : 1 - part[i];
        index = index * this.sides[i] + low[i] + up;
      }
      for (let c = 0; c < 3; c++) sum[c] += weight * this.values[3 * index + c];
    }
    return sum;
  }
}

// incidence, receiving and tilt in radians of unit vectors, as geometry.raden_angles has them
function angles(n, l, v) {
  const d = minus(v, l), p = cross(l, d), s = length(p), cosine = dot(n, l);
  if (s < 1e-6) {
    const a = Math.atan2(length(cross(n, l)), cosine);
    return [a, -a, 0];
  }
  const sine = dot(n, p) / s, h = Math.hypot(Math.sqrt(Math.max(1 - sine * sine, 0)));
  const e = [dot(n, d) - dot(d, l) * cosine, -(dot(n, d) - dot(d, v) * dot(n, v))];
  const a = 2 * Math.atan2(e[0] / s, h + cosine), r = 2 * Math.atan2(e[1] / s, h + dot(n, v));
  const t = Math.asin(Math.min(Math.max(sine, -1), 1));
  return a < 0 ? [-a, -r, -t] : [a, r, t];
}
