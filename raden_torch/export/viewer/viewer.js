// The page: what is shown, what moves it, what is said of it.
const EYE = [0, 0, 3.4], COARSE = 32, FINE = 256, REST_MS = 250, LONGEST_MS = 1500, MOVING_MS = 100;
const find = (id) => document.getElementById(id);
const canvas = find("picture");
const say = (text) => { find("state").textContent = text; };
const chosen = (name) => document.querySelector(`input[name=${name}]:checked`).value;
const choose = (name, value) => { document.querySelector(`input[name=${name}][value=${value}]`).checked = true; };

const shells = JSON.parse(find("shells").textContent).map((shell) => ({
  ...shell, all: new Table(shell.all), diffuse: new Table(shell.diffuse) }));
const names = shells.map((shell) => shell.sample).join(" | ");
find("name").textContent = names;
find("label").textContent = shells.some((shell) => shell.simulated)
  ? `Simulated: ${shells.filter((shell) => shell.simulated).map((shell) => shell.sample).join(", ")} is computed, not measured.` : "";
find("split").hidden = shells.length < 2;

// `around` is the surroundings: a map, lamps that stand for it, and what lacquer mirrors of it
const state = { turn: [0.3, 0], lamp: [0.45, 0.35], rotation: 0, zoom: 1, point: [0.5, 0.5], own: null, around: null, file: null };
let drawing = null, asked = false, resting = true, rest = 0, lampMs = 0;

function scene(aspect) {
  const lamp = { direction: towards(state.lamp), irradiance: [Math.PI, Math.PI, Math.PI] };
  const distant = state.around ? distantLamps(state.around) : [];
  return {
    shape: chosen("shape"), turn: turned(state.turn), eye: EYE, rotation: state.rotation,
    camera: product(projection(halfSizes(aspect, state.zoom)), placed(EYE.map((x) => -x))),
    lamps: find("lit").checked ? [lamp] : [],
    distant: distant.map((one) => ({ ...one, direction: aboutY(one.direction, state.rotation) })),
    part: Number(chosen("part")), exposure: Number(find("exposure").value), split: Number(find("split").value) / 100 };
}

// as many as this device draws soon: at rest, and few while something moves
function distantLamps(around) {
  const [soon, fewest, most] = resting ? [LONGEST_MS, COARSE, FINE] : [MOVING_MS, 8, COARSE];
  const count = Math.max(fewest, Math.min(most, Math.floor(soon / lampMs)));
  if (around.lamps?.length !== count) around.lamps = lampsOf(around.map, count);
  return around.lamps;
}

function reflectAround() {
  if (state.around) drawing.mirror(state.around.mirrored ??= glossy(state.around.map, LACQUER_ALPHA));
}

function draw() {
  asked = false;
  if (!drawing || drawing.immersed) return;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) =>
    Math.max(64, Math.round(side * Math.min(devicePixelRatio, 2))));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const now = scene(width / height), began = performance.now();
  if (now.shape === "plate") reflectAround();
  drawing.picture(now);
  describe(now);
  lampMs = (performance.now() - began) / (now.lamps.length + now.distant.length || 1);
  const sides = [degrees(state.lamp[0]), degrees(state.lamp[1])];
  const light = [find("lit").checked && `a lamp ${sides[0]} to the right and ${sides[1]} up`, state.around && `surroundings: ${chosen("around")}`];
  canvas.setAttribute("aria-label", `${chosen("shape")} of ${names}; ${light.filter(Boolean).join("; ") || "no light"}`);
  document.body.dataset.drawn = Number(document.body.dataset.drawn ?? 0) + 1;
  Object.assign(document.body.dataset, { resting, lamps: now.lamps.length + now.distant.length });
}

// few lamps stand for the surroundings while something moves
function redraw() {
  if (!asked) requestAnimationFrame(draw);
  asked = true;
  clearTimeout(rest);
  if (!state.around) return;
  resting = false;
  rest = setTimeout(() => { resting = true; requestAnimationFrame(draw); }, REST_MS);
}

const within = (x, most) => Math.min(Math.max(x, -most), most);
function move(what, right, up) {
  if (what === "shape") state.turn = [state.turn[0] + right, within(state.turn[1] - up, Math.PI / 2)];
  if (what === "lamp") state.lamp = [within(state.lamp[0] + right, 1.5), within(state.lamp[1] + up, 1.5)];
  if (what === "surroundings") {
    state.rotation += right;
    const turns = (state.rotation * 180) / Math.PI;
    find("rotation").value = turns - 360 * Math.round(turns / 360);
    find("turned").textContent = `${Math.round(find("rotation").value)}°`;
  }
  if (what === "point") point([state.point[0] + right / 3, state.point[1] - up / 3]);
  redraw();
}

function point(at) {
  state.point = at.map((x) => Math.min(Math.max(x, 0), 0.9999));
  find("point").style.left = `${100 * state.point[0]}%`;
  find("point").style.top = `${100 * state.point[1]}%`;
}

function zoom(by) {
  state.zoom = Math.min(Math.max(state.zoom * by, 0.5), 8);
  redraw();
}

// fingers and mouse: one drags, two pinch
const held = new Map();
const apart = () => { const [a, b] = [...held.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
canvas.addEventListener("pointerdown", (event) => {
  held.set(event.pointerId, [event.clientX, event.clientY]);
  canvas.setPointerCapture?.(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  const box = canvas.getBoundingClientRect(), before = held.get(event.pointerId), now = [event.clientX, event.clientY];
  if (held.size < 2) point([(now[0] - box.left) / box.width, (now[1] - box.top) / box.height]);
  if (!before) return describe(scene(canvas.width / canvas.height));
  const wide = held.size === 2 && apart();
  held.set(event.pointerId, now);
  if (wide) return zoom(apart() / wide);
  const pull = 3 / box.width, what = event.shiftKey ? "lamp" : chosen("drag");
  if (what !== "point") move(what, (now[0] - before[0]) * pull, (before[1] - now[1]) * pull);
  else redraw();
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
canvas.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && document.activeElement !== canvas) return;
  event.preventDefault();
  zoom(Math.exp(-event.deltaY / 400));
}, { passive: false });

const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
canvas.addEventListener("keydown", (event) => {
  const exposure = find("exposure");
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key in KEYS) move(event.shiftKey ? "lamp" : chosen("drag"), ...KEYS[event.key].map((x) => 0.06 * x));
  else if (event.key === "PageUp" || event.key === "PageDown") zoom(event.key === "PageUp" ? 1.1 : 1 / 1.1);
  else if ("+-=".includes(event.key)) {
    exposure.value = Number(exposure.value) + (event.key === "-" ? -0.2 : 0.2);
    changed();
  } else return;
  event.preventDefault();
});

function changed() {
  const stops = Number(find("exposure").value);
  find("stops").textContent = `${stops < 0 ? "−" : "+"}${Math.abs(stops).toFixed(1)}`;
  find("point").hidden = chosen("drag") !== "point";
  redraw();
}
find("controls").addEventListener("input", changed);
find("controls").addEventListener("submit", (event) => event.preventDefault());
find("split").addEventListener("input", redraw);
find("rotation").addEventListener("input", () => {
  state.rotation = (find("rotation").value * Math.PI) / 180;
  move("surroundings", 0, 0);
});
for (const choice of document.querySelectorAll("input[name=around]"))
  choice.addEventListener("change", () => surround(choice.value === "none" ? null : choice.value === "yours" ? state.file : BUILT_IN[choice.value]()));

function surround(map) {
  state.around = map && { map };
  resting = true;
  redraw();
}

// what a person opens or drops: a mesh, or a map of light
async function open(file) {
  try {
    if (file.name.toLowerCase().endsWith(".hdr")) return openMap(file, await readRadiance(file));
    state.own = await readMesh(file);
  } catch (error) {
    const what = error instanceof FileError ? error.message : "expected a mesh (.obj, .glb, .gltf) or surroundings (.hdr), got a damaged file";
    return say(what.startsWith(file.name) ? what : `${file.name}: ${what}`);
  }
  drawing?.shape("own", state.own);
  find("own").hidden = false;
  choose("shape", "own");
  say(`${file.name}: ${state.own.indices.length / 3} triangles`);
  redraw();
}

function openMap(file, map) {
  state.file = map;
  find("yours").hidden = false;
  choose("around", "yours");
  surround(map);
  // its mean is shown as white's half
  const mean = dot(LUMINANCE, lampsOf(map, 1)[0].irradiance) / (4 * Math.PI);
  if (mean > 0) find("exposure").value = -Math.log2(2 * mean);
  say(`${file.name}: ${map.width} x ${map.height}`);
  changed();
}
find("file").addEventListener("change", (event) => event.target.files[0] && open(event.target.files[0]));
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
  say(drawing.filtered ? "" : "This device does not filter half-float textures: the table is interpolated in the shader, which is slower.");
  draw();
}
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault();
  drawing = null;
  say("The graphics device was lost; the picture comes back when the browser returns it.");
});
canvas.addEventListener("webglcontextrestored", start);
start();
offerHeadset();
document.body.dataset.ready = "true";
