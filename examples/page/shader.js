// An exported shader in onnxruntime-web: pixels go in, radiance comes out, a tile at a time. By WebGPU
// where the browser has it, else by WebAssembly.
const TILE = { webgpu: 1_048_576, wasm: 65_536 };

// i8x16.splat and i8x16.popcnt: valid only where WebAssembly has SIMD
const SIMD = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15,
  253, 98, 11,
]);

// An error whose text is for the person in front of the page.
export class PersonError extends Error {}

async function hasWebGpu() {
  return Boolean(await navigator.gpu?.requestAdapter().catch(() => null));
}

// The runtime and a session by one of "webgpu" and "wasm"; each has a build of onnxruntime-web.
async function sessionBy(by, bytes, threads) {
  const ort = await import(by === "webgpu" ? "./ort/ort.webgpu.min.mjs" : "./ort/ort.wasm.min.mjs");
  ort.env.wasm.numThreads = threads;
  ort.env.logLevel = "error";
  return { ort, by, session: await ort.InferenceSession.create(bytes, { executionProviders: [by] }) };
}

export async function openShader(bytes) {
  if (!WebAssembly.validate(SIMD))
    throw new PersonError(
      "This browser has no WebAssembly SIMD, which onnxruntime-web needs. Use one from 2023 or newer.");
  const threads = self.crossOriginIsolated ? Math.min(navigator.hardwareConcurrency || 1, 4) : 1;
  // what a graphics card refuses, the processor may take
  const first = (await hasWebGpu()) ? sessionBy("webgpu", bytes, threads).catch(() => null) : null;
  const opened = (await first) ?? (await sessionBy("wasm", bytes, threads).catch((error) => {
    throw new PersonError(`This is not a model that onnxruntime-web can load (${error.message}).`);
  }));
  const { ort, by, session } = opened;
  const inputs = [...session.inputNames].sort().join(", ");
  const [output] = session.outputNames;
  if (session.inputNames.includes("camera"))
    throw new PersonError(
      "This model has the profile “scene”; the page needs “gbuffer”: raden export MODEL -o shell.onnx");
  if (inputs !== "light, normal, view")
    throw new PersonError(
      `This is not a shader of raden_torch with the profile “gbuffer”: its inputs are ${inputs}.`);
  if (output !== "radiance")
    throw new PersonError(
      `This model gives “${output}”; the page needs “radiance”: raden export MODEL -o shell.onnx`);

  // normal: x of all pixels, then y, then z → radiance: red of all pixels, then green, then blue
  async function run(normal, light, view) {
    const count = normal.length / 3;
    const radiance = new Float32Array(3 * count);
    const one = (vector) => new ort.Tensor("float32", Float32Array.from(vector), [1, 3, 1, 1]);
    for (let start = 0; start < count; start += TILE[by]) {
      const end = Math.min(start + TILE[by], count);
      const tile = new Float32Array(3 * (end - start));
      for (let c = 0; c < 3; c++)
        tile.set(normal.subarray(c * count + start, c * count + end), c * (end - start));
      const feeds = {
        normal: new ort.Tensor("float32", tile, [1, 3, 1, end - start]),
        light: one(light),
        view: one(view),
      };
      const { data } = (await session.run(feeds))[output];
      for (let c = 0; c < 3; c++)
        radiance.set(data.subarray(c * (end - start), (c + 1) * (end - start)), c * count + start);
    }
    return radiance;
  }
  const note = by === "webgpu" || self.crossOriginIsolated
    ? ""
    : "The page is served without the headers COOP and COEP, so it runs in one thread.";
  return { run, by: by === "webgpu" ? "WebGPU" : `WebAssembly, ${threads} thread(s)`, note };
}
