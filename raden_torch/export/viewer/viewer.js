// The page: what is shown, what moves it, what is said of it.
const EYE = [0, 0, 3.4];
const find = (id) => document.getElementById(id);
const canvas = find("picture");
const say = (text) => { find("state").textContent = text; };
const chosen = (name) => document.querySelector(`input[name=${name}]:checked`).value;

const shells = JSON.parse(find("shells").textContent).map((shell) => ({
  ...shell, all: new Table(shell.all), diffuse: new Table(shell.diffuse) }));
find("name").textContent = shells.map((shell) => shell.sample).join(" | ");
find("label").textContent = shells.some((shell) => shell.simulated)
  ? `Simulated: ${shells.filter((shell) => shell.simulated).map((shell) => shell.sample).join(", ")} is computed, not measured.` : "";
find("split").hidden = shells.length < 2;

const state = { turn: [0.3, 0], lamp: [0.45, 0.35], own: null };
let drawing = null, asked = false, pointer = null;

// columns of the rotation about x, then y
function turned([right, up]) {
  const [c, s, d, t] = [Math.cos(right), Math.sin(right), Math.cos(up), Math.sin(up)];
  return [[c, t * s, -d * s], [0, d, t], [s, -t * c, d * c]];
}

const towards = ([right, up]) => [Math.sin(right) * Math.cos(up), Math.sin(up), Math.cos(right) * Math.cos(up)];

// broad light as lamps: a window's panes to one side, or the cloth of a tent all around
const BROAD = {
  window: [...Array(24).keys()].map((i) => [-1.35 + 0.16 * (i % 4), 0.1 + 0.14 * Math.floor(i / 4)]),
  tent: [...Array(32).keys()].map((i) => {
    const height = (i + 0.5) / 32, around = i * 2.399963;
    return [Math.atan2(Math.sqrt(1 - height * height) * Math.cos(around), height),
      Math.asin(Math.sqrt(1 - height * height) * Math.sin(around))];
  }),
};

function lamps() {
  const kind = chosen("light");
  if (kind === "lamp") return [{ direction: towards(state.lamp), irradiance: [Math.PI, Math.PI, Math.PI] }];
  const power = (1.6 * Math.PI) / BROAD[kind].length;
  return BROAD[kind].map((at) => ({
    direction: towards([at[0] + state.lamp[0] - 0.45, at[1] + state.lamp[1] - 0.35]), irradiance: [power, power, power] }));
}

const scene = () => ({
  shape: chosen("shape"), turn: turned(state.turn), eye: EYE, lamps: lamps(), part: Number(chosen("part")),
  exposure: Number(find("exposure").value), split: Number(find("split").value) / 100 });

function draw() {
  asked = false;
  if (!drawing) return;
  const side = Math.max(64, Math.round(canvas.clientWidth * Math.min(devicePixelRatio, 2)));
  const height = Math.max(64, Math.round(canvas.clientHeight * Math.min(devicePixelRatio, 2)));
  if (canvas.width !== side || canvas.height !== height) Object.assign(canvas, { width: side, height });
  drawing.draw(scene());
  describe();
  document.body.dataset.drawn = Number(document.body.dataset.drawn ?? 0) + 1;
}

function redraw() {
  if (!asked) requestAnimationFrame(draw);
  asked = true;
}

const degrees = (x) => `${((x * 180) / Math.PI).toFixed(1)}°`;

// the angles at the pointer, or at the middle, and the slice of the table there
function describe() {
  const [across, down] = pointer ?? [0.5, 0.5];
  const x = Math.floor(across * canvas.width), y = Math.floor(down * canvas.height);
  const now = scene(), normal = drawing.normalAt(x, y, now);
  for (const id of ["incidence", "receiving", "tilt", "value"]) find(id).textContent = "–";
  if (!normal) return slice(null);
  const aspect = canvas.width / canvas.height, wide = aspect < 1 ? HALF_HEIGHT : HALF_HEIGHT * aspect;
  const view = unit([-(2 * across - 1) * wide, (2 * down - 1) * (wide / aspect), 1]);
  const light = unit(now.lamps[0].direction), at = angles(normal, light, view);
  if (dot(normal, light) <= 0) { find("incidence").textContent = "lamp below the horizon"; return slice(null); }
  ["incidence", "receiving", "tilt"].forEach((id, i) => { find(id).textContent = degrees(at[i]); });
  const shell = shells[shells.length > 1 && across > now.split ? 1 : 0];
  find("value").textContent = shell.all.at(...at).map((f) => f.toFixed(3)).join(", ");
  slice(at, shell);
}

function slice(at, shell) {
  const context = find("slice").getContext("2d"), { width, height } = find("slice");
  context.clearRect(0, 0, width, height);
  if (!at) return;
  const picture = context.createImageData(width, height), radians = Math.PI / 180;
  const gain = Math.PI * 2 ** Number(find("exposure").value);
  for (let j = 0; j < height; j++)
    for (let i = 0; i < width; i++) {
      const f = shell.all.at(at[0], (i - 70) * radians, (70 - j) * radians);
      f.forEach((value, c) => {
        const light = Math.min(Math.max(value * gain, 0), 1);
        picture.data[4 * (j * width + i) + c] = 255 * (light > 0.0031308 ? 1.055 * light ** (1 / 2.4) - 0.055 : 12.92 * light);
      });
      picture.data[4 * (j * width + i) + 3] = 255;
    }
  context.putImageData(picture, 0, 0);
  const x = 70.5 + at[1] / radians, y = 70.5 - at[2] / radians;
  for (const [style, wide] of [["#000", 3], ["#fff", 1]]) {
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.beginPath();
    context.arc(x, y, 4, 0, 7);
    context.stroke();
  }
}

function move(lamp, right, up) {
  const what = lamp ? state.lamp : state.turn, most = lamp ? 1.5 : Math.PI / 2;
  what[0] += right;
  what[1] = Math.min(Math.max(what[1] + up, -most), most);
  if (lamp) what[0] = Math.min(Math.max(what[0], -most), most);
  redraw();
}

let held = null;
canvas.addEventListener("pointerdown", (event) => {
  held = [event.clientX, event.clientY];
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  const box = canvas.getBoundingClientRect();
  pointer = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]
    .map((x) => Math.min(Math.max(x, 0), 0.9999));
  if (!held) return redraw();
  const step = 3 / box.width, lamp = chosen("drag") === "lamp" || event.shiftKey;
  move(lamp, (event.clientX - held[0]) * step, (lamp ? -1 : 1) * (event.clientY - held[1]) * step);
  held = [event.clientX, event.clientY];
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { held = null; });

const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
canvas.addEventListener("keydown", (event) => {
  const exposure = find("exposure");
  if (event.key in KEYS) {
    const [right, up] = KEYS[event.key];
    move(event.shiftKey, 0.06 * right, (event.shiftKey ? 0.06 : -0.06) * up);
  } else if ("+-=".includes(event.key)) {
    exposure.value = Number(exposure.value) + (event.key === "-" ? -0.2 : 0.2);
    changed();
  } else return;
  event.preventDefault();
});

function changed() {
  const stops = Number(find("exposure").value);
  find("stops").textContent = `${stops < 0 ? "−" : "+"}${Math.abs(stops).toFixed(1)}`;
  redraw();
}
find("controls").addEventListener("input", changed);
find("controls").addEventListener("submit", (event) => event.preventDefault());
find("split").addEventListener("input", redraw);

async function open(file) {
  try {
    state.own = await readMesh(file);
  } catch (error) {
    return say(error instanceof MeshError ? error.message : `${file.name}: expected a mesh, got a file that cannot be read`);
  }
  drawing.shape("own", state.own);
  find("own").hidden = false;
  document.querySelector("input[name=shape][value=own]").checked = true;
  say(`${file.name}: ${state.own.indices.length / 3} triangles`);
  redraw();
}
find("mesh").addEventListener("change", (event) => event.target.files[0] && open(event.target.files[0]));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  if (event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
});
addEventListener("resize", redraw);

function start() {
  try {
    drawing = new Drawing(canvas, shells, find("functions").textContent);
  } catch (error) {
    drawing = null;
    say(error.message);
    return;
  }
  drawing.shape("sphere", sphere());
  drawing.shape("plate", plate());
  if (state.own) drawing.shape("own", state.own);
  say("");
  draw();
}
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault();
  drawing = null;
  say("The graphics device was lost; the picture comes back when the browser returns it.");
});
canvas.addEventListener("webglcontextrestored", start);
start();
document.body.dataset.ready = "true";
