// Radiance .hdr files: RGBE scanlines, run-length coded or flat, top row first.
const LARGEST_MAP = 8192;

async function readRadiance(file) {
  if (file.size > 100e6) throw new FileError(`${file.name}: expected at most 100 MB, got ${(file.size / 1e6).toFixed(0)} MB`);
  const bytes = new Uint8Array(await file.arrayBuffer());
  const { width, height, start } = radianceHeader(bytes, file.name);
  if (width !== 2 * height || width > LARGEST_MAP)
    throw new FileError(`${file.name}: expected a lat-long map, twice as wide as high, at most ${LARGEST_MAP} wide, got ${width} x ${height}`);
  const rgb = new Float32Array(3 * width * height), line = new Uint8Array(4 * width);
  let at = start;
  for (let row = 0; row < height; row++) {
    at = scanline(bytes, at, line, width);
    if (!(at <= bytes.length)) throw new FileError(`${file.name}: expected ${height} rows of light, got ${row}: the file is cut or damaged`);
    for (let i = 0; i < width; i++) {
      const scale = line[4 * i + 3] ? 2 ** (line[4 * i + 3] - 136) : 0;
      for (let c = 0; c < 3; c++) rgb[3 * (row * width + i) + c] = line[4 * i + c] * scale;
    }
  }
  return reduced({ width, height, rgb }, 1024);
}

function radianceHeader(bytes, name) {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, 4096));
  const found = /^#\?[^\n]*\n(?:[^\n]+\n)*?\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\n/.exec(text);
  if (!found) throw new FileError(`${name}: expected a Radiance picture, which begins with #?, got another file`);
  if (found[1] !== "-Y" || found[3] !== "+X")
    throw new FileError(`${name}: expected rows from the top, "-Y … +X …", got "${found[1]} … ${found[3]} …"`);
  if (/^FORMAT=32-bit_rle_xyze/m.test(found[0])) throw new FileError(`${name}: expected RGB light, got XYZ`);
  return { width: Number(found[4]), height: Number(found[2]), start: found[0].length };
}

// fills a line of RGBE; where the next one begins, or NaN where the bytes make no line
function scanline(bytes, at, line, width) {
  const coded = bytes[at] === 2 && bytes[at + 1] === 2 && bytes[at + 2] < 128 && width >= 8 && width < 32768;
  if (!coded) {
    line.set(bytes.subarray(at, at + 4 * width));
    return at + 4 * width;
  }
  if (bytes[at + 2] * 256 + bytes[at + 3] !== width) return NaN;
  at += 4;
  for (let c = 0; c < 4; c++)
    for (let i = 0; i < width; ) {
      const run = bytes[at] > 128, count = run ? bytes[at] - 128 : bytes[at];
      if (!count || i + count > width) return NaN;
      for (let k = 0; k < count; k++, i++) line[4 * i + c] = bytes[run ? at + 1 : at + 1 + k];
      at += run ? 2 : 1 + count;
    }
  return at;
}
