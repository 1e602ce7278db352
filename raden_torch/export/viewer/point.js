// What is at one point of the picture: the three angles, f_r, and the table's slice there.
const degrees = (x) => `${(Math.round((x * 1800) / Math.PI) / 10 + 0).toFixed(1)}°`;

// the angles at the point, and the slice of the table over receiving angle and tilt (fig. 9)
function describe(now) {
  if (!drawing || drawing.immersed) return;
  const [across, down] = state.point, x = 2 * across - 1, y = 1 - 2 * down;
  const normal = drawing.normalAt(x, y, now), [wide, high] = halfSizes(canvas.width / canvas.height, state.zoom);
  for (const id of ["incidence", "receiving", "tilt", "value"]) find(id).textContent = "–";
  if (!normal) return slice(null);
  const view = unit([-x * wide, -y * high, 1]), light = towards(state.lamp), at = angles(normal, light, view);
  if (dot(normal, light) <= 0) { find("incidence").textContent = "lamp below the horizon"; return slice(null); }
  ["incidence", "receiving", "tilt"].forEach((id, i) => { find(id).textContent = degrees(at[i]); });
  const shell = shells[shells.length > 1 && across > now.split ? 1 : 0];
  find("value").textContent = shell.all.at(...at).map((f) => f.toFixed(3)).join(", ");
  slice(at, shell);
}

function slice(at, shell) {
  const context = find("slice").getContext("2d"), { width, height } = find("slice");
  context.clearRect(0, 0, width, height);
  if (!at) return;
  const picture = context.createImageData(width, height), radians = Math.PI / 180;
  const gain = Math.PI * 2 ** Number(find("exposure").value);
  for (let j = 0; j < height; j++)
    for (let i = 0; i < width; i++) {
      const f = shell.all.at(at[0], (i - 70) * radians, (70 - j) * radians);
      f.forEach((value, c) => {
        const light = Math.min(Math.max(value * gain, 0), 1);
        picture.data[4 * (j * width + i) + c] = 255 * (light > 0.0031308 ? 1.055 * light ** (1 / 2.4) - 0.055 : 12.92 * light);
      });
      picture.data[4 * (j * width + i) + 3] = 255;
    }
  context.putImageData(picture, 0, 0);
  const x = 70.5 + at[1] / radians, y = 70.5 - at[2] / radians;
  for (const [style, wide] of [["#000", 3], ["#fff", 1]]) {
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.beginPath();
    context.arc(x, y, 4, 0, 7);
    context.stroke();
  }
}
