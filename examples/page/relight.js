// A photograph, its normal map and an exported shader: the pointer moves the lamp.
// The normal map: red right, green up, blue towards the viewer; its alpha says where the material is.
import { openShader, PersonError } from "./shader.js";

const MOST_PIXELS = 40e6; // 40 bytes each are kept
const element = (id) => document.getElementById(id);
const state = { shader: null, photo: null, normals: null, lamp: [0.41, 0.41, 0.82], busy: false };

const toLinear = Float32Array.from({ length: 256 }, (_, i) => {
  const s = i / 255;
  return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
});
const toDisplay = (x) =>
  255 * (x <= 0.0031308 ? 12.92 * Math.max(x, 0) : 1.055 * Math.min(x, 1) ** (1 / 2.4) - 0.055);

async function readPixels(blob, what) {
  const image = await createImageBitmap(blob, { premultiplyAlpha: "none" }).catch(() => {
    throw new PersonError(`The ${what} is not a picture that this browser can read.`);
  });
  const { width, height } = image;
  if (width * height > MOST_PIXELS)
    throw new PersonError(
      `The ${what} has ${Math.round((width * height) / 1e6)} megapixels; this page holds at most ` +
        `${MOST_PIXELS / 1e6}. Make it smaller and load it again.`);
  try {
    const context = new OffscreenCanvas(width, height).getContext("2d");
    context.drawImage(image, 0, 0);
    return context.getImageData(0, 0, width, height);
  } catch {
    throw new PersonError(`There is not enough memory for the ${what}. Make it smaller.`);
  }
}

// The pixels of the material: where they are, how much of each it covers, and their normals.
function materialOf({ data, width, height }) {
  const where = [];
  for (let i = 0; i < width * height; i++) if (data[4 * i + 3] > 0) where.push(i);
  const normal = new Float32Array(3 * where.length);
  const cover = new Float32Array(where.length);
  where.forEach((pixel, k) => {
    for (let c = 0; c < 3; c++)
      normal[c * where.length + k] = (data[4 * pixel + c] * 2) / 255 - 1;
    cover[k] = data[4 * pixel + 3] / 255;
  });
  return { where: Uint32Array.from(where), cover, normal, width, height };
}

async function draw() {
  const { shader, photo, normals, lamp } = state;
  if (!(shader && photo && normals)) return;
  if (photo.width !== normals.width || photo.height !== normals.height)
    throw new PersonError(
      `The photograph has ${photo.width} × ${photo.height} pixels, the normal map ` +
        `${normals.width} × ${normals.height}; they must be of one size.`);
  const start = performance.now();
  const radiance = await shader.run(normals.normal, lamp, [0, 0, 1]);
  const milliseconds = performance.now() - start;
  const gain = 2 ** Number(element("exposure").value);
  const { where, cover } = normals;
  const shown = new ImageData(new Uint8ClampedArray(photo.data), photo.width, photo.height);
  for (let k = 0; k < where.length; k++)
    for (let c = 0; c < 3; c++) {
      const before = toLinear[photo.data[4 * where[k] + c]];
      const lit = gain * radiance[c * where.length + k];
      shown.data[4 * where[k] + c] = toDisplay(before + cover[k] * (lit - before));
    }
  const canvas = element("picture");
  [canvas.width, canvas.height] = [photo.width, photo.height];
  canvas.getContext("2d").putImageData(shown, 0, 0);
  element("state").textContent =
    `${where.length} pixels in ${milliseconds.toFixed(0)} ms, ${shader.by}`;
}

// One picture at a time; what changed meanwhile is drawn next.
async function redraw() {
  document.body.dataset.drawn = "false";
  if (state.busy) return void (state.again = true);
  state.busy = true;
  do {
    state.again = false;
    await attempt(draw);
  } while (state.again);
  state.busy = false;
  document.body.dataset.drawn = "true";
}

async function attempt(job) {
  try {
    await job();
    return true;
  } catch (error) {
    element("message").textContent =
      error instanceof PersonError ? error.message : `Something went wrong: ${error.message}`;
    return false;
  }
}

const LOADERS = {
  model: async (blob) => (state.shader = await openShader(await blob.arrayBuffer())),
  photo: async (blob) => (state.photo = await readPixels(blob, "photograph")),
  normals: async (blob) => (state.normals = materialOf(await readPixels(blob, "normal map"))),
};

async function load(what, blob) {
  element("message").textContent = "";
  if (await attempt(() => LOADERS[what](blob))) {
    if (state.shader?.note) element("message").textContent = state.shader.note;
    await redraw();
  }
}

async function busyWith(job) {
  document.body.dataset.ready = "false";
  await job();
  document.body.dataset.ready = "true";
}

for (const what of Object.keys(LOADERS))
  element(what).addEventListener("change", ({ target }) =>
    busyWith(() => load(what, target.files[0])));
element("exposure").addEventListener("input", redraw);
element("picture").addEventListener("pointermove", ({ currentTarget, clientX, clientY }) => {
  const box = currentTarget.getBoundingClientRect();
  const x = (2 * (clientX - box.left)) / box.width - 1;
  const y = 1 - (2 * (clientY - box.top)) / box.height;
  state.lamp = [x, y, Math.sqrt(Math.max(1 - x * x - y * y, 0.01))];
  redraw();
});
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file) busyWith(() => load("model", file));
});

// ?data=folder/ loads shell.onnx, photo.png and normals.png from there
const folder = new URLSearchParams(location.search).get("data");
const files = [["photo", "photo.png"], ["normals", "normals.png"], ["model", "shell.onnx"]];
await busyWith(async () => {
  for (const [what, name] of folder ? files : []) {
    const response = await fetch(folder + name);
    if (response.ok) await load(what, await response.blob());
    else element("message").textContent = `${folder}${name} is not there (${response.status}).`;
  }
});
