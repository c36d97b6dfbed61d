// The side panel: what is read, the scale of a layer, the objects.

const element = (id) => document.getElementById(id);

function made(tag, text = "", attributes = {}) {
  const found = document.createElement(tag);
  found.textContent = text;
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  return found;
}

function swatch(color) {
  const found = made("i", "", { class: "swatch" });
  found.style.background = color;
  return found;
}

class Panel {
  constructor(page) {
    this.page = page;
    this.counted = new WeakMap();
    this.slots = [];
    for (const [input, end] of [["near", 0], ["far", 1]]) element(input).addEventListener("input", () => this.drag(end, element(input)));
    element("colors").addEventListener("click", () => {
      page.look.ramp = page.look.ramp === "turbo" ? "cividis" : "turbo";
      page.changed();
    });
  }

  // -- what is read ------------------------------------------------------------------------------

  read(found) {
    const rows = found ? this.rows(found) : [["", "nothing here", "big"]];
    element("values").replaceChildren(...rows.flatMap(([key, text, kind, color]) => {
      const shown = made("dd", text, kind ? { class: kind } : {});
      if (color) shown.prepend(swatch(color));
      return [made("dt", key), shown];
    }));
    const data = element("reading").dataset;
    const read = found ? { name: found.name, label: found.label ?? "", metres: found.depth ?? "", pixel: found.pixel.join(",") } : { name: "", label: "", metres: "", pixel: "" };
    Object.assign(data, read);
    this.hud(found);
  }

  rows(found) {
    const rows = [];
    if (found.label !== null) rows.push(["object", found.name || "none", "big", found.name ? found.color : null]);
    if (found.class) rows.push(["class", found.class]);
    if (found.depth !== null) rows.push(["distance", inMetres(found.depth), "big"]);
    if (found.error !== null && found.depth > 0) rows.push(["off by", offBy(found.error)]);
    rows.push(["pixel", found.pixel.join(", ")]);
    if (found.angles && this.page.shared.placed) rows.push(["heading", `${signed(found.angles[0], 2)}\u00b0, up ${signed(found.angles[1], 2)}\u00b0`]);
    if (found.direction) rows.push(["ray", vector(found.direction, 3)]);
    if (found.point) rows.push(["point", `${vector(found.point, 3)} m`]);
    if (found.normal) rows.push(["normal", vector(found.normal, 2)]);
    for (const [name, value] of found.others) rows.push([name, String(value)]);
    if (found.marks.length) rows.push(["marks", found.marks.map(titleOf).join(", ").toLowerCase()]);
    return rows;
  }

  hud(found) {
    const head = made("b"), small = made("small");
    if (!found) head.textContent = "nothing here";
    else {
      if (found.color) head.append(swatch(found.color));
      head.append([found.name, inMetres(found.depth)].filter(Boolean).join("  \u00b7  ") || `pixel ${found.pixel.join(", ")}`);
      const angles = found.angles && `${signed(found.angles[0], 1)}\u00b0, up ${signed(found.angles[1], 1)}\u00b0`;
      small.textContent = [found.class, `pixel ${found.pixel.join(", ")}`, angles].filter(Boolean).join("  \u00b7  ");
    }
    element("hud").replaceChildren(head, small);
  }

  // -- the scale ---------------------------------------------------------------------------------

  // The layer that has a scale: the first one shown of those that do.
  scaled() {
    const { shared, layer, second, compare } = this.page, has = (name) => shared.ranges[name];
    return [layer, ...(compare === "off" ? [] : [second])].find(has) ?? null;
  }

  limits(name) {
    const [low, high] = this.page.shared.ranges[name];
    return [Math.log(low / 3), Math.log(Math.max(high, low * 1.01) * 3)];
  }

  scale() {
    const name = this.scaled(), { look } = this.page;
    element("scale").hidden = !name;
    if (!name) return;
    element("scale").firstElementChild.textContent = `${titleOf(name)}, metres, logarithmic`;
    const [low, high] = this.limits(name), ends = look.ends[name];
    ["near", "far"].forEach((id, end) => (element(id).value = (1000 * (Math.log(ends[end]) - low)) / (high - low)));
    ["least", "most"].forEach((id, end) => (element(id).textContent = `${Number(ends[end].toPrecision(3))} m`));
    element("colors").textContent = look.ramp === "turbo" ? "Turbo" : "Cividis";
    const pen = element("ramp").getContext("2d"), colors = bytesOf(this.page.shared.ramps[look.ramp]);
    const shown = pen.createImageData(256, 1);
    for (let i = 0; i < 256; i++) shown.data.set([...colors.subarray(3 * i, 3 * i + 3), 255], 4 * i);
    pen.putImageData(shown, 0, 0);
  }

  drag(end, input) {
    const name = this.scaled(), ends = this.page.look.ends[name], [low, high] = this.limits(name);
    const value = Math.exp(low + (input.value / 1000) * (high - low));
    ends[end] = end ? Math.max(value, ends[0] * 1.02) : Math.min(value, ends[1] / 1.02);
    this.page.changed();
  }

  // -- the objects -------------------------------------------------------------------------------

  // Which table the list shows: classes where that layer is shown, else objects.
  table() {
    const { layer, second, compare, shared } = this.page, shown = [layer, ...(compare === "off" ? [] : [second])];
    return shown.includes("classes") && !shown.includes("labels") && Object.keys(shared.classes).length ? "classes" : "labels";
  }

  count(frame, name) {
    const counts = this.counted.get(frame) ?? {};
    if (!(name in counts)) {
      const found = new Uint32Array(65536);
      frame.layers[name]?.data.forEach((id) => found[id]++);
      counts[name] = found;
      this.counted.set(frame, counts);
    }
    return counts[name];
  }

  objects() {
    const { page } = this, name = this.table(), table = page.shared[name], frame = page.frame;
    element("legend").hidden = !Object.keys(table).length || !frame?.layers[name];
    if (element("legend").hidden) return;
    const counts = this.count(frame, name), key = `${name} ${page.index} ${JSON.stringify(page.look.focus)} ${page.layer === "object_mask"}`;
    if (key === this.listed) return;
    this.listed = key;
    element("kind").textContent = name === "classes" ? "Classes" : "Objects";
    const { width, height } = page.camera, ids = Object.keys(table).map(Number).sort((a, b) => counts[b] - counts[a] || a - b);
    element("objects").replaceChildren(...ids.map((id) => this.object(name, id, table[id], counts[id] / (width * height))));
  }

  object(layer, id, { name, color, mask }, share) {
    const { page } = this, { focus } = page.look, chosen = focus?.layer === layer && focus.id === id;
    const item = made("li"), button = made("button", "", { "aria-pressed": chosen, class: share ? "" : "absent" });
    const percent = share === 0 ? "not seen" : share < 0.001 ? "< 0.1 %" : `${(100 * share).toFixed(1)} %`;
    button.append(swatch(page.layer === "object_mask" && mask ? mask : color), made("span", name), made("small", percent));
    button.addEventListener("click", () => {
      page.look.focus = chosen ? null : { layer, id };
      page.changed();
    });
    item.append(button);
    return item;
  }
}
