// onnxruntime-web (WebAssembly) in headless Chromium, on a page served with COOP and COEP.
// Arguments: the folder node_modules, Chromium's program, threads, the job's folder. See worker.py.
import fs from "node:fs";
import path from "node:path";
import readline from "node:readline";
import { openChromium, serve } from "./chromium.mjs";

const [modules, chromium, threads, folder] = process.argv.slice(2);
const say = (words) => process.stdout.write(JSON.stringify(words) + "\n");

const PAGE = `<!doctype html><meta charset="utf-8"><title>runtime</title><script type="module">
import * as ort from "/ort/ort.wasm.min.mjs";
ort.env.wasm.numThreads = ${Number(threads)};
ort.env.logLevel = "error";
const bytes = async (name) => (await fetch("/job/" + name)).arrayBuffer();
const session = await ort.InferenceSession.create(await bytes("model.onnx"));
window.run = async ({ inputs, repeat }) => {
  const feeds = {};
  for (const [name, sizes] of Object.entries(inputs))
    feeds[name] = new ort.Tensor("float32", new Float32Array(await bytes(name + ".bin")), sizes);
  const milliseconds = [];
  let output;
  for (let i = 0; i < repeat; i++) {
    const start = performance.now();
    output = (await session.run(feeds))[session.outputNames[0]];
    milliseconds.push(performance.now() - start);
  }
  await fetch("/job/output.bin", { method: "PUT", body: output.data });
  return { shape: [...output.dims], milliseconds };
};
window.isolated = crossOriginIsolated;
window.ready = true;
</script>`;

const ROOTS = { "/ort/": path.join(path.resolve(modules), "onnxruntime-web", "dist"), "/job/": folder };

async function main() {
  const about = path.join(modules, "onnxruntime-web", "package.json");
  const { version } = JSON.parse(fs.readFileSync(about, "utf8"));
  const server = await serve(ROOTS, { index: PAGE, isolated: true });
  let browser;
  try {
    browser = await openChromium(modules, chromium, { graphics: false });
    const { page } = browser;
    let said = "";
    page.on("pageerror", (error) => { said ||= error.message; });
    page.on("console", (message) => { if (message.type() === "error") said ||= message.text(); });
    await page.goto(server.address);
    await page.waitForFunction(() => window.ready, null, { timeout: 50_000 }).catch(() => {
      throw new Error(said || "the page did not load the file");
    });
    const isolated = await page.evaluate(() => window.isolated);
    const note = `Chromium ${browser.version}, ${isolated ? `${threads} threads` : "1 thread: no COOP/COEP"}`;
    say({ version, note });
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
