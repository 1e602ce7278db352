// WebGL 2: the shells' textures, a shape, and one pass.
const MOST_LAMPS = 32;

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
uniform mat4 projection;
uniform mat3 turn;
uniform vec3 eye;
out vec3 at, own, n;
void main() {
  own = position;
  at = turn * position;
  n = turn * normal;
  gl_Position = projection * vec4(at - eye, 1.0);
}`;

const fragment = (functions, count) => `#version 300 es
${functions}
uniform vec3 eye, directions[${MOST_LAMPS}], irradiances[${MOST_LAMPS}];
uniform int lamps, part;
uniform float exposure, split;
uniform bool inlaid, normals;
in vec3 at, own, n;
out vec4 colour;

vec3 shell(vec3 N, vec3 L, vec3 V) {
  bool second = ${count > 1} && gl_FragCoord.x > split;
  vec3 diffuse = second ? ${count > 1 ? "diffuse_1" : "diffuse_0"}(N, L, V) : diffuse_0(N, L, V);
  if (part == 1) return diffuse;
  vec3 all = second ? ${count > 1 ? "shell_1" : "shell_0"}(N, L, V) : shell_0(N, L, V);
  return part == 2 ? all - diffuse : all;
}

// black urushi: a dark base below a polished coat of index 1.53, GGX of roughness 0.07
float fresnel(float c) {
  float g = sqrt(1.0 - (1.0 - c * c) / 2.3409), s = (c - 1.53 * g) / (c + 1.53 * g), p = (1.53 * c - g) / (1.53 * c + g);
  return (s * s + p * p) / 2.0;
}
vec3 lacquer(vec3 N, vec3 L, vec3 V) {
  float i = max(dot(N, L), 1e-4), o = max(dot(N, V), 1e-4), a = 0.07 * 0.07;
  vec3 h = normalize(L + V);
  float c = clamp(dot(N, h), 0.0, 1.0), x = c * c * (a - 1.0) + 1.0;
  float masked = 1.0 / ((i + sqrt(a + (1.0 - a) * i * i)) * (o + sqrt(a + (1.0 - a) * o * o)));
  float gloss = fresnel(clamp(dot(L, h), 0.0, 1.0)) * a / (3.14159265 * x * x) * masked;
  vec3 base = vec3(0.010, 0.006, 0.004) / 3.14159265 * (1.0 - fresnel(i)) * (1.0 - fresnel(o));
  return dot(N, L) > 0.0 && dot(N, V) > 0.0 ? base + gloss : vec3(0.0);
}

// a chrysanthemum of two rings of petals, and a border, cut from the shell: 0 lacquer, 1 shell
float petals(vec2 p, float count, float inner, float outer, float turned) {
  float each = 6.2831853 / count, angle = atan(p.y, p.x) + turned;
  angle = (fract(angle / each) - 0.5) * each;
  vec2 q = length(p) * vec2(cos(angle), sin(angle)) - vec2((inner + outer) / 2.0, 0.0);
  vec2 half_size = vec2((outer - inner) / 2.0, 0.43 * each * (inner + outer) / 2.0);
  return (1.0 - length(q / half_size)) * half_size.y;
}
float motif(vec2 p) {
  float inside = max(petals(p, 16.0, 0.45, 0.8, 0.0), petals(p, 12.0, 0.17, 0.43, 0.13));
  inside = max(inside, 0.13 - length(p));
  vec2 edge = abs(p);
  float along = fract(min(edge.x, edge.y) * 11.0) - 0.5;
  inside = max(inside, min(0.018 - abs(max(edge.x, edge.y) - 0.92), (0.42 - abs(along)) / 11.0));
  return clamp(inside / fwidth(inside) + 0.5, 0.0, 1.0);
}

vec3 displayed(vec3 c) {
  c = clamp(c * exp2(exposure), 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

void main() {
  vec3 V = normalize(eye - at), N = normalize(n);
  if (inlaid && dot(N, V) < 0.0) N = -N;
  if (normals) { colour = vec4(N * 0.5 + 0.5, 1.0); return; }
  float share = inlaid ? motif(own.xy) : 1.0;
  vec3 radiance = vec3(0.0);
  for (int k = 0; k < lamps; k++) {
    vec3 L = directions[k];
    vec3 f = mix(inlaid ? lacquer(N, L, V) : vec3(0.0), shell(N, L, V), share);
    radiance += f * irradiances[k] * max(dot(N, L), 0.0);
  }
  colour = vec4(displayed(radiance), 1.0);
}`;

class Drawing {
  constructor(canvas, shells, functions) {
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2, which the picture needs. Browsers from 2021 or newer have it.");
    const largest = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    for (const { all } of shells)
      if (Math.max(...all.sides) > largest)
        throw new Error(`This device takes textures of ${largest} texels a side; the shell's table has ${Math.max(...all.sides)}.`);
    Object.assign(this, { gl, canvas, program: gl.createProgram() });
    this.compile(gl.VERTEX_SHADER, VERTEX);
    this.compile(gl.FRAGMENT_SHADER, fragment(functions, shells.length));
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    shells.forEach(({ all, diffuse }, i) => {
      this.texture(2 * i, `table_${i}`, all);
      this.texture(2 * i + 1, `diffuse_table_${i}`, diffuse);
    });
    this.meshes = {};
  }

  compile(kind, text) {
    const { gl } = this, shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(this.program, shader);
  }

  texture(slot, name, { sides: [u, v, w], halves }) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + slot);
    gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
    for (const side of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_3D, gl["TEXTURE_" + side], gl.LINEAR);
    for (const side of ["S", "T", "R"]) gl.texParameteri(gl.TEXTURE_3D, gl["TEXTURE_WRAP_" + side], gl.CLAMP_TO_EDGE);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, w, v, u, 0, gl.RGBA, gl.HALF_FLOAT, texels(halves));
    gl.uniform1i(this.uniform(name), slot);
  }

  uniform(name) {
    return this.gl.getUniformLocation(this.program, name);
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

  draw({ shape, turn, eye, lamps, part, exposure, split, normals = false }) {
    const { gl, canvas } = this, { array, count } = this.meshes[shape];
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, normals ? 0 : 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.uniform("projection"), false, projection(canvas.width / canvas.height));
    gl.uniformMatrix3fv(this.uniform("turn"), false, turn.flat());
    gl.uniform3fv(this.uniform("eye"), eye);
    gl.uniform3fv(this.uniform("directions"), lamps.flatMap((lamp) => unit(lamp.direction)));
    gl.uniform3fv(this.uniform("irradiances"), lamps.flatMap((lamp) => lamp.irradiance));
    for (const [name, value] of Object.entries({ lamps: lamps.length, part, inlaid: shape === "plate", normals }))
      gl.uniform1i(this.uniform(name), value);
    gl.uniform1f(this.uniform("exposure"), exposure);
    gl.uniform1f(this.uniform("split"), split * canvas.width);
    gl.bindVertexArray(array);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
  }

  // the normal at a pixel, to a degree, or null beside the shape
  normalAt(x, y, scene) {
    const { gl } = this, pixel = new Uint8Array(4);
    this.draw({ ...scene, normals: true });
    gl.readPixels(x, this.canvas.height - 1 - y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    this.draw(scene);
    return pixel[3] ? unit([0, 1, 2].map((i) => pixel[i] / 127.5 - 1)) : null;
  }
}

const HALF_HEIGHT = 0.36, NEAR = 0.1, FAR = 20;
function projection(aspect) {
  const [x, y] = aspect < 1 ? [HALF_HEIGHT, HALF_HEIGHT / aspect] : [HALF_HEIGHT * aspect, HALF_HEIGHT];
  return [1 / x, 0, 0, 0, 0, 1 / y, 0, 0, 0, 0, -(FAR + NEAR) / (FAR - NEAR), -1, 0, 0, (-2 * FAR * NEAR) / (FAR - NEAR), 0];
}
