// Vectors, and shapes as {positions, normals, indices}.
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.hypot(...a);
const unit = (a) => a.map((x) => x / (length(a) || 1));

function sphere(rows = 48, columns = 96) {
  const positions = [], indices = [];
  for (let i = 0; i <= rows; i++)
    for (let j = 0; j <= columns; j++) {
      const up = (Math.PI * i) / rows, around = (2 * Math.PI * j) / columns;
      positions.push(Math.sin(up) * Math.sin(around), Math.cos(up), Math.sin(up) * Math.cos(around));
    }
  for (let i = 0; i < rows; i++)
    for (let j = 0; j < columns; j++) {
      const k = i * (columns + 1) + j;
      indices.push(k, k + columns + 1, k + 1, k + 1, k + columns + 1, k + columns + 2);
    }
  return { positions, normals: positions, indices };
}

const plate = () => ({
  positions: [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0],
  normals: [0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1],
  indices: [0, 1, 2, 0, 2, 3],
});

class FileError extends Error {}

async function readMesh(file) {
  const name = file.name.toLowerCase();
  if (file.size > 100e6) throw new FileError(`${file.name}: expected at most 100 MB, got ${(file.size / 1e6).toFixed(0)} MB`);
  let mesh;
  if (name.endsWith(".obj")) mesh = fromObj(await file.text());
  else if (name.endsWith(".glb")) mesh = fromGlb(await file.arrayBuffer());
  else if (name.endsWith(".gltf")) mesh = fromGltf(JSON.parse(await file.text()));
  else throw new FileError(`${file.name}: expected a mesh (.obj, .glb, .gltf) or surroundings (.hdr)`);
  const points = mesh.positions.length / 3;
  if (!mesh.indices.length) throw new FileError(`${file.name}: expected triangles, got none`);
  if (mesh.indices.some((i) => !(i >= 0 && i < points)) || mesh.positions.some((x) => !Number.isFinite(x)))
    throw new FileError(`${file.name}: expected whole triangles of finite points, got a damaged mesh`);
  if (mesh.normals.length !== mesh.positions.length) mesh.normals = smoothNormals(mesh);
  return centred(mesh);
}

function fromObj(text) {
  const v = [], vn = [], positions = [], normals = [], indices = [], seen = new Map();
  for (const line of text.split("\n")) {
    const [kind, ...words] = line.trim().split(/\s+/);
    if (kind === "v") v.push(words.slice(0, 3).map(Number));
    if (kind === "vn") vn.push(words.slice(0, 3).map(Number));
    if (kind !== "f") continue;
    const corners = words.map((word) => {
      if (seen.has(word)) return seen.get(word);
      const [p, , n] = word.split("/").map(Number);
      const point = v[p < 0 ? v.length + p : p - 1], normal = vn[n < 0 ? vn.length + n : n - 1];
      if (!point) throw new FileError(`face ${word}: expected a vertex of the file, got none`);
      seen.set(word, positions.length / 3);
      positions.push(...point);
      if (normal) normals.push(...normal);
      return seen.get(word);
    });
    for (let i = 2; i < corners.length; i++) indices.push(corners[0], corners[i - 1], corners[i]);
  }
  return { positions, normals, indices };
}

function fromGlb(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 20 || view.getUint32(0, true) !== 0x46546c67)
    throw new FileError("expected a binary glTF, got another file");
  const json = view.getUint32(12, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, json)));
  return fromGltf(about, buffer.slice(28 + json));
}

const COMPONENTS = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };

function fromGltf(about, binary) {
  const buffers = (about.buffers ?? []).map(({ uri }) => {
    if (uri === undefined) return binary;
    const data = /^data:[^,]*;base64,(.*)$/s.exec(uri);
    if (!data) throw new FileError(`buffer ${uri}: expected to be inside the file; save it as .glb`);
    return Uint8Array.from(atob(data[1]), (c) => c.charCodeAt(0)).buffer;
  });
  const accessor = (index, size) => {
    const { bufferView, byteOffset = 0, componentType, count } = about.accessors[index];
    const view = about.bufferViews[bufferView], Kind = COMPONENTS[componentType];
    const stride = view.byteStride ?? size * Kind.BYTES_PER_ELEMENT, values = [];
    for (let i = 0; i < count; i++) {
      const start = (view.byteOffset ?? 0) + byteOffset + i * stride;
      values.push(...new Kind(buffers[view.buffer].slice(start, start + size * Kind.BYTES_PER_ELEMENT)));
    }
    return values;
  };
  const mesh = { positions: [], normals: [], indices: [] };
  for (const { primitives } of about.meshes ?? [])
    for (const { attributes, indices, mode = 4 } of primitives) {
      if (mode !== 4) continue;
      const first = mesh.positions.length / 3, points = accessor(attributes.POSITION, 3);
      mesh.positions = mesh.positions.concat(points);
      if (attributes.NORMAL !== undefined) mesh.normals = mesh.normals.concat(accessor(attributes.NORMAL, 3));
      const order = indices === undefined ? [...Array(points.length / 3).keys()] : accessor(indices, 1);
      mesh.indices = mesh.indices.concat(order.map((i) => i + first));
    }
  return mesh;
}

function smoothNormals({ positions, indices }) {
  const normals = new Float64Array(positions.length);
  const point = (i) => positions.slice(3 * i, 3 * i + 3);
  for (let k = 0; k < indices.length; k += 3) {
    const corners = [indices[k], indices[k + 1], indices[k + 2]], [a, b, c] = corners.map(point);
    const n = cross(minus(b, a), minus(c, a));
    for (const i of corners) for (let x = 0; x < 3; x++) normals[3 * i + x] += n[x];
  }
  return normals;
}

function centred(mesh) {
  const low = [Infinity, Infinity, Infinity], high = low.map((x) => -x);
  mesh.positions.forEach((x, i) => {
    low[i % 3] = Math.min(low[i % 3], x);
    high[i % 3] = Math.max(high[i % 3], x);
  });
  const middle = low.map((x, i) => (x + high[i]) / 2), reach = length(minus(high, low)) / 2 || 1;
  return { ...mesh, positions: mesh.positions.map((x, i) => (x - middle[i % 3]) / reach) };
}
