// The machine on the front page: the exported C solves each pose, WebGL draws the solids of the description.
// Vectors are in {B} [m]; matrices are stored column by column, as WebGL has them, but for those given to the C.

const root = document.getElementById("live");
const data = JSON.parse(document.getElementById("live-data").textContent);
const find = (selector) => root.querySelector(selector);

const LEGS = ["r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3"];
const BRANCHES = ["TT+", "TT-", "TF+", "TF-", "FT+", "FT-", "FF+", "FF-"];
const [LEAST, MOST] = data.limits;
// Name, unit, least, most and step of each slider, and the digits shown.
const POSE = [
  ["x", "m", -1.1, 1.1, 0.001, 3], ["y", "m", -1.1, 1.1, 0.001, 3], ["z", "m", 1.8, 3, 0.001, 3],
  ["roll", "°", -60, 60, 0.1, 1], ["pitch", "°", -60, 60, 0.1, 1], ["yaw", "°", -25, 25, 0.1, 1],
];
const DRIVES = { pose: POSE, legs: LEGS.map((leg, k) => [leg, "m", LEAST[k], MOST[k], 0.001, 3]) };
// Of the picture, from its points to what is around them.
const MARGIN = 0.22;
const EXAMPLES = {
  "eight branches": [0.11, 0.45, 2.45, -20, 5, 0],
  "paper’s pose": [0.6889, 0.4963, 2.253, -26.0188, 32.2799, -7.1058],
  level: [0, 0, 2.2, 0, 0, 0],
  "out of reach": [0.4, 0.2, 2.3, 10, 15, 12],
};

// Kinematics in the exported C

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

async function loadKinematics() {
  const { atan2, cos, sin } = Math, env = { atan2, cos, sin };
  const { exports: c } = (await WebAssembly.instantiate(await unpacked(data.module), { env })).instance;
  const numbers = (at, count) => new Float64Array(c.memory.buffer, at, count);
  const machine = c.spm_machine.value;
  // Arguments, an spm_state and an spm_branches, one after the other above what the C uses itself.
  const given = c.__heap_base.value, state = given + 96, branches = state + 216;
  const argument = numbers(given, 12), single = numbers(state, 27), all = numbers(branches, 120);
  const real = new Int32Array(c.memory.buffer, branches + 992, 8);
  const rows = (from, size) => BRANCHES.map((_, k) => Array.from(all.subarray(from + size * k, from + size * (k + 1))));
  const physical = (rotation, position) => {
    argument.set(rotation);
    argument.set(position, 9);
    return c.spm_inverse(machine, given, given + 72, 0, state) === 0;
  };
  const inverse = () => c.spm_all_branches(machine, given, given + 72, branches);
  const within = () => single.subarray(21).every((length, k) => length >= LEAST[k] && length <= MOST[k]);
  return {
    // 2 where a pose has a physical branch, 1 where its legs are too short or too long for it, 0 elsewhere.
    reach: (rotation, position) => (physical(rotation, position) ? 1 + within() : 0),
    // All branches of a pose; `physical` is the physical one, -1 if there is none. Of two it is the
    // one of known leg lengths.
    inverse(rotation, position, known = null) {
      const exists = physical(rotation, position), lengths = known || Array.from(single.subarray(21));
      const status = inverse();
      const found = { status, real: Array.from(real, Boolean), joints: rows(0, 9), lengths: rows(72, 6), physical: -1 };
      const gap = (k) => (found.real[k] ? Math.hypot(...minus(found.lengths[k], lengths)) : Infinity);
      if (exists) found.physical = BRANCHES.reduce((best, _, k) => (gap(k) < gap(best) ? k : best), 0);
      return found;
    },
    // The state that six leg lengths hold, null where they hold none.
    forward(legs) {
      argument.set(legs);
      if (c.spm_forward(machine, given, 0, state) !== 0) return null;
      const part = (...ends) => Array.from(single.subarray(...ends));
      return { rotation: part(0, 9), position: part(9, 12), joints: part(12, 21), lengths: part(21) };
    },
    // Microseconds that all branches of a pose take.
    time(rotation, position) {
      physical(rotation, position);
      const start = performance.now();
      let count = 0;
      for (; performance.now() < start + 20; count += 500) for (let k = 0; k < 500; ++k) inverse();
      return (1e3 * (performance.now() - start)) / count;
    },
  };
}

const radians = (degrees) => (degrees * Math.PI) / 180;

const rounded = (x) => Math.round(1e4 * x) / 1e4;

// R, row by row, about the fixed axes X, Y and Z of {B}.
function rotationOf([, , , roll, pitch, yaw]) {
  const [c1, c2, c3] = [roll, pitch, yaw].map((angle) => Math.cos(radians(angle)));
  const [s1, s2, s3] = [roll, pitch, yaw].map((angle) => Math.sin(radians(angle)));
  return [
    c3 * c2, c3 * s2 * s1 - s3 * c1, c3 * s2 * c1 + s3 * s1,
    s3 * c2, s3 * s2 * s1 + c3 * c1, s3 * s2 * c1 - c3 * s1,
    -s2, c2 * s1, c2 * c1,
  ];
}

function poseOf({ rotation: r, position }) {
  const angles = [Math.atan2(r[7], r[8]), -Math.asin(r[6]), Math.atan2(r[3], r[0])];
  return [...position, ...angles.map((angle) => (angle * 180) / Math.PI)].map(rounded);
}

// Where the bodies and their solids are

const minus = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const frame = (x, y, z, origin) => [...x, 0, ...y, 0, ...z, 0, ...origin, 1];

function product(a, b) {
  const c = new Float32Array(16);
  for (let k = 0; k < 16; ++k) for (let i = 0; i < 4; ++i) c[k] += a[(k % 4) + 4 * i] * b[k - (k % 4) + i];
  return c;
}

// The poses of the bodies by their names, the legs, and points that the picture must show. The pose may be missing, and
// so may the joints b_1, b_2, b_3, nine numbers.
function bodiesOf(held, joints) {
  const poses = { base: frame([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]) }, legs = [];
  if (!held) return { poses, legs, points: [...data.hips.slice(0, 3), [0, 0, 2]] };
  const { rotation: r, position } = held;
  const turned = (v) => [0, 3, 6].map((k) => dot(r.slice(k, k + 3), v));
  const hips = data.hips.map((hip, k) => (k < 3 ? hip : turned(hip).map((x, i) => x + position[i])));
  poses.terminal_platform = frame(...[0, 1, 2].map((k) => [r[k], r[k + 3], r[k + 6]]), position);
  if (!joints) return { poses, legs, points: hips };
  const b = [0, 3, 6].map((k) => joints.slice(k, k + 3));
  const x = unit(minus(b[0], b[2])), across = minus(b[1], b[2]);
  const y = unit(across.map((value, i) => value - dot(x, across) * x[i]));
  poses.middle_platform = frame(x, y, cross(x, y), [0, 1, 2].map((i) => (b[0][i] + b[1][i] + b[2][i]) / 3));
  LEGS.forEach((leg, k) => {
    const hip = hips[k], ball = b[k % 3], z = unit(minus(ball, hip));
    const y = unit(cross(z, k < 3 ? data.axes[k] : turned(data.axes[k]))), x = cross(y, z);
    poses[`leg_${leg.slice(2)}_cylinder`] = frame(x, y, z, hip);
    poses[`leg_${leg.slice(2)}_rod`] = frame(x, y, z, ball);
    legs.push({ hip, ball, length: Math.hypot(...minus(ball, hip)) });
  });
  return { poses, legs, points: [...hips, ...b] };
}

const parts = data.parts.map(([body, mesh, first, count, red, green, blue, ...m]) => ({
  body: data.bodies[body], mesh, first, count, colour: [red, green, blue],
  matrix: frame(m.slice(0, 3), m.slice(3, 6), m.slice(6, 9), m.slice(9)),
}));
const tubes = {};
parts.forEach(({ body, mesh, matrix }) => mesh === "tube" && (tubes[body] = Math.hypot(...matrix.slice(8, 11))));

// A pose with its third axis `share` times as long, and moved by `offset` along it.
const along = (pose, share, offset) =>
  pose.map((x, k) => (k < 8 || k === 15 ? x : k < 12 ? share * x : x + offset * pose[k - 4]));

// The matrices of the solids; a barrel is shorter where its leg has no room for it, a rod reaches from it to its ball.
function placements({ poses, legs }) {
  return parts.map(({ body, mesh, matrix }) => {
    if (!poses[body]) return null;
    const [kind, leg, half] = body.split("_");
    if (kind !== "leg" || !["tube", "gland"].includes(mesh)) return product(poses[body], matrix);
    const { length } = legs[LEGS.indexOf(`r_${leg}`)], barrel = tubes[`leg_${leg}_cylinder`];
    const shown = Math.min(barrel, Math.max(length - 0.4 * data.size, 0.5 * length));
    const share = half === "rod" ? (length - 0.5 * shown) / tubes[body] : shown / barrel;
    return product(mesh === "tube" ? along(poses[body], share, 0) : along(poses[body], 1, shown - barrel), matrix);
  });
}

// The picture: solids with their numbers into textures, then dark edges where the numbers change, as in spm-pin draw

const SOLIDS = [`#version 300 es
  layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal; layout(location = 2) in float region;
  uniform mat4 model; uniform mat3 camera; uniform vec2 centre; uniform vec3 scale; uniform float part;
  out vec3 facing; flat out vec2 number;
  void main() {
    gl_Position = vec4(scale * (camera * (model * vec4(position, 1.0)).xyz - vec3(centre, 0.0)), 1.0);
    facing = camera * (inverse(transpose(mat3(model))) * normal);
    number = vec2(part, region) / 255.0;
  }`, `#version 300 es
  precision highp float;
  in vec3 facing; flat in vec2 number; uniform vec3 colour;
  layout(location = 0) out vec4 shade; layout(location = 1) out vec4 mark;
  void main() {
    vec3 n = normalize(facing);
    float light = 0.44 + 0.1 * n.y + 0.5 * max(dot(n, normalize(vec3(-0.35, 0.5, 0.8))), 0.0);
    shade = vec4(colour * pow(light, 1.0 / 2.2), 1.0);
    mark = vec4(number, 0.0, 1.0);
  }`];
const EDGES = [`#version 300 es
  void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`,
`#version 300 es
  precision highp float;
  uniform sampler2D shades, marks; uniform highp sampler2D depths; uniform int samples, width; out vec4 colour;
  void main() {
    vec4 sum = vec4(0.0);
    ivec2 last = textureSize(marks, 0) - 1;
    for (int s = 0; s < samples * samples; ++s) {
      ivec2 at = ivec2(gl_FragCoord.xy) * samples + ivec2(s % samples, s / samples);
      vec4 mark = texelFetch(marks, at, 0);
      float depth = texelFetch(depths, at, 0).r, light = 1.0;
      for (int k = 0; k < 4 * width; ++k) {
        int away = (k / 4 + 1) * (k % 2 == 0 ? 1 : -1);
        ivec2 beside = clamp(at + (k % 4 < 2 ? ivec2(away, 0) : ivec2(0, away)), ivec2(0), last);
        if (texelFetch(marks, beside, 0) != mark && depth <= texelFetch(depths, beside, 0).r) light = 0.4;
      }
      sum += mark.a * vec4(light * texelFetch(shades, at, 0).rgb, 1.0);
    }
    colour = sum / float(samples * samples);
  }`];

function startDrawing(canvas, meshes) {
  const gl = canvas.getContext("webgl2", { antialias: false, depth: false });
  if (!gl) throw new Error("no WebGL 2");
  const program = (sources) => {
    const made = gl.createProgram();
    sources.forEach((source, k) => {
      const shader = gl.createShader(k ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    });
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "shaders");
    return made;
  };
  const solids = program(SOLIDS), edges = program(EDGES);
  const uniforms = (made, names) => Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(made, name)]));
  const solid = uniforms(solids, ["model", "camera", "centre", "scale", "part", "colour"]);
  const edge = uniforms(edges, ["shades", "marks", "depths", "samples", "width"]);
  const count = new Uint32Array(meshes, 0, 1)[0], empty = gl.createVertexArray(), full = gl.createVertexArray();
  gl.bindVertexArray(full);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Uint8Array(meshes, 4, 10 * count), gl.STATIC_DRAW);
  gl.vertexAttribPointer(0, 3, gl.SHORT, true, 10, 0);
  gl.vertexAttribPointer(1, 3, gl.BYTE, true, 10, 6);
  gl.vertexAttribPointer(2, 1, gl.UNSIGNED_BYTE, false, 10, 9);
  [0, 1, 2].forEach((place) => gl.enableVertexAttribArray(place));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint8Array(meshes, 4 + 10 * count), gl.STATIC_DRAW);
  const target = gl.createFramebuffer(), textures = [0, 1, 2].map(() => gl.createTexture());
  let samples = 0;

  function resize() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(1, Math.round(x * ratio)));
    if (samples && canvas.width === width && canvas.height === height) return;
    Object.assign(canvas, { width, height });
    samples = width > 1000 ? 1 : 2;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    const places = [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1, gl.DEPTH_ATTACHMENT];
    [gl.RGBA8, gl.RGBA8, gl.DEPTH_COMPONENT24].forEach((kind, k) => {
      gl.deleteTexture(textures[k]);
      textures[k] = gl.createTexture();
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, textures[k]);
      gl.texStorage2D(gl.TEXTURE_2D, 1, kind, samples * canvas.width, samples * canvas.height);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, places[k], gl.TEXTURE_2D, textures[k], 0);
    });
    gl.drawBuffers(places.slice(0, 2));
  }

  // `camera` are the unit vectors to the right, up and towards the reader; `centre` is in the picture's middle, and
  // `half` its height upwards from there.
  return (matrices, camera, centre, half) => {
    resize();
    const aspect = canvas.width / canvas.height;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, samples * canvas.width, samples * canvas.height);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(solids);
    gl.bindVertexArray(full);
    gl.uniformMatrix3fv(solid.camera, true, camera.flat());
    gl.uniform2fv(solid.centre, centre);
    gl.uniform3f(solid.scale, 1 / (half * aspect), 1 / half, -1 / 10);
    matrices.forEach((matrix, k) => {
      if (!matrix) return;
      gl.uniformMatrix4fv(solid.model, false, matrix);
      gl.uniform3fv(solid.colour, parts[k].colour);
      gl.uniform1f(solid.part, k + 1);
      gl.drawElements(gl.TRIANGLES, parts[k].count, gl.UNSIGNED_SHORT, 2 * parts[k].first);
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.DEPTH_TEST);
    gl.useProgram(edges);
    gl.bindVertexArray(empty);
    ["shades", "marks", "depths"].forEach((name, k) => gl.uniform1i(edge[name], k));
    gl.uniform1i(edge.samples, samples);
    gl.uniform1i(edge.width, Math.max(1, Math.round(0.6 * samples * (window.devicePixelRatio || 1))));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };
}

// The page

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
  made.append(...children);
  return made;
}

const fixed = (x, digits) => x.toFixed(digits).replace("-", "−").replace(/^−([0.]*)$/, "$1");

// The status in short, and why there is no branch to choose. `state` is the one of known leg lengths.
function words(found, state) {
  if (!found) return ["Out of reach", "The machine cannot be assembled with these leg lengths."];
  const count = found.real.filter(Boolean).length;
  if (found.status === 2) {
    const beside = count ? `, with ${count} isolated ${count > 1 ? "branches" : "branch"} beside it` : "";
    const more = state ? "Drawn is the one of these leg lengths." : "Change the tilt, or set leg lengths.";
    return [`Degenerate${beside}`, `This pose leaves the legs undetermined: branches are not isolated. ${more}`];
  }
  if (found.status !== 0) return ["Out of reach", "None of the eight branches of this pose is real."];
  return [`${count} of 8 branches are real${found.physical < 0 ? ", none of them physical" : ""}`, ""];
}

function named(leg) {
  const [letter, index] = leg.split("_");
  return index ? [letter, element("sub", {}, index)] : [letter];
}

function start(kinematics, meshes) {
  const values = { pose: [...Object.values(EXAMPLES)[0]], legs: [] };
  const view = { azimuth: 15, elevation: 25, box: null };
  const canvas = find("canvas"), handle = find(".live-handle"), still = matchMedia("(prefers-reduced-motion: reduce)");
  // `wanted` is the branch chosen, `grabbed` are the leg lengths that a drag of the platform led to, `grip` is where it
  // began: the pointer's place and the leg lengths.
  let drive = "pose", wanted = -1, grabbed = null, grip = null, shown = null, waiting = false;
  let draw = startDrawing(canvas, meshes);

  // Sliders

  function slider([name, unit, min, max, step], k) {
    const input = element("input", { type: "range", min, max, step, "aria-label": `${name} [${unit}]` });
    const track = element("i"), output = element("output");
    input.addEventListener("input", () => {
      values[drive][k] = input.valueAsNumber;
      if (drive === "legs") wanted = -1;
      grabbed = null;
      update();
    });
    const rail = element("span", { class: "live-track" }, track, input);
    return { row: element("label", {}, element("span", {}, ...named(name)), rail, output), input, track, output };
  }
  const sliders = Object.fromEntries(Object.entries(DRIVES).map(([name, rows]) => [name, rows.map(slider)]));

  function setDrive(name) {
    drive = name;
    wanted = -1;
    grabbed = null;
    find(`input[value=${name}]`).checked = true;
    find(".live-sliders").replaceChildren(...sliders[name].map(({ row }) => row));
    update();
  }

  function reach(row) {
    if (drive === "legs") return kinematics.forward(row) ? 2 : 0;
    return kinematics.reach(rotationOf(row), row.slice(0, 3));
  }

  function showSliders() {
    DRIVES[drive].forEach(([, unit, least, most, , digits], k) => {
      const { input, track, output } = sliders[drive][k];
      const text = fixed(values[drive][k], digits) + (unit === "°" ? unit : ` ${unit}`);
      input.value = values[drive][k];
      input.setAttribute("aria-valuetext", text);
      output.textContent = text;
      // What the physical mode reaches, all other sliders being where they are.
      const row = [...values[drive]], count = 160, stops = [];
      for (let n = 0; n < count; ++n) {
        row[k] = least + ((n + 0.5) / count) * (most - least);
        stops.push(`var(--live-reach-${reach(row)}) ${(100 * n) / count}% ${(100 * (n + 1)) / count}%`);
      }
      track.style.backgroundImage = `linear-gradient(to right, ${stops.join()})`;
    });
  }

  // Branches and leg lengths

  const chips = BRANCHES.map((name, k) => {
    const input = element("input", { type: "radio", name: "live-branch", value: name }), note = element("small");
    input.addEventListener("change", () => { wanted = k; update(); });
    const text = element("span", {}, element("b", {}, name.replace("-", "−")), note);
    find(".live-branches").append(element("label", {}, input, text));
    return { input, note };
  });
  const rows = LEGS.map((leg, k) => {
    const bar = element("i"), number = element("data"), note = element("small");
    const heading = element("th", { scope: "row" }, ...named(leg));
    const row = element("tr", { class: k > 2 ? "live-upper" : "live-lower" }, heading);
    const rail = element("span", { class: "live-bar" }, bar);
    row.append(...[rail, number, note].map((content) => element("td", {}, content)));
    find("tbody").append(row);
    return { bar, number, note };
  });

  function showLegs(lengths) {
    rows.forEach(({ bar, number, note }, k) => {
      const share = (lengths[k] - LEAST[k]) / (MOST[k] - LEAST[k]);
      number.value = lengths[k];
      number.textContent = fixed(lengths[k], 4);
      note.textContent = share < -1e-9 ? "too short" : share > 1 + 1e-9 ? "too long" : "";
      // The bar is a tenth longer than the limits on either side, so that a leg beyond them is seen to be.
      bar.style.width = `${Math.min(Math.max(10 + 80 * share, 0), 100)}%`;
      bar.className = note.textContent && "live-beyond";
    });
  }

  function showPython() {
    const list = (numbers) => `[${numbers.join(", ")}]`, lines = ["import spm_pin as spm"];
    if (drive === "pose") {
      lines.push("from scipy.spatial.transform import Rotation", "");
      lines.push(`turned = Rotation.from_euler("xyz", ${list(values.pose.slice(3))}, degrees=True)`);
      lines.push(`pose = spm.pose(${list(values.pose.slice(0, 3))}, rotation=turned)`);
    } else {
      lines.push("", `pose = spm.forward_physical(spm.Manipulator.paper(), ${list(values.legs)}).pose`);
    }
    find("pre").textContent = [...lines, "branches = spm.inverse_displacement(spm.Manipulator.paper(), pose)"].join("\n");
  }

  function update() {
    const { pose, legs } = values;
    const known = drive === "legs" ? legs : grabbed, forward = known && kinematics.forward(known);
    const held = drive === "legs" ? forward : { rotation: rotationOf(pose), position: pose.slice(0, 3) };
    const found = held && kinematics.inverse(held.rotation, held.position, known);
    // Leg lengths have a state at a level pose as well, where no branch is isolated.
    const state = drive === "legs" || found.status === 2 ? forward : null;
    const isReal = (k) => Boolean(found && found.real[k]);
    const first = !found ? -1 : state || found.physical >= 0 ? found.physical : found.real.indexOf(true);
    const branch = isReal(wanted) ? wanted : first;
    const chosen = branch < 0 ? null : { joints: found.joints[branch], lengths: found.lengths[branch] };
    const drawn = state && branch === found.physical ? state : chosen;
    const physical = state ? state.lengths : found && found.physical >= 0 ? found.lengths[found.physical] : null;
    // What the other sliders start from.
    if (state) values.pose = poseOf(state);
    else if (physical) values.legs = physical.map((x, k) => Math.min(Math.max(rounded(x), LEAST[k]), MOST[k]));
    const absent = found && found.status === 2 ? "not isolated" : "not real";
    chips.forEach(({ input, note }, k) => {
      input.disabled = !isReal(k);
      input.checked = k === branch;
      note.textContent = isReal(k) ? (k === found.physical ? "physical" : "real") : absent;
    });
    const [status, reason] = words(found, state);
    find(".live-status").textContent = status;
    find(".live-reason").textContent = branch < 0 ? reason : "";
    find("table").hidden = !drawn;
    find("caption b").textContent = branch < 0 ? "this state" : BRANCHES[branch].replace("-", "−");
    if (drawn) showLegs(drawn.lengths);
    showSliders();
    showPython();
    shown = { ...bodiesOf(held, drawn && drawn.joints), physical };
    redraw();
  }

  // The picture

  const labels = [...LEGS, "X", "Y", "Z", "x", "y", "z"].map((name, k) => {
    const kind = k < 3 ? "live-lower" : k < 6 ? "live-upper" : "live-axis";
    return find(".live-labels").appendChild(element("span", { class: kind }, ...named(name)));
  });

  function redraw() {
    if (!waiting) requestAnimationFrame(picture);
    waiting = true;
  }

  function picture() {
    waiting = false;
    const a = radians(view.azimuth), e = radians(view.elevation);
    const near = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0], up = cross(near, right);
    const inView = (point) => [dot(right, point), dot(up, point)];

    // The machine fills the picture. While a slider is dragged or the view turned the picture may only widen, while the
    // platform is dragged it stays.
    const [u, v] = [0, 1].map((k) => shown.points.map((point) => inView(point)[k]));
    const target = [-Math.min(...u), -Math.min(...v), Math.max(...u), Math.max(...v)].map((x) => x + MARGIN);
    const dragged = root.matches(":active"), last = view.box || target;
    const wider = () => target.map((x, k) => Math.max(x, last[k]));
    const goal = handle.matches(":active") ? last : dragged ? wider() : target;
    const share = still.matches || dragged ? 1 : 0.2;
    view.box = last.map((x, k) => x + share * (goal[k] - x));
    if (view.box.some((x, k) => Math.abs(x - goal[k]) > 1e-3)) redraw();
    const [left, bottom, far, top] = view.box;
    const centre = [(far - left) / 2, (top - bottom) / 2];
    const half = Math.max((top + bottom) / 2, ((far + left) / 2) * (canvas.clientHeight / canvas.clientWidth));
    draw(placements(shown), [right, up, near], centre, half);

    const scale = (0.5 * canvas.clientHeight) / half;
    const place = (item, [x, y]) => {
      const across = 0.5 * canvas.clientWidth + scale * (x - centre[0]);
      const down = 0.5 * canvas.clientHeight - scale * (y - centre[1]);
      item.style.transform = `translate(${across}px, ${down}px)`;
    };
    view.shown = { right, up, centre, scale };
    handle.hidden = !shown.physical && !handle.matches(":active");
    if (shown.physical) place(handle, inView([12, 13, 14].map((i) => shown.poses.terminal_platform[i])));
    const middles = shown.legs.map(({ hip, ball }) => inView(hip.map((x, i) => 0.45 * x + 0.55 * ball[i])));
    labels.forEach((label, k) => {
      let [x, y] = [0, 0];
      if (k < 6 && middles.length) {
        // On the side away from the nearest leg of the stage.
        [x, y] = middles[k];
        const others = [1, 2].map((step) => middles[k - (k % 3) + ((k + step) % 3)][0] - x);
        x += (Math.abs(others[0]) < Math.abs(others[1]) ? others[0] : others[1]) > 0 ? -22 / scale : 22 / scale;
      } else if (k > 5) {
        const pose = shown.poses[k < 9 ? "base" : "terminal_platform"];
        if (pose) [x, y] = inView([12, 13, 14].map((i) => pose[i] + 1.2 * data.triad * pose[i - 12 + 4 * (k % 3)]));
        label.hidden = !pose;
      }
      if (k < 6) label.hidden = !middles.length;
      place(label, [x, y]);
    });
  }

  // The platform follows the pointer: of all leg lengths within the limits that bring o below it those nearest to where
  // the drag began, found from there, so that the way back ends there.
  function drag(event) {
    const { right, up, scale } = view.shown, { x, y, from } = grip, slack = 1e-3;
    const seen = ({ position }) => [dot(right, position), dot(up, position)];
    const goal = minus(seen(kinematics.forward(from)), [(x - event.clientX) / scale, (event.clientY - y) / scale]);
    const bounded = (length, k) => Math.min(Math.max(length, Math.min(LEAST[k], from[k])), Math.max(MOST[k], from[k]));
    const tried = (legs) => {
      const held = kinematics.forward(legs);
      if (!held) return { cost: Infinity };
      const now = seen(held), gap = minus(goal, now), away = minus(legs, from);
      return { legs, held, now, gap, away, cost: Math.hypot(...gap) ** 2 + slack * Math.hypot(...away) ** 2 };
    };
    let best = tried(from), last = Infinity;
    // Steps of Gauss and Newton, short ones where o is far from the pointer.
    for (let round = 0; round < 60 && best.cost < last - 1e-12; ++round) {
      const { legs, now, gap, away } = best, share = Math.min(1, 0.15 / Math.hypot(...gap));
      const rates = legs.map((_, k) => {
        const moved = kinematics.forward(legs.map((length, i) => (i === k ? length + 1e-6 : length)));
        return moved ? minus(seen(moved), now).map((rate) => 1e6 * rate) : [0, 0];
      });
      const sum = (term) => rates.reduce((total, rate, k) => total + term(rate, k), 0);
      let next = legs, pull = [0, 0], rest = gap;
      // Legs that would pass a limit end there, and the others do what they can. Those at a limit count a little in the
      // step of `pull`, without which it would jump to and fro.
      for (let pass = 0; pass < 60 && Math.hypot(...rest) > 1e-10; ++pass) {
        const asked = from.map((length, k) => length + rates[k][0] * pull[0] + rates[k][1] * pull[1]);
        next = asked.map(bounded);
        rest = [0, 1].map((i) =>
          share * gap[i] - slack * pull[i] + sum((rate, k) => rate[i] * (away[k] + from[k] - next[k])));
        const of = (i, j) => sum((rate, k) => (next[k] === asked[k] ? 1 : 0.03) * rate[i] * rate[j]);
        const p = of(0, 0) + slack, q = of(0, 1), r = of(1, 1) + slack;
        pull = [r * rest[0] - q * rest[1], p * rest[1] - q * rest[0]].map((x, i) => pull[i] + x / (p * r - q * q));
      }
      last = best.cost;
      for (let step = 1; step > 0.01 && best.cost >= last; step /= 2) {
        const found = tried(legs.map((length, k) => length + step * (next[k] - length)));
        if (found.cost < last) best = found;
      }
    }
    grabbed = best.legs;
    values.legs = grabbed.map(rounded);
    if (drive === "pose") values.pose = poseOf(best.held);
    wanted = -1;
    update();
  }

  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    grip = { x: event.clientX, y: event.clientY, from: [...shown.physical] };
  });
  handle.addEventListener("pointermove", (event) => handle.hasPointerCapture(event.pointerId) && drag(event));

  function turn(across, upwards) {
    view.azimuth += across;
    view.elevation = Math.min(Math.max(view.elevation + upwards, -85), 85);
    redraw();
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turn(-0.4 * event.movementX, 0.4 * event.movementY);
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
    if (!step) return;
    event.preventDefault();
    turn(...step);
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { draw = startDrawing(canvas, meshes); redraw(); });
  ["pointerup", "pointercancel"].forEach((name) => addEventListener(name, () => setTimeout(redraw)));
  new ResizeObserver(redraw).observe(canvas);

  find(".live-drive").addEventListener("change", (event) => setDrive(event.target.value));
  Object.entries(EXAMPLES).forEach(([name, pose]) => {
    const button = element("button", { type: "button" }, name);
    button.addEventListener("click", () => { values.pose = [...pose]; setDrive("pose"); });
    find(".live-examples").append(button);
  });
  setDrive("pose");
  // For the browser's console, and for tests.
  root.machine = { ...kinematics, placements: () => placements(shown).map((matrix) => matrix && Array.from(matrix)) };
  find(".live-time").textContent = kinematics.time(rotationOf(values.pose), values.pose.slice(0, 3)).toPrecision(2);
}

try {
  const [kinematics, meshes] = await Promise.all([loadKinematics(), unpacked(data.meshes)]);
  start(kinematics, meshes);
} catch (error) {
  // What stands below takes its place: the front page's picture, or a line that says what is needed.
  root.hidden = true;
  console.warn(`The machine is not shown live: ${error.message}`);
}
