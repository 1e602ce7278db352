// Opens a page in headless Chromium and prints what is on it as JSON.
// Arguments: node_modules, Chromium's program, a folder for the pictures, the visit as JSON:
// {url, graphics, noSimd, files: {input: path}, drop: path, pointer: [x, y]} with x, y in 0…1 of the canvas.
import fs from "node:fs";
import path from "node:path";
import { openChromium } from "../../raden_torch/export/workers/chromium.mjs";

const [modules, chromium, pictures, visit] = process.argv.slice(2);
const { url, graphics = false, noSimd, files = {}, drop, pointer } = JSON.parse(visit);
const { page, close } = await openChromium(modules, chromium, {
  graphics, viewport: { width: 900, height: 800 },
});
try {
  if (noSimd) await page.addInitScript(() => { WebAssembly.validate = () => false; });
  await page.goto(url);
  await page.waitForSelector("body[data-ready=true]", { timeout: 240_000 });
  const settled = async () => {
    await page.waitForTimeout(300);
    await page.waitForSelector("body[data-ready=true]", { timeout: 240_000 });
    await page.waitForSelector("body:not([data-drawn=false])", { timeout: 240_000 });
  };
  for (const [input, file] of Object.entries(files)) {
    await page.setInputFiles(`#${input}`, file);
    await settled();
  }
  if (drop) {
    const bytes = [...fs.readFileSync(drop)];
    await page.evaluate(([name, values]) => {
      const carried = new DataTransfer();
      carried.items.add(new File([Uint8Array.from(values)], name));
      dispatchEvent(new DragEvent("drop", { dataTransfer: carried, cancelable: true }));
    }, [path.basename(drop), bytes]);
    await settled();
  }
  if (pointer) {
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.move(box.x + pointer[0] * box.width, box.y + pointer[1] * box.height);
    await settled();
  }
  const found = await page.evaluate(() => {
    const canvas = document.getElementById("picture");
    const { width, height } = canvas;
    const pixels = [...canvas.getContext("2d").getImageData(0, 0, width, height).data];
    const text = (id) => document.getElementById(id).textContent;
    return { width, height, pixels, message: text("message"), state: text("state") };
  });
  await page.screenshot({ path: path.join(pictures, "page.png") });
  fs.writeFileSync(path.join(pictures, "page.json"), JSON.stringify(found));
} finally {
  await close();
}
