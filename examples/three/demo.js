// A lacquered plate with blossoms cut of shell, under a lamp that goes round it. ?shell=shell.glsl
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { RadenMaterial } from "./raden-material.js";

const BLOSSOMS = [[-0.95, 0.32, 0.42], [-0.1, -0.28, 0.5], [0.85, 0.3, 0.38], [1.3, -0.42, 0.26], [-1.4, -0.5, 0.22]];
const label = document.getElementById("label");

// Sheets of nacre are wavy: a normal map of a few slow waves, the steepest some 5 degrees.
function waves(size = 256) {
  const texels = new Uint8Array(4 * size * size);
  for (let y = 0; y < size; y++)
    for (let x = 0; x < size; x++) {
      const [u, v] = [x, y].map((i) => (2 * Math.PI * i) / size);
      const dx = 0.05 * Math.cos(u + v) + 0.03 * Math.cos(2 * u - v + 1) + 0.012 * Math.cos(3 * u + 4 * v);
      const dy = 0.04 * Math.cos(u + v) - 0.04 * Math.cos(2 * v - u) + 0.012 * Math.cos(4 * v - 2 * u);
      const scale = 1 / Math.hypot(dx, dy, 1);
      texels.set([-dx, -dy, 1].map((n) => Math.round(255 * (0.5 * n * scale + 0.5))).concat(255), 4 * (y * size + x));
    }
  const map = new THREE.DataTexture(texels, size, size);
  Object.assign(map, { wrapS: THREE.RepeatWrapping, wrapT: THREE.RepeatWrapping, magFilter: THREE.LinearFilter,
    minFilter: THREE.LinearMipmapLinearFilter, generateMipmaps: true, needsUpdate: true });
  return map;
}

// One petal of a plum blossom, from the middle outwards along +y.
function petal() {
  const shape = new THREE.Shape();
  shape.moveTo(0, 0.14);
  shape.bezierCurveTo(0.14, 0.24, 0.56, 0.52, 0.42, 0.84);
  shape.bezierCurveTo(0.34, 1.02, 0.1, 1.02, 0, 0.92);
  shape.bezierCurveTo(-0.1, 1.02, -0.34, 1.02, -0.42, 0.84);
  shape.bezierCurveTo(-0.56, 0.52, -0.14, 0.24, 0, 0.14);
  return new THREE.ShapeGeometry(shape, 24);
}

// The layers of nacre are not parallel to a cut piece: a geometry whose normals are all inclined.
function inclined(geometry, x, y) {
  const piece = geometry.clone(), normal = new THREE.Vector3(x, y, 1).normalize();
  for (let i = 0; i < piece.attributes.normal.count; i++) piece.attributes.normal.setXYZ(i, ...normal.toArray());
  return piece;
}

function blossoms(material) {
  const group = new THREE.Group(), whole = petal(), eye = new THREE.CircleGeometry(0.11, 32);
  BLOSSOMS.forEach(([x, y, size], which) => {
    for (let k = 0; k <= 5; k++) {
      const [a, b] = [0.16 * Math.sin(7 * k + which), 0.16 * Math.cos(5 * k + 3 * which)];
      const mesh = new THREE.Mesh(inclined(k < 5 ? whole : eye, a, b), material);
      mesh.position.set(x, y, 0.012);
      mesh.scale.setScalar(size);
      mesh.rotation.z = (2 * Math.PI * k) / 5 + which;
      group.add(mesh);
    }
  });
  return group;
}

async function main() {
  const renderer = new THREE.WebGLRenderer({ antialias: true });
  renderer.toneMapping = THREE.NeutralToneMapping;
  document.body.append(renderer.domElement);
  const camera = new THREE.PerspectiveCamera(32, 1, 0.1, 20);
  camera.position.set(0, -1.6, 5);
  const controls = new OrbitControls(camera, renderer.domElement);

  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0x101012);
  scene.environment = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment(), 0.03).texture;
  scene.environmentIntensity = 0.03;
  const lamp = new THREE.PointLight(0xfff0dd, 40);
  scene.add(lamp);

  const url = new URLSearchParams(location.search).get("shell") ?? "shell.glsl";
  const shell = await RadenMaterial.load(url, { normalMap: waves() });
  const plate = new THREE.Mesh(
    new THREE.BoxGeometry(3.6, 2, 0.02),
    new THREE.MeshPhysicalMaterial({ color: 0x050505, roughness: 0.12, clearcoat: 1, clearcoatRoughness: 0.03 }));
  scene.add(plate, blossoms(shell));
  const { sample, simulated } = shell.shell.about.source;
  label.textContent = `${simulated ? "Simulated: " : ""}${sample || "unnamed sample"}`;

  const resize = () => {
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(innerWidth, innerHeight);
    camera.aspect = innerWidth / innerHeight;
    camera.updateProjectionMatrix();
  };
  addEventListener("resize", resize);
  resize();
  const draw = (milliseconds) => {
    const turn = milliseconds / 3000;
    lamp.position.set(2.2 * Math.cos(turn), 0.6 + 1.4 * Math.sin(turn), 2.4);
    renderer.render(scene, camera);
    document.body.dataset.drawn = "true";
  };
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) return renderer.setAnimationLoop(draw);
  // the lamp stands still; what the viewer does is drawn
  for (const [source, event] of [[controls, "change"], [window, "resize"]])
    source.addEventListener(event, () => draw(5500));
  draw(5500);
}

main().catch((error) => { label.textContent = error.message; });
