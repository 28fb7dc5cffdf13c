// Your ball balancer: a stage drawn from a few numbers, solved by the header that the page offers.
// Lengths are in metres and angles in radians, but for what is entered and shown.

const root = document.getElementById("balancer");
const data = JSON.parse(document.getElementById("balancer-data").textContent);
const find = (selector) => root.querySelector(selector);

const RADIAL = [[Math.sqrt(0.75), -0.5, 0], [0, 1, 0], [-Math.sqrt(0.75), -0.5, 0]];
const DEGREE = Math.PI / 180;
// Of each kind: its name, the unit of its readings, factor and digits to show them, and of its numbers, in mm or
// degrees, the names and first values.
const KINDS = [
  ["RPS", "cylinders", "mm", 1e3, 2, ["base radius", 150], ["plate radius", 120], ["shortest", 170], ["longest", 260]],
  ["PRS", "screws", "mm", 1e3, 2, ["base radius", 120], ["plate radius", 90], ["rod", 150], ["slide angle", 90]],
  ["RRS", "servos", "°", 1 / DEGREE, 2, ["base radius", 80], ["plate radius", 91], ["crank", 50], ["rod", 90],
    ["lowest angle", -90], ["highest angle", 90]],
].map(([name, label, unit, factor, digits, ...numbers]) => ({ name, label, unit, factor, digits, numbers }));
const isAngle = (name) => name.endsWith("angle");
const WORDS = { 1: "out of reach", 2: "beyond the limits of a leg", 3: "beyond a singularity, or too near", "-1": "no number" };

const minus = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const size = (a) => Math.hypot(...a);
const fixed = (x, digits) => x.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");
const normalOf = (tilt, azimuth) => {
  const s = Math.sin(tilt);
  return [s * Math.cos(azimuth), s * Math.sin(azimuth), Math.cos(tilt)];
};

// The stage

// The numbers of a stage_geometry, in the header's order.
function geometryOf(kind, values, isInside) {
  const factors = KINDS[kind].numbers.map(([name]) => (isAngle(name) ? DEGREE : 1e-3));
  const [base, plate, third, fourth, lowest, highest] = values.map((x, k) => x * factors[k]);
  const x = plate - base, rod = [0, third, fourth][kind], crank = kind === 2 ? third : 0;
  const slide = kind === 1 ? [Math.cos(fourth), Math.sin(fourth)].map((c) => (Math.abs(c) < 1e-15 ? 0 : c)) : [0, 0];
  const limits = [[third, fourth], [-Infinity, Infinity], [lowest, highest]][kind];
  // At home a cylinder has its middle length, a carriage is at its pivot, and a crank in the middle of its limits.
  const reach = kind === 0 ? (third + fourth) / 2 : rod, middle = kind === 2 ? (lowest + highest) / 2 : 0;
  const home = crank * Math.sin(middle) + Math.sqrt(reach ** 2 - (x - crank * Math.cos(middle)) ** 2);
  const sign = kind === 0 ? 0 : kind === 2 && isInside ? 1 : -1;
  const legs = RADIAL.map((out) => [
    out.map((c) => base * c), out, [0, 0, 1], out.map((c) => plate * c), crank, rod, slide, sign, 0, ...limits, middle,
  ]);
  return { kind, plate, base, crank, rod, slide, sign, limits, home, legs };
}

function headerOf({ kind, home, legs }) {
  const number = (x) => {
    if (!Number.isFinite(x)) return x < 0 ? "-STAGE_NO_LIMIT" : "STAGE_NO_LIMIT";
    return Number.isInteger(x) ? String(x) : `STAGE_R(${x})`;
  };
  const group = (x) => (Array.isArray(x) ? `{${x.map(number).join(", ")}}` : number(x));
  const rows = legs.map((leg) => {
    const [plane, rest] = [leg.slice(0, 3), leg.slice(3)].map((part) => part.map(group).join(", "));
    return `        {${plane},\n            ${rest}}`;
  });
  const text = `    STAGE_${KINDS[kind].name}, 1, ${number(home)},\n    {\n${rows.join(",\n")}\n    }`;
  return data.header.replace("@MACHINE@", () => text);
}

async function loadStage() {
  const bytes = Uint8Array.from(atob(data.module), (letter) => letter.charCodeAt(0));
  const unpacked = new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
  const { atan2, cos, sin } = Math;
  const { instance: { exports: c } } = await WebAssembly.instantiate(await unpacked.arrayBuffer(), { env: { atan2, cos, sin } });
  const numbers = (at, count) => new Float64Array(c.memory.buffer, at.value, count);
  const geometry = numbers(c.geometry, 66), asked = numbers(c.asked, 4), balls = numbers(c.balls, 9);
  const [state, other] = [c.state, c.other].map((at) => numbers(at, 15));
  const copy = (s) => {
    const part = (...ends) => Array.from(s.subarray(...ends)), position = part(9, 12);
    const placed = (ball) => position.map((x, k) => x + dot(s.subarray(3 * k, 3 * k + 3), ball));
    const own = [0, 1, 2].map((leg) => placed(geometry.subarray(12 + 21 * leg, 15 + 21 * leg)));
    return { normal: [s[2], s[5], s[8]], position, readings: part(12), balls: own };
  };
  return {
    set({ kind, home, legs }) {
      new Int32Array(c.memory.buffer, c.geometry.value, 1)[0] = kind;
      geometry.set([1, home, ...legs.flat(2)], 1);
    },
    // The state of a normal and a height, and its status.
    inverse(normal, height) {
      asked.set([...normal, height]);
      const status = c.inverse();
      return { status, ...copy(state) };
    },
    // The readings that balls would have, and the state that these hold, null where there is none.
    commanded(three) {
      balls.set(three.flat());
      if (!c.readings()) return null;
      const readings = Array.from(asked.subarray(0, 3));
      return { readings, state: c.forward() === 0 ? copy(other) : null };
    },
  };
}

// Three balls as the copied formula has them: at the plate's radius from a centre that stays, in the planes of the legs.
function copiedBalls({ plate }, normal, height) {
  return RADIAL.map((out) => {
    const down = -dot(normal, out), length = Math.hypot(normal[2], down);
    return [out[0] * normal[2], out[1] * normal[2], down].map((x, k) => (plate * x) / length + (k === 2 ? height : 0));
  });
}

// The page

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
  made.append(...children);
  return made;
}

function start(stage) {
  const values = KINDS.map(({ numbers }) => numbers.map(([, value]) => value));
  const view = { azimuth: -75 * DEGREE, elevation: 24 * DEGREE, scale: 1, right: [], near: [] };
  const svg = find("svg");
  let kind = 2, machine = null, heights = null, wanted = { tilt: 20 * DEGREE, azimuth: -20 * DEGREE, height: 0 }, shown = null;

  // Numbers, sliders and readings

  KINDS.forEach(({ name, label }, k) => {
    const input = element("input", { type: "radio", name: "balancer-kind", value: name, ...(k === kind && { checked: "" }) });
    input.addEventListener("change", () => { kind = k; showNumbers(); rebuild(); });
    find(".balancer-kinds").prepend(element("label", {}, input, element("span", {}, `${name}, ${label}`)));
  });

  function showNumbers() {
    find(".balancer-numbers").replaceChildren(...KINDS[kind].numbers.map(([name], k) => {
      const unit = isAngle(name) ? "°" : "mm";
      const input = element("input", { type: "number", step: "any", inputmode: "decimal", value: values[kind][k] });
      input.addEventListener("input", () => {
        const x = input.valueAsNumber, isLimit = kind === 2 && unit === "°";
        values[kind][k] = isLimit ? (Math.abs(x) <= 360 ? x : NaN) : unit === "°" || x > 0 ? x : NaN;
        rebuild();
      });
      return element("label", {}, element("span", {}, `${name} [${unit}]`), input);
    }));
    find(".balancer-knees").hidden = kind !== 2;
  }

  const knees = find(".balancer-knees input");
  knees.addEventListener("change", () => {
    // The same cranks, seen in a mirror.
    const [lowest, highest] = values[2].slice(4);
    values[2].splice(4, 2, 180 - highest, 180 - lowest);
    showNumbers();
    rebuild();
  });

  const sliders = Object.fromEntries([["tilt", 0, 60, 0.1], ["azimuth", -180, 180, 0.5], ["height", 0, 1, 0.1]].map(
    ([name, min, max, step]) => {
      const input = element("input", { type: "range", min, max, step, "aria-label": name }), output = element("output");
      input.addEventListener("input", () => {
        wanted[name] = input.valueAsNumber * (name === "height" ? 1e-3 : DEGREE);
        update();
      });
      find(".balancer-sliders").append(element("label", {}, element("span", {}, name), input, output));
      return [name, { input, output }];
    }));
  const rows = RADIAL.map((_, k) => {
    const cells = [0, 1, 2].map(() => element("td"));
    find("tbody").append(element("tr", {}, element("th", { scope: "row" }, String(k + 1)), ...cells));
    return cells;
  });

  function rebuild() {
    machine = geometryOf(kind, values[kind], knees.checked);
    stage.set(machine);
    const most = 1.2 * (machine.base + machine.plate + machine.crank + machine.rod + (kind ? 0 : machine.limits[1]));
    const reached = [];
    for (let k = 1; k <= 800; ++k) {
      const height = (most * k) / 800;
      if (stage.inverse([0, 0, 1], height).status === 0) reached.push(height);
    }
    // A plate below a millimetre was typed in metres.
    heights = reached.length && machine.plate > 1e-3 ? [reached[0], reached[reached.length - 1]] : null;
    if (heights) {
      const { input } = sliders.height;
      input.min = (1e3 * heights[0]).toFixed(1);
      input.max = (1e3 * heights[1]).toFixed(1);
      wanted.height = heights[0] <= machine.home && machine.home <= heights[1] ? machine.home : (heights[0] + heights[1]) / 2;
      machine.home = wanted.height;
    }
    find(".balancer-header").disabled = find(".balancer-copy").disabled = !heights;
    find(".balancer-python").textContent = pythonOf();
    update();
  }

  function pythonOf() {
    const { base, plate, crank, rod, sign, limits } = machine, m = (x) => Number(x.toPrecision(12));
    const direction = values[kind][3] === 90 ? "" : `, direction=${values[kind][3] * DEGREE}`;
    const legs = ["RPS()", `PRS(rod=${m(rod)}${direction})`, `RRS(crank=${m(crank)}, rod=${m(rod)}${sign > 0 ? ", sign=1" : ""})`][kind];
    const ends = Number.isFinite(limits[0]) ? `, limits=(${limits.join(", ")})` : "";
    const lines = ["import spm_pin as spm", "", `stage = spm.Stage(${m(base)}, ${m(plate)}, spm.${legs}${ends})`];
    return [...lines, 'spm.export.write_stage_c(stage, "board")'].join("\n");
  }

  // What the machine can do of what is wanted: at an azimuth and a height tilts from zero on.
  function reachable() {
    const { tilt, azimuth, height } = wanted, whole = stage.inverse(normalOf(tilt, azimuth), height);
    if (whole.status === 0) return { ...whole, tilt };
    let low = 0, high = tilt;
    for (let k = 0; k < 40; ++k) {
      const middle = (low + high) / 2;
      if (stage.inverse(normalOf(middle, azimuth), height).status === 0) low = middle;
      else high = middle;
    }
    return { ...stage.inverse(normalOf(low, azimuth), height), tilt: low, refused: whole.status };
  }

  function update() {
    const { unit, factor, digits } = KINDS[kind];
    shown = heights && reachable();
    const impossible = "These legs hold the plate at no height: are all numbers right, and in mm?";
    find(".balancer-status").textContent = !heights ? impossible : shown.refused
      ? `${fixed(wanted.tilt / DEGREE, 1)}° is ${WORDS[shown.refused]}: shown is ${fixed(shown.tilt / DEGREE, 1)}°` : "";
    find("table").hidden = find(".balancer-error").hidden = !heights;
    sliders.tilt.input.value = wanted.tilt / DEGREE;
    sliders.azimuth.input.value = wanted.azimuth / DEGREE;
    sliders.height.input.value = 1e3 * wanted.height;
    sliders.tilt.output.textContent = `${fixed(wanted.tilt / DEGREE, 1)}°`;
    sliders.azimuth.output.textContent = `${fixed(wanted.azimuth / DEGREE, 1)}°`;
    sliders.height.output.textContent = `${fixed(1e3 * wanted.height, 1)} mm`;
    if (shown) {
      shown.copied = copiedBalls(machine, shown.normal, wanted.height);
      shown.commanded = stage.commanded(shown.copied);
      shown.off = shown.copied.map((ball, k) => size(minus(ball, shown.balls[k])));
      const side = Math.sqrt(3) * machine.plate;
      shown.bent = Math.max(...[0, 1, 2].map((k) =>
        Math.abs(size(minus(shown.copied[k], shown.copied[(k + 1) % 3])) - side)));
      find("thead th:nth-child(2)").textContent = `reading [${unit}]`;
      rows.forEach((cells, k) => {
        const right = factor * shown.readings[k], theirs = shown.commanded && factor * shown.commanded.readings[k];
        const texts = [fixed(right, digits), theirs === null ? "–" : fixed(theirs, digits),
          theirs === null ? "–" : fixed(theirs - right, digits)];
        cells.forEach((cell, i) => { cell.textContent = texts[i]; });
        cells[0].dataset.value = shown.readings[k];
      });
      find(".balancer-error b").textContent = `${fixed(1e3 * Math.max(...shown.off), 2)} mm`;
      find(".balancer-error span").textContent = errorText();
    }
    draw();
  }

  function errorText() {
    const start = `is how far the copied formula misses a ball; a side of its plate is wrong by ${fixed(1e3 * shown.bent, 2)} mm. `;
    const real = shown.commanded && shown.commanded.state;
    if (!real) return `${start}The machine has no state near its readings.`;
    const tilt = Math.acos(Math.min(real.normal[2], 1)) / DEGREE;
    const low = 1e3 * (real.position[2] - wanted.height);
    return `${start}With its readings the machine tilts ${fixed(tilt, 2)}° at a height of ${fixed(1e3 * wanted.height + low, 2)} mm.`;
  }

  // The picture: parallel projection, from back to front

  const SVG = "http://www.w3.org/2000/svg";
  const layers = Object.fromEntries(["floor", "behind", "plate", "front"].map((name) => {
    const group = document.createElementNS(SVG, "g");
    group.setAttribute("class", name === "floor" ? "" : name);
    return [name, svg.appendChild(group)];
  }));
  const shape = (layer, name, attributes, text = "") => {
    const made = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
    made.textContent = text;
    layers[layer].append(made);
  };

  function draw() {
    Object.values(layers).forEach((layer) => layer.replaceChildren());
    const { clientWidth: width, clientHeight: height } = svg;
    if (!shown || !width) return;
    const { azimuth: a, elevation: e } = view, reach = Math.max(machine.base + machine.crank, 1.15 * machine.plate);
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    const tall = Math.min(heights[1], 1.5 * machine.home) * Math.cos(e) + 2.1 * reach * Math.sin(e);
    const scale = Math.min((0.46 * width) / reach, (0.8 * height) / tall);
    Object.assign(view, { scale, right, near: [Math.cos(a), Math.sin(a), 0] });
    const middle = [0, 0, 0.5 * wanted.height];
    const at = (point) => [width / 2 + scale * dot(right, minus(point, middle)), height / 2 - scale * dot(up, minus(point, middle))];
    const path = (points) => `M${points.map((point) => at(point).map((x) => x.toFixed(1)).join(" ")).join("L")}Z`;
    const line = (layer, kindOf, from, to) => {
      const [[x1, y1], [x2, y2]] = [at(from), at(to)];
      shape(layer, "line", { class: kindOf, x1, y1, x2, y2 });
    };
    const dotAt = (layer, kindOf, point, r) => {
      const [cx, cy] = at(point);
      shape(layer, "circle", { class: kindOf, cx, cy, r });
    };
    const round = Array.from({ length: 72 }, (_, k) => [Math.cos((k * Math.PI) / 36), Math.sin((k * Math.PI) / 36)]);
    const { plate, base, crank, slide } = machine, { normal: n, position, balls, readings } = shown;
    shape("floor", "path", { class: "floor", d: path(round.map(([c, s]) => [1.15 * base * c, 1.15 * base * s, 0])) });
    balls.forEach((ball, k) => {
      const out = RADIAL[k], pivot = out.map((x) => base * x), q = readings[k];
      const along = [[0, 0], slide.map((x) => q * x), [crank * Math.cos(q), crank * Math.sin(q)]][kind];
      const knee = pivot.map((x, i) => x + along[0] * out[i] + (i === 2 ? along[1] : 0));
      line("behind", "crank", pivot, kind ? knee : pivot.map((x, i) => 0.55 * x + 0.45 * ball[i]));
      line("behind", "rod", knee, ball);
      dotAt("behind", "joint", pivot, 6);
      if (kind) dotAt("behind", "joint", knee, 5);
      const [x, y] = at(out.map((c) => 0.72 * base * c));
      shape("floor", "text", { class: "number", x, y }, String(k + 1));
    });
    // Two axes of the plate, of which only the circle they span is seen.
    const first = minus(balls[0], position).map((x) => x / plate);
    const second = [n[1] * first[2] - n[2] * first[1], n[2] * first[0] - n[0] * first[2], n[0] * first[1] - n[1] * first[0]];
    shape("plate", "path", { d: path(round.map(([c, s]) => position.map((x, i) => x + 1.12 * plate * (c * first[i] + s * second[i])))) });
    balls.forEach((ball, k) => line("plate", "side", ball, balls[(k + 1) % 3]));
    balls.forEach((ball) => dotAt("plate", "ball", ball, 6));
    shape("front", "path", { class: "copied", d: path(shown.copied) });
    shown.copied.forEach((ball, k) => {
      dotAt("front", "copied-ball", ball, 3.5);
      const [[x, y], [x0, y0]] = [at(ball), at(position)], away = 38 / Math.max(Math.hypot(x - x0, y - y0), 1);
      const place = { class: "off", x: x - away * (x0 - x), y: y - 0.7 * away * (y0 - y) };
      shape("front", "text", place, `${fixed(1e3 * shown.off[k], 1)} mm`);
    });
  }

  // Drags and keys

  function tiltBy(across, nearer) {
    const normal = normalOf(shown ? shown.tilt : 0, wanted.azimuth);
    const [x, y] = [0, 1].map((i) => normal[i] + across * view.right[i] + nearer * view.near[i]), tilt = Math.hypot(x, y);
    wanted.tilt = Math.asin(Math.min(tilt, 0.866));
    if (tilt > 1e-9) wanted.azimuth = Math.atan2(y, x);
    update();
    // A drag ends where the machine does.
    if (shown) wanted.tilt = shown.tilt;
  }

  let grip = null;
  svg.addEventListener("pointerdown", (event) => {
    grip = { plate: Boolean(event.target.closest(".plate")), x: event.clientX, y: event.clientY };
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (!grip || !svg.hasPointerCapture(event.pointerId)) return;
    const [across, down] = [event.clientX - grip.x, event.clientY - grip.y];
    Object.assign(grip, { x: event.clientX, y: event.clientY });
    if (grip.plate && shown) {
      const lever = view.scale * machine.plate;
      tiltBy(across / lever, down / lever);
    } else {
      view.azimuth -= 0.008 * across;
      view.elevation = Math.min(Math.max(view.elevation + 0.005 * down, 0.1), 1.3);
      draw();
    }
  });
  svg.addEventListener("pointerup", () => { grip = null; });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!step) return;
    event.preventDefault();
    tiltBy(...step.map((x) => x * DEGREE));
  });
  new ResizeObserver(draw).observe(svg);

  find(".balancer-copy").addEventListener("click", () => {
    const { unit, factor } = KINDS[kind];
    navigator.clipboard.writeText(`${shown.readings.map((q) => (factor * q).toFixed(4)).join(", ")} ${unit}`);
  });
  find(".balancer-header").addEventListener("click", () => {
    const link = element("a", { download: "stage.h", href: URL.createObjectURL(new Blob([headerOf(machine)], { type: "text/plain" })) });
    link.click();
    URL.revokeObjectURL(link.href);
  });
  showNumbers();
  rebuild();
  // For the browser's console, and for tests.
  root.stage = { ...stage, shown: () => shown, machine: () => machine };
}

try {
  start(await loadStage());
} catch (error) {
  root.hidden = true;
  console.warn(`The stage is not shown: ${error.message}`);
}
