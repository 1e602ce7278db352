// onnxruntime-web (WebAssembly) in headless Chromium, on a page served with COOP and COEP.
// Arguments: the folder node_modules, Chromium's program, threads, the job's folder. See worker.py.
import fs from "node:fs";
import http from "node:http";
import os from "node:os";
import path from "node:path";
import readline from "node:readline";
import { createRequire } from "node:module";

const [modules, chromium, threads, folder] = process.argv.slice(2);
const say = (words) => process.stdout.write(JSON.stringify(words) + "\n");
const own = createRequire(path.join(path.resolve(modules), "package.json"));

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

const TYPES = { ".mjs": "text/javascript", ".js": "text/javascript", ".wasm": "application/wasm" };
const ROOTS = {
  "/ort/": path.join(path.resolve(modules), "onnxruntime-web", "dist"),
  "/job/": folder,
};

function answer(request, response) {
  response.setHeader("Cross-Origin-Opener-Policy", "same-origin");
  response.setHeader("Cross-Origin-Embedder-Policy", "require-corp");
  response.setHeader("Cache-Control", "no-store");
  const { pathname } = new URL(request.url, "http://localhost");
  const prefix = pathname.slice(0, 5);
  if (pathname === "/") return response.setHeader("Content-Type", "text/html").end(PAGE);
  if (!(prefix in ROOTS)) return response.writeHead(404).end();
  const file = path.join(ROOTS[prefix], path.basename(pathname));
  if (request.method === "PUT")
    return request.pipe(fs.createWriteStream(file)).on("finish", () => response.end());
  if (!fs.existsSync(file)) return response.writeHead(404).end();
  response.setHeader("Content-Type", TYPES[path.extname(file)] ?? "application/octet-stream");
  return fs.createReadStream(file).pipe(response);
}

async function main() {
  const about = path.join(modules, "onnxruntime-web", "package.json");
  const { version } = JSON.parse(fs.readFileSync(about, "utf8"));
  const server = http.createServer(answer);
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  const profile = fs.mkdtempSync(path.join(os.tmpdir(), "raden-browser-"));
  let context;
  try {
    context = await own("playwright-core").chromium.launchPersistentContext(profile, {
      executablePath: chromium,
      headless: true,
      ignoreDefaultArgs: ["--enable-unsafe-swiftshader"],
      args: [
        "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
      ],
    });
    const page = await context.newPage();
    let said = "";
    page.on("pageerror", (error) => { said ||= error.message; });
    page.on("console", (message) => { if (message.type() === "error") said ||= message.text(); });
    await page.goto(`http://127.0.0.1:${server.address().port}/`);
    await page.waitForFunction(() => window.ready, { timeout: 50_000 }).catch(() => {
      throw new Error(said || "the page did not load the file");
    });
    const browser = context.browser()?.version() ?? (await page.evaluate(
      () => navigator.userAgent.match(/Chrome\/([\d.]+)/)?.[1] ?? "?"));
    const isolated = await page.evaluate(() => window.isolated);
    const note = `Chromium ${browser}, ${isolated ? `${threads} threads` : "1 thread: no COOP/COEP"}`;
    say({ version, note });
    for await (const line of readline.createInterface({ input: process.stdin })) {
      try {
        say(await page.evaluate((request) => window.run(request), JSON.parse(line)));
      } catch (error) {
        say({ error: error.message.split("\n")[0] });
      }
    }
  } finally {
    await context?.close();
    server.close();
    fs.rmSync(profile, { recursive: true, force: true });
  }
}

main().catch((error) => say({ error: error.message.split("\n")[0] }));
