// What a frame holds at a pixel.

function probe(shared, frame, camera, index, found) {
  const at = Math.floor(found.v) * camera.width + Math.floor(found.u), { layers } = frame;
  const value = (name) => layers[name]?.data[at] ?? null;
  const line = shared.frames[index], label = value("labels"), classId = value("classes"), depth = value("depth");
  const object = shared.labels[label], ray = camera.rayOf(found.u, found.v);
  const direction = found.direction ?? ray?.direction ?? null;
  const world = direction && times(line.rotation, direction);
  const normal = layers.normals ? [0, 1, 2].map((c) => layers.normals.data[3 * at + c] / 127) : null;
  const metres = depth > 0 && Number.isFinite(depth);
  const origin = ray && times(line.rotation, ray.origin).map((each, c) => each + line.position[c]);
  return {
    pixel: [Math.floor(found.u), Math.floor(found.v)], label, direction, world, depth, normal,
    angles: world && anglesOf(world), error: value("depth_error"),
    name: object?.name ?? (label ? `label ${label}` : ""), color: object?.color ?? shared.classes[classId]?.color ?? null,
    class: shared.classes[classId]?.name ?? object?.class ?? "", classId,
    marks: Object.keys(layers).filter((name) => layers[name].form === "marks" && layers[name].data[at]),
    others: Object.keys(layers).filter((name) => layers[name].form === "scalar" && !["depth", "depth_error"].includes(name)).map((name) => [name, value(name)]),
    point: metres && world && origin ? origin.map((each, c) => each + depth * world[c]) : null,
  };
}

// A distance with as many digits as depth's float32 has, at most millimetres.
function inMetres(value) {
  if (value === null) return "";
  if (value === Infinity) return "no surface";
  if (value === 0) return "outside";
  return `${value < 100 ? value.toFixed(3) : value.toFixed(1)} m`;
}

// The bound of an error of depth.
function offBy(metres) {
  if (metres === Infinity) return "not bounded";
  return metres < 1e-5 ? "less than 0.01 mm" : `at most ${Number((1000 * metres).toPrecision(2))} mm`;
}

// With a minus sign, and none before zero.
const signed = (value, digits) => value.toFixed(digits).replace(/^-(?!0\.?0*$)/, "\u2212").replace("-", "");
const vector = (values, digits) => values.map((each) => signed(each, digits)).join(", ");

// Points of the surfaces that a frame sees about level, [x, y] in the world, metres: the room from above.
function levelSlice({ position, rotation }, { layers }, camera) {
  const found = [], step = Math.max(1, Math.round(Math.sqrt(camera.width * camera.height) / 160));
  if (!layers.depth) return found;
  for (let v = step / 2; v < camera.height; v += step) {
    for (let u = step / 2; u < camera.width; u += step) {
      const depth = layers.depth.data[Math.floor(v) * camera.width + Math.floor(u)];
      const ray = depth > 0 && depth < Infinity && camera.rayOf(u, v), world = ray && times(rotation, ray.direction);
      if (!world || Math.abs(world[2]) > 0.12) continue;
      const origin = times(rotation, ray.origin);
      found.push([0, 1].map((c) => position[c] + origin[c] + depth * world[c]));
    }
  }
  const far = found.map(([x, y]) => Math.hypot(x - position[0], y - position[1])).sort((a, b) => a - b)[Math.floor(0.98 * found.length)];
  return found.filter(([x, y]) => Math.hypot(x - position[0], y - position[1]) <= far);
}
