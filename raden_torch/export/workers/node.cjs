// onnxruntime-node. Arguments: the folder node_modules, the job's folder. See worker.py.
"use strict";
const fs = require("node:fs");
const path = require("node:path");
const readline = require("node:readline");
const { createRequire } = require("node:module");

const [modules, folder] = process.argv.slice(2);
const say = (words) => process.stdout.write(JSON.stringify(words) + "\n");

async function main() {
  const own = createRequire(path.join(path.resolve(modules), "package.json"));
  const ort = own("onnxruntime-node");
  const about = path.join(modules, "onnxruntime-node", "package.json");
  const { version } = JSON.parse(fs.readFileSync(about, "utf8"));
  const file = path.join(folder, "model.onnx");
  const session = await ort.InferenceSession.create(file, { logSeverityLevel: 3 });
  say({ version });
  for await (const line of readline.createInterface({ input: process.stdin })) {
    const { inputs, repeat } = JSON.parse(line);
    try {
      const feeds = {};
      for (const [name, sizes] of Object.entries(inputs)) {
        const bytes = fs.readFileSync(path.join(folder, `${name}.bin`));
        const values = new Float32Array(new Uint8Array(bytes).buffer);
        feeds[name] = new ort.Tensor("float32", values, sizes);
      }
      const milliseconds = [];
      let output;
      for (let i = 0; i < repeat; i++) {
        const start = performance.now();
        output = (await session.run(feeds))[session.outputNames[0]];
        milliseconds.push(performance.now() - start);
      }
      const { buffer, byteOffset, byteLength } = output.data;
      fs.writeFileSync(path.join(folder, "output.bin"), Buffer.from(buffer, byteOffset, byteLength));
      say({ shape: output.dims, milliseconds });
    } catch (error) {
      say({ error: error.message });
    }
  }
}

main().catch((error) => say({ error: error.message.split("\n")[0] }));
