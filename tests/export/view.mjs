// Opens an exported viewer from disk in headless Chromium, does what the tests ask, and prints what
// is there as JSON. Arguments: node_modules, Chromium, a folder for the picture, the visit as JSON:
// {page, width, height, before, steps: [[action, ...words]]}.
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [modules, chromium, folder, visit] = process.argv.slice(2);
const { page: file, width, height, before = "", steps = [] } = JSON.parse(visit);
const { chromium: browser } = createRequire(path.join(path.resolve(modules), "x.js"))("playwright-core");
const profile = fs.mkdtempSync(path.join(os.tmpdir(), "raden-browser-"));
const context = await browser.launchPersistentContext(profile, {
  executablePath: chromium, headless: true, viewport: { width, height },
  args: [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
  ],
});
const found = { errors: [], requests: [], seen: [] };
try {
  const page = await context.newPage();
  page.on("pageerror", (error) => found.errors.push(error.message));
  page.on("request", (request) => found.requests.push(request.url().slice(0, 60)));
  if (before) await page.addInitScript(before);
  await page.goto(pathToFileURL(file).href);
  await page.waitForSelector("body[data-ready=true]", { timeout: 120_000 });
  const look = async () => {
    await page.waitForTimeout(150);
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    found.seen.push(await page.evaluate(() => {
      const text = (id) => document.getElementById(id).textContent;
      const { width, height } = document.getElementById("picture");
      return { width, height, picture: document.getElementById("picture").toDataURL(),
        slice: document.getElementById("slice").toDataURL(),
        wide: document.documentElement.scrollWidth, state: text("state"), label: text("label"), stops: text("stops"),
        angles: ["incidence", "receiving", "tilt", "value"].map(text) };
    }));
  };
  await look();
  for (const [action, ...words] of steps) {
    if (action === "check") await page.check(`input[name=${words[0]}][value="${words[1]}"]`);
    if (action === "key") { await page.focus("#picture"); await page.keyboard.press(words[0]); }
    if (action === "file") await page.setInputFiles("#mesh", words[0]);
    if (action === "run") await page.evaluate(words[0]);
    if (action === "drag") {
      const box = await page.locator("#picture").boundingBox();
      const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
      await page.mouse.move(x, y);
      await page.mouse.down();
      await page.mouse.move(x + words[0], y + words[1], { steps: 3 });
      await page.mouse.up();
    }
    await look();
  }
  await page.screenshot({ path: path.join(folder, "viewer.png"), fullPage: true });
} finally {
  await context.close();
  fs.rmSync(profile, { recursive: true, force: true });
}
fs.writeFileSync(path.join(folder, "viewer.json"), JSON.stringify(found));
