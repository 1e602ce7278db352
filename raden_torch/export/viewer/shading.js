// The GLSL of the picture: shells by their exported functions, lacquer, lamps, surroundings.
const MOST_LAMPS = 264;
const LACQUER_ALPHA = 0.07;

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
uniform mat4 camera;
uniform mat3 turn;
out vec3 at, own, n;
void main() {
  own = position;
  at = turn * position;
  n = turn * normal;
  gl_Position = camera * vec4(at, 1.0);
}`;

// for devices whose filter does not take half floats: the eight texels, mixed here
const TRILINEAR = `
vec4 trilinear(highp sampler3D table, vec3 place, float level) {
  vec3 last = vec3(textureSize(table, 0) - 1);
  vec3 p = clamp(place * (last + 1.0) - 0.5, vec3(0.0), last);
  ivec3 i = ivec3(p), j = min(i + 1, ivec3(last));
  vec3 f = p - vec3(i);
  #define AT(x, y, z) texelFetch(table, ivec3(x, y, z), 0)
  return mix(
    mix(mix(AT(i.x, i.y, i.z), AT(j.x, i.y, i.z), f.x), mix(AT(i.x, j.y, i.z), AT(j.x, j.y, i.z), f.x), f.y),
    mix(mix(AT(i.x, i.y, j.z), AT(j.x, i.y, j.z), f.x), mix(AT(i.x, j.y, j.z), AT(j.x, j.y, j.z), f.x), f.y), f.z);
}`;

const fragment = (functions, count, filtered) => `#version 300 es
precision highp float;
precision highp int;
${filtered ? functions : TRILINEAR + functions.replaceAll("textureLod(", "trilinear(")}
// direction and irradiance of each lamp, those of the surroundings last
layout(std140) uniform Lamps { vec4 lamp[${2 * MOST_LAMPS}]; };
uniform vec3 eye;
uniform vec2 turned;
uniform int lamps, distant, part;
uniform float exposure, split;
uniform bool inlaid, normals;
uniform highp sampler2D mirrored;
in vec3 at, own, n;
out vec4 colour;

vec3 shell(vec3 N, vec3 L, vec3 V) {
  bool second = ${count > 1} && gl_FragCoord.x > split;
  vec3 diffuse = vec3(0.0);
  if (part != 0) diffuse = second ? ${count > 1 ? "diffuse_1" : "diffuse_0"}(N, L, V) : diffuse_0(N, L, V);
  if (part == 1) return diffuse;
  return (second ? ${count > 1 ? "shell_1" : "shell_0"}(N, L, V) : shell_0(N, L, V)) - diffuse;
}

// black urushi: a dark base below a polished coat of index 1.53, GGX
float fresnel(float c) {
  float g = sqrt(1.0 - (1.0 - c * c) / 2.3409), s = (c - 1.53 * g) / (c + 1.53 * g), p = (1.53 * c - g) / (1.53 * c + g);
  return (s * s + p * p) / 2.0;
}
vec3 lacquer_base(float i, float o) {
  return vec3(0.010, 0.006, 0.004) / 3.14159265 * (1.0 - fresnel(i)) * (1.0 - fresnel(o));
}
vec3 lacquer(vec3 N, vec3 L, vec3 V, bool with_gloss) {
  if (dot(N, L) <= 0.0 || dot(N, V) <= 0.0) return vec3(0.0);
  float i = max(dot(N, L), 1e-4), o = max(dot(N, V), 1e-4), a = ${LACQUER_ALPHA * LACQUER_ALPHA};
  if (!with_gloss) return lacquer_base(i, o);
  vec3 h = normalize(L + V);
  float c = clamp(dot(N, h), 0.0, 1.0), x = c * c * (a - 1.0) + 1.0;
  float masked = 1.0 / ((i + sqrt(a + (1.0 - a) * i * i)) * (o + sqrt(a + (1.0 - a) * o * o)));
  float gloss = fresnel(clamp(dot(L, h), 0.0, 1.0)) * a / (3.14159265 * x * x) * masked;
  return lacquer_base(i, o) + gloss;
}

// the surroundings that lacquer mirrors, blurred by its lobe; filtered here: floats need not be by the device
vec3 reflection(vec3 r) {
  vec3 d = vec3(turned.x * r.x - turned.y * r.z, r.y, turned.x * r.z + turned.y * r.x);
  ivec2 size = textureSize(mirrored, 0);
  vec2 p = vec2(atan(d.x, -d.z) / 6.2831853 + 0.5, acos(clamp(d.y, -1.0, 1.0)) / 3.14159265) * vec2(size) - 0.5;
  ivec2 i = ivec2(floor(p));
  vec2 f = p - vec2(i);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    ivec2 q = i + ivec2(k & 1, k >> 1);
    q = ivec2((q.x + size.x) % size.x, clamp(q.y, 0, size.y - 1));
    sum += texelFetch(mirrored, q, 0).rgb * ((k & 1) == 1 ? f.x : 1.0 - f.x) * (k > 1 ? f.y : 1.0 - f.y);
  }
  return sum;
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
  for (int k = 0; k < lamps + distant; k++) {
    vec3 L = lamp[2 * k].xyz, f = vec3(0.0);
    if (share > 0.0) f += share * shell(N, L, V);
    if (share < 1.0) f += (1.0 - share) * lacquer(N, L, V, k < lamps);
    radiance += f * lamp[2 * k + 1].rgb * max(dot(N, L), 0.0);
  }
  if (distant > 0 && share < 1.0)
    radiance += (1.0 - share) * fresnel(max(dot(N, V), 1e-4)) * reflection(reflect(-V, N));
  colour = vec4(displayed(radiance), 1.0);
}`;
