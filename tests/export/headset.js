// A headset of two eyes for the viewer's test: frames by the page's own, both eyes on its canvas.
window.hands = [];
window.XRWebGLLayer = class {
  constructor(session, gl) { Object.assign(this, { gl, framebuffer: null }); }
  getViewport({ eye }) {
    const { width, height } = this.gl.canvas;
    return { x: eye === "left" ? 0 : width / 2, y: 0, width: width / 2, height };
  }
};
const rigid = ([x, y, z]) => ({
  position: { x, y, z },
  inverse: { matrix: new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, -z, 1]) } });
// half sizes 0.5 x 0.6 at distance 1
const lens = new Float32Array([2, 0, 0, 0, 0, 1 / 0.6, 0, 0, 0, 0, -1.002, -1, 0, 0, -0.02, 0]);
class Session extends EventTarget {
  updateRenderState() {}
  async requestReferenceSpace(kind) { return kind; }
  requestAnimationFrame(frame) {
    if (!this.ended) requestAnimationFrame((time) => this.ended || frame(time, {
      session: this,
      getViewerPose: () => ({ views: ["left", "right"].map((eye) => ({
        eye, projectionMatrix: lens, transform: rigid([eye === "left" ? -0.03 : 0.03, 0, 0]) })) }),
      getPose: (space) => ({ transform: rigid(space) }) }));
  }
  select(kind, at) { this.dispatchEvent(Object.assign(new Event(kind), { inputSource: this.hand ??= { targetRaySpace: at } })); }
  end() { this.ended = true; this.dispatchEvent(new Event("end")); }
}
Object.defineProperty(navigator, "xr", { value: {
  isSessionSupported: async (kind) => kind === "immersive-vr",
  requestSession: async () => (window.session = new Session()) } });
WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
