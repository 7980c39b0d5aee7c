// Vectors as arrays [x, y, z]; quaternions [w, x, y, z]; 4 × 4 matrices as 16 numbers, column after column.

const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => scaled(a, 1 / (length(a) || 1));
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const mix = (a, b, u) => a.map((x, i) => x + u * (b[i] - x));

/** The matrix of a pose: position p and quaternion q. */
function posed(p, q) {
  const [w, x, y, z] = q;
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    p[0], p[1], p[2], 1,
  ];
}

function times(a, b) {
  const c = new Array(16);
  for (let i = 0; i < 4; i++)
    for (let j = 0; j < 4; j++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + j] * b[4 * i + k];
      c[4 * i + j] = sum;
    }
  return c;
}

/** A point or, with w = 0, a direction through a matrix. */
const through = (m, v, w = 1) => [0, 1, 2].map((i) => m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + m[12 + i] * w);

/** A frame at p whose z axis is n; x is any direction across, or near the one given. */
function facing(p, n, near = Math.abs(n[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]) {
  const x = unit(add(near, n, -dot(near, n)));
  const y = cross(n, x);
  return [...x, 0, ...y, 0, ...n, 0, ...p, 1];
}

/** Poses a and b (7 numbers each from an offset in an array), mixed: position along the line, turn along the arc. */
function between(array, a, b, u) {
  let side = 0;
  for (let i = 3; i < 7; i++) side += array[a + i] * array[b + i];
  const v = side < 0 ? -u : u;
  const out = [];
  for (let i = 0; i < 3; i++) out.push(array[a + i] + u * (array[b + i] - array[a + i]));
  let norm = 0;
  for (let i = 3; i < 7; i++) {
    out.push((1 - u) * array[a + i] + v * array[b + i]);
    norm += out[i] * out[i];
  }
  norm = Math.sqrt(norm);
  for (let i = 3; i < 7; i++) out[i] /= norm;
  return out;
}

function looking(eye, centre, up) {
  const z = unit(add(eye, centre, -1));
  const x = unit(cross(up, z));
  const y = cross(z, x);
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
}

function perspective(field, aspect, near, far) {
  const f = 1 / Math.tan(field / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

function parallel(half, near, far) {
  return [1 / half, 0, 0, 0, 0, 1 / half, 0, 0, 0, 0, -2 / (far - near), 0, 0, 0, -(far + near) / (far - near), 1];
}

/** '#rrggbb' as three numbers in 0…1. */
const rgb = (colour) => [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16) / 255);
