// A small renderer on WebGL 2: solids with light and a soft shadow, translucent solids, thick lines, a ground with a grid.

const SOLID_VERTEX = `#version 300 es
layout(location = 0) in vec3 point;
layout(location = 1) in vec3 normal;
uniform mat4 view, pose, local, light;
uniform vec3 scale;
out vec3 world, facing, inFrame;
out vec4 lit;
void main() {
  vec3 p = point * scale;
  vec4 w = pose * local * vec4(p, 1.0);
  world = w.xyz;
  facing = mat3(pose) * mat3(local) * (normal / scale);
  inFrame = (local * vec4(p, 1.0)).xyz;
  lit = light * vec4(w.xyz, 1.0);
  gl_Position = view * w;
}`;

const SHADOW = `
uniform highp sampler2DShadow shadows;
uniform float plain;
float shadow(vec4 lit) {
  if (plain > 0.5) return 1.0;
  vec3 at = 0.5 * lit.xyz / lit.w + 0.5;
  if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
  float sum = 0.0;
  vec2 texel = 1.1 / vec2(textureSize(shadows, 0));
  for (int i = -1; i <= 1; i += 2)
    for (int j = -1; j <= 1; j += 2) sum += texture(shadows, vec3(at.xy + vec2(i, j) * texel, at.z - 0.0012));
  return 0.25 * sum;
}`;

const SOLID_FRAGMENT = `#version 300 es
precision highp float;
in vec3 world, facing, inFrame;
in vec4 lit;
uniform vec3 colour, eye, sun;
uniform float alpha, lined;
out vec4 painted;
${SHADOW}
float lines() {
  // Where x, y or z is 0 in the frame of the body: they show how it turns.
  vec3 slope = max(fwidth(inFrame), 1e-9);
  vec3 near = abs(inFrame) / slope;
  vec3 on = (1.0 - smoothstep(0.8, 1.9, near)) * step(slope * 0.15, vec3(length(slope)) * 0.5);
  return max(on.x, max(on.y, on.z));
}
void main() {
  vec3 n = normalize(facing), towards = normalize(eye - world);
  if (dot(n, towards) < 0.0) n = -n;
  float key = max(dot(n, sun), 0.0);
  key *= shadow(lit);
  float shine = pow(max(dot(n, normalize(sun + towards)), 0.0), 50.0) * step(0.001, key);
  float sky = 0.5 + 0.5 * n.z;
  float edge = pow(1.0 - max(dot(n, towards), 0.0), 3.0);
  float strength = 0.46 + 0.17 * sky + 0.07 * dot(n, towards) + 0.40 * key;
  vec3 out_ = colour * strength + 0.10 * shine + 0.06 * edge;
  out_ = mix(out_, out_ * 0.42, lined * lines());
  float a = alpha < 1.0 ? mix(alpha, 1.0, 0.55 * edge) : 1.0;
  painted = vec4(min(out_, 1.0) * a, a);
}`;

const GROUND_FRAGMENT = `#version 300 es
precision highp float;
in vec3 world, facing, inFrame;
in vec4 lit;
uniform vec3 colour, back, centre;
uniform float fade, cell;
out vec4 painted;
${SHADOW}
void main() {
  vec2 at = world.xy / cell, width = fwidth(at);
  vec2 grid = abs(fract(at - 0.5) - 0.5) / width;
  float line = (1.0 - min(min(grid.x, grid.y), 1.0)) * 0.5;
  float far = clamp(1.7 - length(world.xy - centre.xy) / fade, 0.0, 1.0);
  vec3 c = mix(colour, colour * 0.90, line);
  c *= mix(0.80, 1.0, shadow(lit));
  painted = vec4(mix(back, c, far * far * (3.0 - 2.0 * far)), 1.0);
}`;

const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 from;
layout(location = 1) in vec3 to;
layout(location = 2) in vec2 corner;
layout(location = 3) in float when;
uniform mat4 view, pose;
uniform vec2 size;
uniform float width;
out float moment, across;
void main() {
  vec4 a = view * pose * vec4(from, 1.0), b = view * pose * vec4(to, 1.0);
  vec2 along = (b.xy / b.w - a.xy / a.w) * size;
  along = length(along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
  vec4 p = corner.x < 0.5 ? a : b;
  p.xy += (vec2(-along.y, along.x) * corner.y + along * (corner.x - 0.5) * 0.6) * width / size * p.w;
  p.z -= 2e-5 * p.w;
  gl_Position = p;
  moment = when;
  across = corner.y;
}`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in float moment, across;
uniform vec4 colour;
uniform float now, later;
out vec4 painted;
void main() {
  float a = colour.a * (moment > now ? later : 1.0) * (1.0 - smoothstep(0.75, 1.0, abs(across)));
  painted = vec4(colour.rgb * a, a);
}`;

const DEPTH_FRAGMENT = `#version 300 es
precision highp float;
void main() {}`;

const SHADOW_SIZE = 2048;

class Painter {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.canvas = canvas;
    const told = gl.getExtension("WEBGL_debug_renderer_info");
    /** Whether a processor draws: then what moves is drawn roughly. */
    this.slow = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(told ? gl.getParameter(told.UNMASKED_RENDERER_WEBGL) : "");
    this.solid = this.program(SOLID_VERTEX, SOLID_FRAGMENT);
    this.ground = this.program(SOLID_VERTEX, GROUND_FRAGMENT);
    this.depth = this.program(SOLID_VERTEX, DEPTH_FRAGMENT);
    this.line = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.shadows = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadows);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE);
    for (const [name, value] of [
      [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    this.target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.shadows, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  program(vertex, fragment) {
    const gl = this.gl, made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    const at = {};
    for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(made, i);
      at[name] = gl.getUniformLocation(made, name);
    }
    return { made, at };
  }

  use({ made, at }, values) {
    const gl = this.gl;
    gl.useProgram(made);
    this.set(at, values);
  }

  set(at, values) {
    const gl = this.gl;
    for (const [name, value] of Object.entries(values)) {
      if (at[name] === undefined) continue;
      if (value.length === 16) gl.uniformMatrix4fv(at[name], false, value);
      else if (value.length) gl[`uniform${value.length}fv`](at[name], value);
      else gl.uniform1f(at[name], value);
    }
  }

  /** Buffers of a mesh. */
  mesh({ points, normals, faces }) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [this.attribute(0, points, 3), this.attribute(1, normals, 3), gl.createBuffer()];
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[2]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { array, count: faces.length, buffers };
  }

  /** Buffers of polylines, each a list of points [x, y, z, time]. */
  strokes(polylines) {
    const from = [], to = [], corner = [], when = [];
    for (const points of polylines)
      for (let i = 0; i + 1 < points.length; i++)
        for (const [end, side] of [[0, -1], [1, -1], [1, 1], [0, -1], [1, 1], [0, 1]]) {
          from.push(...points[i].slice(0, 3));
          to.push(...points[i + 1].slice(0, 3));
          corner.push(end, side);
          when.push(points[i + end][3] ?? 0);
        }
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [[from, 3], [to, 3], [corner, 2], [when, 1]].map(([values, size], i) => this.attribute(i, values, size));
    gl.bindVertexArray(null);
    return { array, count: when.length, buffers };
  }

  /** Free what `mesh` or `strokes` made. */
  forget({ array, buffers }) {
    buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
    this.gl.deleteVertexArray(array);
  }

  attribute(place, values, size) {
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
    return buffer;
  }

  /**
   * Draw a picture: {eye, view, sun, light, back, grounds, solids, ghosts, strokes, marks, tops}. solids, ghosts, marks and
   * tops are {mesh, pose, local, scale, colour, alpha, lined}; marks and tops lie over everything else. rough: without shadows.
   */
  draw(picture, rough = false) {
    const gl = this.gl, common = { eye: picture.eye, sun: picture.sun, light: picture.light };
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    if (!rough) this.cast(picture);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...picture.back, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.bindTexture(gl.TEXTURE_2D, this.shadows);
    gl.enable(gl.CULL_FACE);
    const plain = rough ? 1 : 0;
    this.use(this.ground, { ...common, plain, view: picture.view, back: picture.back, ...picture.ground });
    this.solids(this.ground, picture.grounds);
    gl.disable(gl.CULL_FACE);
    this.use(this.solid, { ...common, view: picture.view, alpha: 1, plain });
    this.solids(this.solid, picture.solids.filter((each) => !each.front));
    // A tip is what touches: it is before what else is in the same place.
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(-1, -20);
    this.solids(this.solid, picture.solids.filter((each) => each.front));
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.lines(picture, picture.strokes);
    // A little behind what is solid in the same place.
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 4);
    for (const group of picture.ghosts) {
      // Only what is nearest of a ghost is blended: its depth comes first.
      gl.colorMask(false, false, false, false);
      this.use(this.depth, { view: picture.view });
      this.solids(this.depth, group);
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.LEQUAL);
      this.use(this.solid, { ...common, view: picture.view, plain: 1 });
      this.solids(this.solid, group);
      gl.depthFunc(gl.LESS);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.use(this.solid, { ...common, view: picture.view, alpha: 1, plain: 1 });
    this.solids(this.solid, picture.marks);
    this.lines(picture, picture.tops);
    gl.bindVertexArray(null);
  }

  /** The depths that the light sees. */
  cast(picture) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(2, 4);
    this.use(this.depth, { view: picture.light });
    this.solids(this.depth, picture.solids);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  solids(program, list) {
    const gl = this.gl;
    for (const each of list) {
      this.set(program.at, {
        pose: each.pose, local: each.local ?? UNMOVED, scale: each.scale ?? ONES, colour: each.colour, lined: each.lined ?? 0,
        ...(each.alpha !== undefined && { alpha: each.alpha }),
      });
      gl.bindVertexArray(each.mesh.array);
      gl.drawElements(gl.TRIANGLES, each.mesh.count, gl.UNSIGNED_INT, 0);
    }
  }

  lines(picture, list) {
    const gl = this.gl;
    this.use(this.line, { view: picture.view, size: [this.canvas.width, this.canvas.height] });
    for (const each of list) {
      this.set(this.line.at, {
        pose: each.pose ?? UNMOVED, width: each.width, colour: [...each.colour, each.alpha ?? 1],
        now: each.now ?? 1e30, later: each.later ?? 1,
      });
      gl.bindVertexArray(each.strokes.array);
      gl.drawArrays(gl.TRIANGLES, 0, each.strokes.count);
    }
  }
}

const UNMOVED = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const ONES = [1, 1, 1];
