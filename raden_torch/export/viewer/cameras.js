// Matrices as WebGL has them, column by column, and directions by two angles.
const HALF_HEIGHT = 0.36, NEAR = 0.1, FAR = 20;

// half the picture's width and height at distance 1: the shape fits into the shorter side
function halfSizes(aspect, zoom = 1) {
  const half = HALF_HEIGHT / zoom;
  return aspect < 1 ? [half, half / aspect] : [half * aspect, half];
}

function projection([x, y]) {
  return [1 / x, 0, 0, 0, 0, 1 / y, 0, 0, 0, 0, -(FAR + NEAR) / (FAR - NEAR), -1, 0, 0, (-2 * FAR * NEAR) / (FAR - NEAR), 0];
}

function product(a, b) {
  return Array.from({ length: 16 }, (_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[(i % 4) + 4 * k] * b[4 * Math.floor(i / 4) + k], 0));
}

// a point p goes to p · scale + by
const placed = (by, scale = 1) => [scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, ...by, 1];

// columns of the rotation about x, then y
function turned([right, up]) {
  const [c, s, d, t] = [Math.cos(right), Math.sin(right), Math.cos(up), Math.sin(up)];
  return [[c, t * s, -d * s], [0, d, t], [s, -t * c, d * c]];
}

const towards = ([right, up]) => [Math.sin(right) * Math.cos(up), Math.sin(up), Math.cos(right) * Math.cos(up)];
