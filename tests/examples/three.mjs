// Draws scenes with RadenMaterial in the current three, in headless Chromium, for test_three.py.
// Arguments: node_modules, Chromium's program, a folder with shell.glsl, other.glsl, their tables,
// sky.bin and what scenes need; what was drawn is written there.
import fs from "node:fs";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { openChromium, serve } from "../../raden_torch/export/workers/chromium.mjs";

const [modules, chromium, folder] = process.argv.slice(2);
const example = path.join(path.dirname(fileURLToPath(import.meta.url)), "../../examples/three");

const PAGE = `<!doctype html><meta charset="utf-8"><title>three</title>
<script type="importmap">{"imports": {"three": "/modules/three/build/three.module.js",
  "three/addons/": "/modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { RadenMaterial, loadShell } from "/demo/raden-material.js";

const SIDE = 128;
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setPixelRatio(1);
renderer.setSize(SIDE, SIDE);
renderer.shadowMap.enabled = true;
renderer.shadowMap.type = THREE.BasicShadowMap;
document.body.append(renderer.domElement);
const gl = renderer.getContext();
const camera = new THREE.PerspectiveCamera(40, 1, 0.1, 50);
camera.position.set(0.5, 0.4, 3.1);
camera.lookAt(0, 0, 0);
const save = (name, body) => fetch("/data/" + name, { method: "PUT", body });
const sphere = new THREE.SphereGeometry(1, 96, 64);

async function draw(name, objects, change = () => {}) {
  const scene = new THREE.Scene();
  scene.add(...objects);
  change(scene);
  renderer.render(scene, camera);
  const bytes = new Uint8Array(4 * SIDE * SIDE);
  gl.readPixels(0, 0, SIDE, SIDE, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  await save("drawn." + name, bytes);
}

// what three interpolates of the mesh, for the library to shade
async function gbuffer(mesh) {
  const target = new THREE.WebGLRenderTarget(SIDE, SIDE, { type: THREE.FloatType });
  for (const [name, what] of [["normal", "normalize(turned)"], ["position", "where"]]) {
    const material = new THREE.ShaderMaterial({
      vertexShader: \`varying vec3 turned, where; void main() {
        turned = mat3(modelMatrix) * normal; where = (modelMatrix * vec4(position, 1.0)).xyz;
        gl_Position = projectionMatrix * viewMatrix * vec4(where, 1.0); }\`,
      fragmentShader: \`varying vec3 turned, where; void main() { gl_FragColor = vec4(\${what}, 1.0); }\` });
    const scene = new THREE.Scene();
    scene.add(new THREE.Mesh(mesh.geometry, material));
    renderer.setRenderTarget(target);
    renderer.setClearColor(0, 0);
    renderer.render(scene, camera);
    const values = new Float32Array(4 * SIDE * SIDE);
    renderer.readRenderTargetPixels(target, 0, 0, SIDE, SIDE, values);
    await save("drawn." + name, values);
  }
  renderer.setRenderTarget(null);
}

const at = (light, ...place) => { light.position.set(...place); return light; };
const sun = () => at(new THREE.DirectionalLight(0xffffff, 2.5), 1, 2, 2);
const colour = (r, g, b) => new THREE.Color().setRGB(r, g, b, THREE.LinearSRGBColorSpace);

async function main() {
  const shell = await loadShell("/data/shell.glsl");
  const material = new RadenMaterial({ shell });
  const ball = new THREE.Mesh(sphere, material);
  await gbuffer(ball);
  await draw("directional", [ball, sun()]);
  await draw("point", [ball, at(new THREE.PointLight(colour(1, 0.8, 0.6), 9), -1.2, 1, 1.8)]);
  const spot = at(new THREE.SpotLight(colour(0.7, 0.9, 1), 14, 0, 0.3, 0), 0.8, 1.2, 2.4);
  await draw("spot", [ball, spot, spot.target]);
  await draw("on_camera", [ball, at(new THREE.PointLight(0xffffff, 8), ...camera.position.toArray())]);
  await draw("several", [ball, sun(), at(new THREE.PointLight(colour(1, 0.8, 0.6), 4), -1.2, 1, 1.8)]);
  await draw("ambient", [ball, new THREE.AmbientLight(colour(1, 0.9, 0.8), 2)]);
  await draw("hemisphere", [ball, new THREE.HemisphereLight(colour(1, 1, 1), colour(0.1, 0.1, 0.1), 2)]);
  await draw("dark", [ball]);

  // the same by other ways through three
  const crowd = new THREE.InstancedMesh(sphere, material, 2);
  crowd.setMatrixAt(0, new THREE.Matrix4());
  crowd.setMatrixAt(1, new THREE.Matrix4().makeTranslation(0, 90, 0));
  await draw("instanced", [crowd, sun()]);
  const skinned = sphere.clone(), count = sphere.attributes.position.count;
  skinned.setAttribute("skinIndex", new THREE.Uint16BufferAttribute(new Uint16Array(4 * count), 4));
  const weights = new Float32Array(4 * count).map((_, i) => (i % 4 ? 0 : 1));
  skinned.setAttribute("skinWeight", new THREE.Float32BufferAttribute(weights, 4));
  const bone = new THREE.Bone(), dressed = new THREE.SkinnedMesh(skinned, material.clone());
  dressed.add(bone);
  dressed.bind(new THREE.Skeleton([bone]));
  await draw("skinned", [dressed, sun()]);
  const tinted = new RadenMaterial({ shell, color: colour(0.5, 0.5, 0.5) });
  await draw("tinted", [new THREE.Mesh(sphere, tinted), at(new THREE.DirectionalLight(0xffffff, 5), 1, 2, 2)]);
  const swapped = new RadenMaterial({ shell: await loadShell("/data/other.glsl") });
  const other = new THREE.Mesh(sphere, swapped);
  await draw("other", [other, sun()]);
  swapped.shell = shell;
  await draw("swapped", [other, sun()]);

  await draw("fog", [ball, sun()], (scene) => { scene.fog = new THREE.Fog(0x808080, 0.1, 0.2); });
  const lamp = sun(), lid = new THREE.Mesh(new THREE.PlaneGeometry(9, 9), new THREE.MeshBasicMaterial());
  lid.position.set(2, 4, 4);
  lid.lookAt(0, 0, 0);
  lid.material.side = THREE.DoubleSide;
  lid.layers.set(0);
  lamp.castShadow = lid.castShadow = ball.receiveShadow = true;
  lamp.position.set(4, 8, 8);
  await draw("shadowed", [ball, lamp, lid]);
  lid.castShadow = false;
  await draw("unshadowed", [ball, lamp, lid]);

  const sky = new Float32Array(await (await fetch("/data/sky.bin")).arrayBuffer());
  const map = new THREE.DataTexture(sky, 256, 128, THREE.RGBAFormat, THREE.FloatType);
  Object.assign(map, { mapping: THREE.EquirectangularReflectionMapping, magFilter: THREE.LinearFilter,
    minFilter: THREE.LinearFilter, wrapS: THREE.RepeatWrapping, needsUpdate: true });
  for (const samples of [64]) {
    const lit = new THREE.Mesh(sphere, new RadenMaterial({ shell, environmentSamples: samples }));
    await draw("environment" + samples, [lit], (scene) => { scene.environment = map; });
  }

  const said = {};
  for (const [name, job] of [
    ["missing", () => loadShell("/data/missing.glsl")],
    ["short", () => loadShell("/data/short.glsl")],
    ["samples", () => new RadenMaterial({ shell, environmentSamples: 7 })],
  ])
    said[name] = await Promise.resolve().then(job).then(() => "", (error) => error.message);
  await save("said.json", JSON.stringify({ ...said, revision: THREE.REVISION }));

  if ((await fetch("/data/shell.gltf", { method: "HEAD" })).ok) {
    const loaded = await new GLTFLoader().loadAsync("/data/shell.gltf");
    const mesh = loaded.scene.getObjectByProperty("isMesh", true);
    const ball = new THREE.Mesh(sphere, mesh.material);
    await draw("gltf", [ball, sun()]);
    const { color, roughness, metalness, iridescence, iridescenceIOR, iridescenceThicknessRange, ior } = mesh.material;
    await save("gltf.json", JSON.stringify({ type: mesh.material.type, color: color.toArray(), roughness,
      metalness, iridescence, iridescenceIOR, iridescenceThicknessRange, ior }));
  }
}
main().then(() => { window.state = "done"; }, (error) => { window.state = error.stack; });
</script>`;

const roots = { "/demo/node_modules/": modules, "/demo/": example, "/modules/": modules, "/data/": folder };
const server = await serve(roots, { index: PAGE });
const { page, close } = await openChromium(modules, chromium, { viewport: { width: 960, height: 640 } });
const errors = [];
page.on("pageerror", (error) => errors.push(error.message));
page.on("console", (message) => { if (message.type() === "error") errors.push(message.text()); });
try {
  await page.goto(server.address);
  await page.waitForFunction(() => window.state, null, { timeout: 240_000 });
  const state = await page.evaluate(() => window.state);
  if (state !== "done") errors.push(state);
  await page.emulateMedia({ reducedMotion: "reduce" }); // else frames of SwiftShader leave no time
  await page.goto(server.address + "demo/index.html?shell=/data/shell.glsl");
  await page.waitForSelector("body[data-drawn=true]", { timeout: 120_000 });
  await page.screenshot({ path: path.join(folder, "demo.png") });
} finally {
  await close();
  server.close();
}
fs.writeFileSync(path.join(folder, "errors.json"), JSON.stringify(errors));
