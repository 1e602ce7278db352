// WebGL 2: the shells' textures, shapes, and one pass for the picture.
class Drawing {
  constructor(canvas, shells, functions) {
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2, which the picture needs. Browsers from 2021 or newer have it.");
    const largest = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    for (const { all } of shells)
      if (Math.max(...all.sides) > largest)
        throw new Error(`This device takes textures of ${largest} texels a side; the shell's table has ${Math.max(...all.sides)}.`);
    this.filtered = filtersHalves(gl);
    const program = linked(gl, VERTEX, fragment(functions, shells.length, this.filtered));
    Object.assign(this, { gl, canvas, program, places: {}, meshes: {} });
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    shells.forEach(({ all, diffuse }, i) => {
      this.texture(2 * i, `table_${i}`, all);
      this.texture(2 * i + 1, `diffuse_table_${i}`, diffuse);
    });
    if (gl.getError() === gl.OUT_OF_MEMORY) throw new Error("This device has no room for the shells' tables.");
    this.lampBuffer = gl.createBuffer();
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, this.lampBuffer);
    gl.bufferData(gl.UNIFORM_BUFFER, 32 * MOST_LAMPS, gl.DYNAMIC_DRAW);
    gl.uniformBlockBinding(program, gl.getUniformBlockIndex(program, "Lamps"), 0);
    this.mirror({ width: 1, height: 1, rgb: new Float32Array(3) });
    this.pixel = target(gl);
  }

  texture(slot, name, { sides: [u, v, w], halves }) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + slot);
    gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
    sampled(gl, gl.TEXTURE_3D, this.filtered ? gl.LINEAR : gl.NEAREST);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, w, v, u, 0, gl.RGBA, gl.HALF_FLOAT, texels(halves));
    gl.uniform1i(this.uniform(name), slot);
  }

  // the blurred surroundings that lacquer mirrors
  mirror(map) {
    if (this.mirrors === map) return;
    const { gl } = this, { width, height, rgb } = (this.mirrors = map), slot = 4;
    gl.activeTexture(gl.TEXTURE0 + slot);
    if (this.mirrored) gl.deleteTexture(this.mirrored);
    this.mirrored = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.mirrored);
    sampled(gl, gl.TEXTURE_2D, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB32F, width, height, 0, gl.RGB, gl.FLOAT, rgb);
    gl.uniform1i(this.uniform("mirrored"), slot);
  }

  uniform(name) {
    return (this.places[name] ??= this.gl.getUniformLocation(this.program, name));
  }

  shape(name, { positions, normals, indices }) {
    const { gl } = this, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    [positions, normals].forEach((values, i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, Float32Array.from(values), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from(indices), gl.STATIC_DRAW);
    this.meshes[name] = { array, count: indices.length };
  }

  // camera: the shape's space → clip space; viewport: [x, y, width, height]
  draw({ shape, turn, camera, eye, lamps, distant, rotation, part, exposure, split, normals = false }, viewport) {
    const { gl } = this, { array, count } = this.meshes[shape];
    gl.viewport(...viewport);
    gl.uniformMatrix4fv(this.uniform("camera"), false, camera);
    gl.uniformMatrix3fv(this.uniform("turn"), false, turn.flat());
    gl.uniform3fv(this.uniform("eye"), eye);
    gl.uniform2f(this.uniform("turned"), Math.cos(rotation), Math.sin(rotation));
    const all = [...lamps, ...distant], block = new Float32Array(8 * all.length);
    all.forEach(({ direction, irradiance }, k) => {
      block.set(unit(direction), 8 * k);
      block.set(irradiance, 8 * k + 4);
    });
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.lampBuffer);
    gl.bufferSubData(gl.UNIFORM_BUFFER, 0, block);
    const whole = { lamps: lamps.length, distant: distant.length, part, inlaid: shape === "plate", normals };
    for (const [name, value] of Object.entries(whole)) gl.uniform1i(this.uniform(name), value);
    gl.uniform1f(this.uniform("exposure"), exposure);
    gl.uniform1f(this.uniform("split"), viewport[0] + split * viewport[2]);
    // what a person drops may be wound either way
    if (shape === "sphere") gl.enable(gl.CULL_FACE);
    else gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(array);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
  }

  picture(scene) {
    const { gl, canvas } = this;
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.draw(scene, [0, 0, canvas.width, canvas.height]);
  }

  // the normal at a place of the picture, −1…1 to the right and up, to a degree; null beside the shape
  normalAt(x, y, scene) {
    const { gl, canvas: { width, height } } = this, pixel = new Uint8Array(4), camera = [...scene.camera];
    // the picture grows until one pixel of it is all
    for (let i = 0; i < 16; i += 4) {
      camera[i] = width * (camera[i] - x * camera[i + 3]);
      camera[i + 1] = height * (camera[i + 1] - y * camera[i + 3]);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.pixel);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.draw({ ...scene, lamps: [], distant: [], camera, normals: true }, [0, 0, 1, 1]);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return pixel[3] ? unit([0, 1, 2].map((i) => pixel[i] / 127.5 - 1)) : null;
  }
}

function linked(gl, ...texts) {
  const program = gl.createProgram();
  [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, i) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, texts[i]);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  });
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "The graphics device was lost.");
  return program;
}

function sampled(gl, target, filter) {
  for (const side of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(target, gl["TEXTURE_" + side], filter);
  for (const side of ["S", "T", "R"]) gl.texParameteri(target, gl["TEXTURE_WRAP_" + side], gl.CLAMP_TO_EDGE);
}

// one pixel to draw into
function target(gl) {
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  for (const [format, place] of [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
    const buffer = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, format, 1, 1);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return frame;
}

// WebGL 2 demands that half floats are filtered; whether this device does is seen between 0 and 1
function filtersHalves(gl) {
  const program = linked(gl, "#version 300 es\nvoid main() { gl_Position = vec4(0.0, 0.0, 0.0, 1.0); gl_PointSize = 1.0; }",
    `#version 300 es
    precision highp float;
    uniform highp sampler3D halves;
    out vec4 colour;
    void main() { colour = textureLod(halves, vec3(0.5), 0.0); }`);
  const texture = gl.createTexture(), frame = target(gl), pixel = new Uint8Array(4);
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_3D, texture);
  sampled(gl, gl.TEXTURE_3D, gl.LINEAR);
  gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, 2, 1, 1, 0, gl.RGBA, gl.HALF_FLOAT, new Uint16Array([0, 0, 0, 0, 0x3c00, 0, 0, 0]));
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.viewport(0, 0, 1, 1);
  gl.useProgram(program);
  gl.drawArrays(gl.POINTS, 0, 1);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(frame);
  gl.deleteTexture(texture);
  gl.deleteProgram(program);
  return Math.abs(pixel[0] - 127.5) < 16;
}
