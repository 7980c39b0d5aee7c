// Triangle meshes of the shapes that a model is made of: {points, normals, faces}, all flat arrays.

/** A surface of revolution about z: rings of [radius, height, normal outwards, normal upwards]. */
function turned(rings, sides = 32) {
  const points = [], normals = [], faces = [];
  for (const [r, z, nr, nz] of rings)
    for (let i = 0; i <= sides; i++) {
      const c = Math.cos((2 * Math.PI * i) / sides), s = Math.sin((2 * Math.PI * i) / sides);
      points.push(r * c, r * s, z);
      normals.push(nr * c, nr * s, nz);
    }
  for (let k = 0; k + 1 < rings.length; k++)
    for (let i = 0; i < sides; i++) {
      const a = k * (sides + 1) + i, b = a + sides + 1;
      faces.push(a, a + 1, b + 1, a, b + 1, b);
    }
  return { points, normals, faces };
}

/** Rings of a ball, from angle a to angle b above the equator. */
function ball(radius, height, a, b, count) {
  const rings = [];
  for (let i = 0; i <= count; i++) {
    const t = a + ((b - a) * i) / count;
    rings.push([radius * Math.cos(t), height + radius * Math.sin(t), Math.cos(t), Math.sin(t)]);
  }
  return rings;
}

const QUARTER = Math.PI / 2;

const SOLIDS = {
  sphere: (s) => turned(ball(s[0], 0, -QUARTER, QUARTER, 16)),
  capsule: (s) => turned([...ball(s[0], -s[1], -QUARTER, 0, 7), ...ball(s[0], s[1], 0, QUARTER, 7)], 28),
  cylinder: (s) =>
    turned([[0, -s[1], 0, -1], [s[0], -s[1], 0, -1], [s[0], -s[1], 1, 0], [s[0], s[1], 1, 0], [s[0], s[1], 0, 1], [0, s[1], 0, 1]], 48),
  cone: ([r, h]) => {
    const slope = Math.hypot(r, h);
    return turned([[0, h, 0, 1], [r, h, 0, 1], [r, h, h / slope, -r / slope], [0, 0, h / slope, -r / slope]].reverse());
  },
  ellipsoid: (s) => {
    const { points, normals, faces } = turned(ball(1, 0, -QUARTER, QUARTER, 28), 48);
    return {
      points: points.map((x, i) => x * s[i % 3]),
      normals: unitised(normals.map((x, i) => x / s[i % 3])),
      faces,
    };
  },
  box: (s) => {
    const points = [], normals = [], faces = [];
    for (let axis = 0; axis < 3; axis++)
      for (const side of [-1, 1]) {
        const first = points.length / 3;
        for (const [u, v] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
          const p = [0, 0, 0], n = [0, 0, 0];
          p[axis] = side * s[axis];
          p[(axis + 1) % 3] = side * u * s[(axis + 1) % 3];
          p[(axis + 2) % 3] = v * s[(axis + 2) % 3];
          n[axis] = side;
          points.push(...p);
          normals.push(...n);
        }
        faces.push(first, first + 1, first + 2, first, first + 2, first + 3);
      }
    return { points, normals, faces };
  },
};

function unitised(normals) {
  const out = new Float32Array(normals.length);
  for (let i = 0; i < normals.length; i += 3) out.set(unit([normals[i], normals[i + 1], normals[i + 2]]), i);
  return out;
}

/** A mesh without normals: corners share one where their faces meet at less than the crease angle. */
function creased(points, faces, crease = Math.cos((40 * Math.PI) / 180)) {
  const count = faces.length / 3, own = [], around = new Map();
  const at = (i) => [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => at(faces[3 * f + k]));
    own.push(cross(add(b, a, -1), add(c, a, -1)));
  }
  const key = (i) => `${points[3 * i].toFixed(6)},${points[3 * i + 1].toFixed(6)},${points[3 * i + 2].toFixed(6)}`;
  const keys = Array.from(faces, key);
  keys.forEach((k, i) => (around.has(k) ? around.get(k).push((i / 3) | 0) : around.set(k, [(i / 3) | 0])));
  const outPoints = new Float32Array(9 * count), outNormals = new Float32Array(9 * count);
  for (let i = 0; i < 3 * count; i++) {
    const mine = own[(i / 3) | 0];
    let sum = [0, 0, 0];
    for (const other of around.get(keys[i])) if (dot(unit(mine), unit(own[other])) > crease) sum = add(sum, own[other]);
    outPoints.set(at(faces[i]), 3 * i);
    outNormals.set(unit(sum), 3 * i);
  }
  return { points: outPoints, normals: outNormals, faces: Uint32Array.from({ length: 3 * count }, (_, i) => i) };
}
