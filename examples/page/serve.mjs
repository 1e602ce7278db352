// node serve.mjs DATA [--node-modules DIR] [--port N] [--no-isolation]
// Serves this page, DATA under /data/ and onnxruntime-web under /ort/, with COOP and COEP.
import fs from "node:fs";
import http from "node:http";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: {
    "node-modules": { type: "string", default: "node_modules" },
    port: { type: "string", default: "8080" },
    "no-isolation": { type: "boolean", default: false },
  },
});
const ORT = path.join(values["node-modules"], "onnxruntime-web", "dist");
if (!fs.existsSync(ORT)) {
  console.error(`${ORT} is not there; npm install onnxruntime-web`);
  process.exit(2);
}
const ROOTS = [
  ["/ort/", ORT],
  ["/data/", positionals[0] ?? "."],
  ["/", path.dirname(fileURLToPath(import.meta.url))],
].map(([prefix, folder]) => [prefix, path.resolve(folder)]);
const TYPES = {
  ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript",
  ".wasm": "application/wasm", ".png": "image/png", ".jpg": "image/jpeg",
};

const server = http.createServer((request, response) => {
  if (!values["no-isolation"]) {
    response.setHeader("Cross-Origin-Opener-Policy", "same-origin");
    response.setHeader("Cross-Origin-Embedder-Policy", "require-corp");
  }
  const { pathname } = new URL(request.url, "http://localhost");
  const wanted = pathname === "/" ? "/index.html" : pathname;
  const [prefix, folder] = ROOTS.find(([start]) => wanted.startsWith(start));
  const file = path.join(folder, path.basename(wanted.slice(prefix.length)));
  if (!fs.statSync(file, { throwIfNoEntry: false })?.isFile()) return response.writeHead(404).end();
  response.setHeader("Content-Type", TYPES[path.extname(file)] ?? "application/octet-stream");
  return fs.createReadStream(file).pipe(response);
});
server.listen(Number(values.port), "127.0.0.1", () =>
  console.log(`http://127.0.0.1:${server.address().port}/?data=data/`));
