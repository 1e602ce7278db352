// Opens exported pages in one headless Chromium and does what the tests ask. Arguments: node_modules,
// Chromium. A visit a line on stdin as JSON: {page, width, height, scale, before, frame, steps:
// [[action, ...words]], picture}; what is there at first and after each step as a line on stdout.
import path from "node:path";
import readline from "node:readline";
import { pathToFileURL } from "node:url";
import { openChromium } from "../../raden_torch/export/workers/chromium.mjs";

const [modules, chromium] = process.argv.slice(2);
const browser = await openChromium(modules, chromium, { viewport: { width: 640, height: 900 } });
const { context } = browser;

// frozen, so that a busy machine does not choose fewer lamps; few texels, since SwiftShader is slow
const still = (scale) => {
  performance.now = () => 0;
  Object.defineProperty(window, "devicePixelRatio", { get: () => scale });
};

function seen() {
  const text = (id) => document.getElementById(id).textContent, value = (id) => Number(document.getElementById(id).value);
  const picture = document.getElementById("picture"), { width, height } = picture;
  return {
    width, height, picture: picture.toDataURL(), wide: document.documentElement.scrollWidth, state: text("state"),
    label: text("label"), stops: text("stops"), exposure: value("exposure"), rotation: value("rotation"), aria: picture.ariaLabel,
    headset: !document.getElementById("headset").hidden, lamps: Number(document.body.dataset.lamps),
    angles: ["incidence", "receiving", "tilt", "value"].map(text) };
}

async function act(page, action, words) {
  if (action === "check") await page.check(`input[name=${words[0]}][value="${words[1]}"]`);
  if (action === "toggle") await page.click(words[0]);
  if (action === "key") { await page.focus("#picture"); await page.keyboard.press(words[0]); }
  if (action === "file") await page.setInputFiles("#file", words[0]);
  if (action === "run") return page.evaluate(words[0]);
  if (action === "axe") {
    await page.addScriptTag({ path: path.join(modules, "axe-core/axe.min.js") });
    const { violations } = await page.evaluate(() => window.axe.run());
    return violations.flatMap(({ id, nodes }) => nodes.map((node) => `${id}: ${node.html.slice(0, 80)}`));
  }
  if (action === "drag") {
    const box = await page.locator("#picture").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + words[0], y + words[1], { steps: 3 });
    await page.mouse.up();
  }
}

async function visited({ page: file, width, height, scale = 1, before = "", frame = false, steps = [], picture }) {
  const found = { errors: [], requests: [], seen: [], replies: [] }, page = await context.newPage();
  try {
    await page.setViewportSize({ width, height });
    page.on("pageerror", (error) => found.errors.push(error.message));
    page.on("request", (request) => found.requests.push(request.url().slice(0, 60)));
    await page.addInitScript(still, scale);
    if (before) await page.addInitScript(before);
    await page.goto(pathToFileURL(file).href);
    const at = frame ? await (await page.waitForSelector("iframe")).contentFrame() : page;
    await at.waitForSelector("body[data-ready=true]", { timeout: 120_000 });
    const look = async () => {
      // what was asked for is drawn in the next frame
      await at.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 30)))));
      await at.waitForFunction(() => (document.body.dataset.resting ?? "true") === "true", null, { timeout: 120_000 });
      found.seen.push(await at.evaluate(seen));
    };
    await look();
    for (const [action, ...words] of steps) {
      found.replies.push(await act(at, action, words) ?? null);
      await look();
    }
    if (picture) await page.screenshot({ path: picture, fullPage: true });
  } catch (error) {
    found.errors.push(error.message);
  }
  await page.close();
  return found;
}

try {
  for await (const line of readline.createInterface({ input: process.stdin }))
    process.stdout.write(JSON.stringify(await visited(JSON.parse(line))) + "\n");
} finally {
  await browser.close();
}
