// WebXR: the shape at arm's length, a picture for each eye; the trigger holds the lamp.
const PLACE = [0, -0.15, -0.7], RADIUS = 0.2;

async function offerHeadset() {
  const usable = await navigator.xr?.isSessionSupported("immersive-vr").catch(() => false);
  find("headset").hidden = !usable || !drawing;
  find("headset").addEventListener("click", () => enter().catch((error) => {
    if (drawing) drawing.immersed = false;
    say(`Headset: ${error.message}`);
  }));
}

async function enter() {
  const session = await navigator.xr.requestSession("immersive-vr"), { gl } = drawing, now = drawing;
  await gl.makeXRCompatible();
  const layer = new XRWebGLLayer(session, gl);
  session.updateRenderState({ baseLayer: layer, depthNear: NEAR / 10, depthFar: FAR });
  const space = await session.requestReferenceSpace("local");
  const triggers = new Set();
  session.addEventListener("selectstart", (event) => triggers.add(event.inputSource));
  session.addEventListener("selectend", (event) => triggers.delete(event.inputSource));
  session.addEventListener("end", () => {
    now.immersed = false;
    resting = true;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    say("");
    redraw();
  });
  now.immersed = true;
  resting = false; // a frame has little time
  say("In the headset: hold the trigger and the lamp is where your hand is.");
  session.requestAnimationFrame(function frame(time, given) {
    session.requestAnimationFrame(frame);
    const pose = given.getViewerPose(space);
    if (!pose || drawing !== now) return;
    for (const source of triggers) carry(given.getPose(source.targetRaySpace, space));
    bothEyes(layer, pose.views);
  });
}

// the lamp shines from the hand; both angles as `towards` takes them
function carry(pose) {
  if (!pose) return;
  const { x, y, z } = pose.transform.position, d = unit(minus([x, y, z], PLACE));
  state.lamp = [Math.atan2(d[0], d[2]), Math.asin(Math.min(Math.max(d[1], -1), 1))];
}

function bothEyes(layer, views) {
  const { gl } = drawing, now = scene(1);
  if (now.shape === "plate") reflectAround();
  gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
  gl.clearColor(0, 0, 0, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  for (const view of views) {
    const { x, y, width, height } = layer.getViewport(view), at = view.transform.position;
    const camera = product(product([...view.projectionMatrix], [...view.transform.inverse.matrix]), placed(PLACE, RADIUS));
    const eye = minus([at.x, at.y, at.z], PLACE).map((metres) => metres / RADIUS);
    drawing.draw({ ...now, camera, eye }, [x, y, width, height]);
  }
}
