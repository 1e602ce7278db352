// Headless Chromium with a profile of its own, and a server of folders on this machine alone.
import fs from "node:fs";
import http from "node:http";
import os from "node:os";
import path from "node:path";
import { createRequire } from "node:module";

const QUIET = [
  "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync",
];
// WebGL 2 and WebGPU without a graphics card
const SWIFTSHADER = [
  "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--enable-unsafe-webgpu",
  "--use-webgpu-adapter=swiftshader",
];
const TYPES = {
  ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript",
  ".wasm": "application/wasm", ".json": "application/json",
};

// modules: a folder with playwright-core; program: Chromium's; graphics: by SwiftShader, or none.
export async function openChromium(modules, program, { graphics = true, viewport } = {}) {
  const own = createRequire(path.join(path.resolve(modules), "package.json"));
  const profile = fs.mkdtempSync(path.join(os.tmpdir(), "raden-browser-"));
  const context = await own("playwright-core").chromium.launchPersistentContext(profile, {
    executablePath: program,
    headless: true,
    ignoreDefaultArgs: graphics ? [] : ["--enable-unsafe-swiftshader"],
    args: [...QUIET, ...(graphics ? SWIFTSHADER : ["--disable-gpu"])],
    ...(viewport && { viewport }),
  });
  const page = await context.newPage();
  const version = await page.evaluate(() => navigator.userAgent.match(/Chrome\/([\d.]+)/)?.[1] ?? "?");
  const close = async () => {
    await context.close();
    fs.rmSync(profile, { recursive: true, force: true });
  };
  return { context, page, version, close };
}

// roots: {"/prefix/": folder}; index: the text of the page at /; isolated: with COOP and COEP, as
// threads want it. What is PUT goes into the folder.
export async function serve(roots, { index = "", isolated = false } = {}) {
  const answer = (request, response) => {
    response.setHeader("Cache-Control", "no-store");
    if (isolated) {
      response.setHeader("Cross-Origin-Opener-Policy", "same-origin");
      response.setHeader("Cross-Origin-Embedder-Policy", "require-corp");
    }
    const { pathname } = new URL(request.url, "http://localhost");
    if (pathname === "/") return response.setHeader("Content-Type", "text/html").end(index);
    const prefix = Object.keys(roots).find((start) => pathname.startsWith(start));
    if (!prefix) return response.writeHead(404).end();
    const file = path.join(roots[prefix], path.normalize("/" + pathname.slice(prefix.length)));
    if (request.method === "PUT")
      return request.pipe(fs.createWriteStream(file)).on("finish", () => response.end());
    if (!fs.statSync(file, { throwIfNoEntry: false })?.isFile()) return response.writeHead(404).end();
    response.setHeader("Content-Type", TYPES[path.extname(file)] ?? "application/octet-stream");
    return fs.createReadStream(file).pipe(response);
  };
  const server = http.createServer(answer);
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  const address = `http://127.0.0.1:${server.address().port}/`;
  return { address, close: () => server.close() };
}
