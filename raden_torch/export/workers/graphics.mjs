// A shader text in headless Chromium: GLSL in WebGL 2, WGSL in WebGPU, both drawn by SwiftShader.
// Arguments: the folder node_modules, Chromium's program, "glsl" or "wgsl", the job's folder with
// shader.txt, table.bin and table.json. Inputs normal, light, view: [pixels, 4]. See worker.py.
import readline from "node:readline";
import { openChromium, serve } from "./chromium.mjs";

const [modules, chromium, language, folder] = process.argv.slice(2);
const say = (words) => process.stdout.write(JSON.stringify(words) + "\n");

const PAGE = `<!doctype html><meta charset="utf-8"><title>runtime</title><script type="module">
const bytes = async (name) => (await fetch("/job/" + name)).arrayBuffer();
const source = await (await fetch("/job/shader.txt")).text();
const table = await (await fetch("/job/table.json")).json();
const texels = new Uint16Array(await bytes("table.bin"));
const NAMES = ["normal", "light", "view"];

async function webgl() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw new Error("no WebGL 2 with float targets");
  const compiled = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, "#version 300 es\\n" + text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl.VERTEX_SHADER,
    "void main() { gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 2 * (gl_VertexID & 2) - 1, 0, 1); }"));
  gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, source + \`
    uniform highp sampler2D normal, light, view;
    out vec4 colour;
    vec3 at(highp sampler2D map) { return texelFetch(map, ivec2(gl_FragCoord.xy), 0).xyz; }
    void main() { colour = vec4(raden_brdf(at(normal), at(light), at(view)), 1.0); }\`));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  const image = (unit, target, filter) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    for (const name of ["MIN", "MAG"]) gl.texParameteri(target, gl["TEXTURE_" + name + "_FILTER"], filter);
    for (const name of ["S", "T", "R"]) gl.texParameteri(target, gl["TEXTURE_WRAP_" + name], gl.CLAMP_TO_EDGE);
  };
  image(0, gl.TEXTURE_3D, gl.LINEAR);
  gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, table.width, table.height, table.depth, 0, gl.RGBA, gl.HALF_FLOAT, texels);
  gl.uniform1i(gl.getUniformLocation(program, "raden_table"), 0);
  return async (maps, width, height) => {
    NAMES.forEach((name, i) => {
      image(i + 1, gl.TEXTURE_2D, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, maps[i]);
      gl.uniform1i(gl.getUniformLocation(program, name), i + 1);
    });
    image(4, gl.TEXTURE_2D, gl.NEAREST);
    const target = gl.getParameter(gl.TEXTURE_BINDING_2D);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
    gl.activeTexture(gl.TEXTURE5);
    gl.viewport(0, 0, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const output = new Float32Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, output);
    if (gl.getError()) throw new Error("WebGL reports an error");
    return output;
  };
}

async function webgpu() {
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) throw new Error("no WebGPU adapter");
  const device = await adapter.requestDevice();
  const module = device.createShaderModule({ code: source + \`
    @group(0) @binding(2) var<storage, read> maps: array<vec4f>;
    @group(0) @binding(3) var<storage, read_write> colour: array<vec4f>;
    @compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {
      let count = arrayLength(&colour);
      let i = id.x + id.y * 65535u * 64u;
      if (i < count) {
        colour[i] = vec4f(raden_brdf(maps[i].xyz, maps[i + count].xyz, maps[i + 2u * count].xyz), 1.0);
      }
    }\` });
  const wrong = (await module.getCompilationInfo()).messages.find((m) => m.type === "error");
  if (wrong) throw new Error(wrong.message);
  const pipeline = device.createComputePipeline({ layout: "auto", compute: { module, entryPoint: "main" } });
  const size = [table.width, table.height, table.depth];
  const texture = device.createTexture({ size, dimension: "3d", format: "rgba16float",
    usage: GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST });
  device.queue.writeTexture({ texture }, texels, { bytesPerRow: 8 * size[0], rowsPerImage: size[1] }, size);
  const linear = { magFilter: "linear", minFilter: "linear" };
  return async (maps, width, height) => {
    const count = width * height, of = (bytes, usage) => device.createBuffer({ size: bytes, usage });
    const inputs = of(48 * count, GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST);
    maps.forEach((map, i) => device.queue.writeBuffer(inputs, 16 * count * i, map));
    const result = of(16 * count, GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC);
    const read = of(16 * count, GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST);
    const resources = [texture.createView(), device.createSampler(linear), { buffer: inputs }, { buffer: result }];
    const commands = device.createCommandEncoder(), pass = commands.beginComputePass();
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, device.createBindGroup({ layout: pipeline.getBindGroupLayout(0),
      entries: resources.map((resource, binding) => ({ binding, resource })) }));
    const groups = Math.ceil(count / 64);
    pass.dispatchWorkgroups(Math.min(groups, 65535), Math.ceil(groups / 65535));
    pass.end();
    commands.copyBufferToBuffer(result, 0, read, 0, 16 * count);
    device.queue.submit([commands.finish()]);
    await read.mapAsync(GPUMapMode.READ);
    return new Float32Array(read.getMappedRange().slice(0));
  };
}

try {
  const draw = await (${JSON.stringify(language)} === "glsl" ? webgl() : webgpu());
  window.run = async ({ inputs, repeat }) => {
    const [height, width] = inputs.normal;
    const maps = [];
    for (const name of NAMES) maps.push(new Float32Array(await bytes(name + ".bin")));
    const milliseconds = [];
    let output;
    for (let i = 0; i < repeat; i++) {
      const start = performance.now();
      output = await draw(maps, width, height);
      milliseconds.push(performance.now() - start);
    }
    await fetch("/job/output.bin", { method: "PUT", body: output });
    return { shape: [height, width, 4], milliseconds };
  };
  window.state = "ready";
} catch (error) {
  window.state = error.message;
}
</script>`;

async function main() {
  const server = await serve({ "/job/": folder }, { index: PAGE });
  let browser;
  try {
    browser = await openChromium(modules, chromium);
    const { page, version } = browser;
    await page.goto(server.address);
    await page.waitForFunction(() => window.state, null, { timeout: 50_000 });
    const state = await page.evaluate(() => window.state);
    if (state !== "ready") throw new Error(state);
    say({ version, note: "Chromium, SwiftShader" });
    for await (const line of readline.createInterface({ input: process.stdin })) {
      try {
        say(await page.evaluate((request) => window.run(request), JSON.parse(line)));
      } catch (error) {
        say({ error: error.message.split("\n")[0] });
      }
    }
  } finally {
    await browser?.close();
    server.close();
  }
}

main().catch((error) => say({ error: error.message.split("\n")[0] }));
