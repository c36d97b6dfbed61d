// The page: what is shown, and what changes it.

const COMPARE = ["off", "slider", "beside"];
const PLAY_MS = 250;

class Page {
  constructor(shared) {
    const rank = (name) => (ORDER.includes(name) ? ORDER.indexOf(name) : ORDER.length);
    shared.layers.sort((a, b) => rank(a.name) - rank(b.name));
    Object.assign(this, { shared, view: new View(), frames: new Frames(shared), index: 0, frame: null, compare: "off", split: 0.5, cursor: null, kinds: 0 });
    this.names = shared.layers.map(({ name }) => name);
    [this.layer, this.second] = [this.names[0], this.names.includes("depth") ? "depth" : (this.names[1] ?? this.names[0])];
    const ends = Object.fromEntries(Object.entries(shared.ranges).map(([name, [low, high]]) => [name, [low, Math.max(high, low * 1.05)]]));
    this.look = { ends, ramp: "turbo", focus: null, marks: false, layout: false };
    for (const [name, each] of Object.entries(shared.cameras)) shared.cameras[name] = new LookCamera(each);
    this.painter = new Painter(new Gpu(element("gl")), shared);
    this.frames.released = (frame) => this.painter.gpu.release(frame.textures);
    this.overlay = new Overlay(element("over"));
    this.plan = new Plan(element("map"), shared);
    this.panel = new Panel(this);
    this.controls = new Controls(this, element("stage"));
    this.bar = new Bar(this);
    new ResizeObserver(() => this.changed()).observe(element("stage"));
    // The address of the event: the page may have written its own since.
    window.addEventListener("hashchange", (event) => this.fromHash(new URL(event.newURL).hash));
  }

  get line() { return this.shared.frames[this.index]; }
  get camera() { return this.shared.cameras[this.line.camera]; }
  get rotation() { return this.shared.placed ? this.line.rotation : LEVEL; }
  get group() { return this.shared.frames.flatMap((each, i) => (each.camera === this.line.camera ? [i] : [])); }

  // A panorama where there is one.
  get first() { return Math.max(0, this.shared.frames.findIndex((each) => this.shared.cameras[each.camera].closed)); }

  // -- frames ------------------------------------------------------------------------------------

  async show(index) {
    const wanted = (this.wanted = index), { shared } = this;
    try {
      const camera = shared.cameras[shared.frames[index].camera];
      camera.loading ??= camera.load();
      const [frame] = await Promise.all([this.frames.get(index), camera.loading]);
      if (this.wanted !== wanted) return;
      const first = !this.frame, other = !first && this.line.camera !== shared.frames[index].camera;
      Object.assign(this, { index, frame });
      if (!this.names.includes(this.layer) || !(this.layer in frame.layers)) this.layer = this.names.find((name) => name in frame.layers);
      if (first) this.reset();
      else if (other && !this.sees()) this.start();
      element("message").textContent = "";
      this.changed();
      const next = this.group[this.group.indexOf(index) + 1];
      if (next !== undefined) this.frames.get(next).catch(() => {});
    } catch (error) {
      this.say(error.message);
    }
  }

  say(text) {
    element("message").textContent = text;
  }

  step(by) {
    const { group } = this, place = group.indexOf(this.wanted ?? this.index);
    return this.show(group[(place + by + group.length) % group.length]);
  }

  play() {
    this.playing = !this.playing;
    const advance = async () => {
      if (!this.playing) return;
      const began = performance.now();
      await this.step(1);
      setTimeout(advance, Math.max(30, PLAY_MS - (performance.now() - began)));
    };
    advance();
    this.bar.update();
  }

  nextCamera() {
    const names = Object.keys(this.shared.cameras);
    this.setCamera(names[(names.indexOf(this.line.camera) + 1) % names.length]);
  }

  // The frame of another camera that belongs to this one: of its place in time, else in the row.
  setCamera(name) {
    const { frames } = this.shared, others = frames.flatMap((each, i) => (each.camera === name ? [i] : []));
    const same = others.find((i) => frames[i].time !== null && frames[i].time === this.line.time);
    this.show(same ?? others[Math.min(this.group.indexOf(this.index), others.length - 1)]);
  }

  // -- the view ----------------------------------------------------------------------------------

  // Whether the camera sees what is in the middle.
  sees() {
    const shown = this.shown(100, 100);
    return shown.flat || pixelAt(shown, this.camera, 0, 0) !== null;
  }

  // Look along the camera's axis, or where its field of view lies.
  start() {
    const { camera, rotation, view } = this, tries = [[0, 0, 1]];
    const rays = [0.5, 0.25, 0.75, 0.1, 0.9].flatMap((s) => [0.5, 0.25, 0.75, 0.1, 0.9].map((t) => camera.rayOf(s * camera.width, t * camera.height)));
    const seen = rays.filter(Boolean).map(({ direction }) => direction);
    tries.push([0, 1, 2].map((c) => seen.reduce((sum, each) => sum + each[c], 0.001)), ...seen);
    const angles = (d) => anglesOf(times(rotation, d.map((each) => each / Math.hypot(...d))));
    const level = seen.map(angles).sort((a, b) => Math.abs(a[1]) - Math.abs(b[1]));
    const wanted = [...tries.map(angles).filter(([, pitch]) => Math.abs(pitch) < 60), ...level, [0, 0]];
    for (const [yaw, pitch] of wanted) {
      Object.assign(view, { yaw, pitch });
      if (this.sees()) return;
    }
  }

  reset() {
    Object.assign(this.view, { planet: false, fov: 80, u: 0.5, v: 0.5, zoom: 1 });
    this.start();
    this.cursor = null;
    this.changed();
  }

  shown(width, height) {
    return this.view.of(this.camera, this.rotation, width, height);
  }

  setFlat(on) {
    this.view.flat = on;
    this.changed();
  }

  setPlanet(on) {
    if (this.camera.spherical) this.view.setPlanet(on);
    this.changed();
  }

  zoom(factor, x = null, y = null) {
    const pane = this.paneAt(x ?? 0, y ?? 0), shown = this.shown(pane.box.width, pane.box.height);
    const from = x === null ? [0, 0] : [x - pane.box.x - pane.box.width / 2, y - pane.box.y - pane.box.height / 2];
    this.view.scale(factor, shown.flat, ...from, shown, this.camera);
    this.moved();
    this.rested();
  }

  // -- layers ------------------------------------------------------------------------------------

  setLayer(index, second = false) {
    const name = this.names[index];
    if (!name || !(name in this.frame.layers)) return;
    if (second && this.compare === "off") this.compare = "slider";
    this[second ? "second" : "layer"] = name;
    this.changed();
  }

  nextCompare() {
    this.compare = COMPARE[(COMPARE.indexOf(this.compare) + 1) % COMPARE.length];
    this.changed();
  }

  toggle(what) {
    this.look[what] = !this.look[what];
    this.changed();
  }

  get boxKinds() { return Object.keys(this.frame?.boxes ?? {}); }

  nextBoxes() {
    this.kinds = (this.kinds + 1) % (this.boxKinds.length + 1);
    this.changed();
  }

  togglePanel() {
    element("app").classList.toggle("closed");
    this.changed();
  }

  release() {
    [this.look.focus, this.cursor] = [null, null];
    this.changed();
  }

  // -- panes and reading -------------------------------------------------------------------------

  // {box: of the projection, clip, layer}, px of the stage from its upper left corner.
  get panes() {
    const { clientWidth: width, clientHeight: height } = element("stage"), whole = { x: 0, y: 0, width, height };
    if (this.compare === "off") return [{ box: whole, clip: whole, layer: this.layer }];
    if (this.compare === "slider") {
      const x = Math.round(this.split * width);
      return [{ box: whole, clip: { ...whole, width: x }, layer: this.layer }, { box: whole, clip: { ...whole, x, width: width - x }, layer: this.second }];
    }
    const tall = height > width, half = tall ? { width, height: height / 2 } : { width: width / 2, height };
    const other = tall ? { ...half, x: 0, y: height / 2 } : { ...half, x: width / 2, y: 0 }, one = { ...half, x: 0, y: 0 };
    return [{ box: one, clip: one, layer: this.layer }, { box: other, clip: other, layer: this.second }];
  }

  paneAt(x, y) {
    return this.panes.find(({ clip }) => x >= clip.x && y >= clip.y && x < clip.x + clip.width && y < clip.y + clip.height) ?? this.panes[0];
  }

  shownAt(x, y) {
    const { box } = this.paneAt(x, y);
    return this.shown(box.width, box.height);
  }

  onDivider(x) {
    return this.compare === "slider" && Math.abs(x - this.split * element("stage").clientWidth) < 14;
  }

  divide(x) {
    this.split = clamp(x / element("stage").clientWidth, 0.02, 0.98);
    this.moved();
  }

  readAt(at) {
    this.cursor = at;
    this.read();
    this.schedule();
  }

  // A tap reads a place, and in the middle the cross that is always there.
  tap(at) {
    const { box } = this.paneAt(...at), off = Math.hypot(at[0] - box.x - box.width / 2, at[1] - box.y - box.height / 2);
    this.readAt(off < 20 ? null : at);
  }

  // The place that is read, px from the middle of its pane.
  get place() {
    const { box } = this.cursor ? this.paneAt(...this.cursor) : this.panes[0];
    return this.cursor ? [this.cursor[0] - box.x - box.width / 2, this.cursor[1] - box.y - box.height / 2] : [0, 0];
  }

  read() {
    if (!this.frame) return;
    const { box } = this.cursor ? this.paneAt(...this.cursor) : this.panes[0];
    const found = pixelAt(this.shown(box.width, box.height), this.camera, ...this.place);
    this.found = found && probe(this.shared, this.frame, this.camera, this.index, found);
    this.panel.read(this.found);
  }

  // -- drawing -----------------------------------------------------------------------------------

  // Something other than the view changed.
  changed() {
    if (!this.frame) return;
    this.bar.update();
    this.panel.scale();
    this.panel.objects();
    this.moved();
    this.rested();
  }

  moved() {
    this.fine = false;
    this.read();
    this.schedule();
  }

  // Draw finer, with several samples for a px of the screen, when nothing has moved for a while.
  rested() {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => {
      this.fine = true;
      this.schedule();
      this.toHash();
    }, 160);
  }

  schedule() {
    this.scheduled ??= requestAnimationFrame(() => {
      this.scheduled = null;
      try {
        this.draw();
      } catch (error) {
        this.say(error.message);
      }
    });
  }

  draw() {
    const stage = element("stage"), ratio = Math.min(2, window.devicePixelRatio || 1), canvas = element("gl");
    const [width, height] = [stage.clientWidth, stage.clientHeight];
    if (!this.frame || !width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    }
    this.overlay.clear(width, height, ratio);
    const down = ({ x, y, width: w, height: h }) => [x, height - y - h, w, h].map((each) => Math.round(each * ratio));
    for (const pane of this.panes) {
      const view = this.view.of(this.camera, this.rotation, pane.box.width, pane.box.height);
      const screen = { ...view, projection: { ...view.projection, focal: view.projection.focal * ratio }, plane: [view.plane[0], view.plane[1], view.plane[2] / ratio] };
      this.painter.paint(this.frame, this.camera, { port: down(pane.box), clip: down(pane.clip), layer: pane.layer }, screen, this.look, this.fine ? 2 : 1);
      this.overlay.within(pane.box, pane.clip, () => this.lines(view, pane));
      if (this.compare !== "off") this.overlay.label(titleOf(pane.layer), pane.clip.x + 14, pane.clip.y + 25);
    }
    if (this.compare === "slider") this.overlay.divider(this.split * width, height);
    this.drawPlan();
  }

  lines(view) {
    const { frame, camera, overlay } = this, kind = this.boxKinds[this.kinds - 1];
    if (this.look.layout && frame.layout) overlay.layout(view, camera, frame.layout);
    if (kind) overlay.boxes(view, camera, frame.boxes[kind], this.shared.labels);
    if (!this.cursor || matchMedia("(pointer: coarse)").matches || this.compare !== "off") overlay.cross(...this.place, this.cursor !== null);
  }

  drawPlan() {
    element("plan").hidden = !this.shared.placed;
    if (!this.shared.placed) return;
    const { box } = this.panes[0], shown = this.shown(box.width, box.height), half = shown.flat ? Math.PI : Math.atan(box.width / 2 / shown.projection.focal);
    const hit = this.found?.point ?? null, floor = this.frame.layout?.floor;
    const slice = (this.frame.slice ??= levelSlice(this.shared.frames[this.frame.index], this.frame, this.camera));
    this.plan.draw({ slice, index: this.index, group: this.group, rotation: this.rotation, yaw: this.view.yaw, halfView: this.view.planet ? Math.PI : half, floor, hit });
  }

  // -- the address -------------------------------------------------------------------------------

  // The view in the page's address, so that it can be sent, and comes back.
  toHash() {
    const { yaw, pitch, fov, flat, planet } = this.view;
    const said = { frame: this.line.key, layer: this.layer, yaw: yaw.toFixed(3), pitch: pitch.toFixed(3), fov: fov.toFixed(2) };
    const text = new URLSearchParams({ ...said, ...(flat && { flat: 1 }), ...(planet && { planet: 1 }) }).toString();
    if (location.hash.slice(1) !== text) history.replaceState(null, "", `#${text}`);
  }

  async fromHash(hash) {
    const said = new URLSearchParams(hash.slice(1)), number = (key, low, high) => {
      const value = Number.parseFloat(said.get(key));
      if (Number.isFinite(value)) this.view[key] = clamp(value, low, high);
    };
    const index = this.shared.frames.findIndex(({ key }) => key === said.get("frame"));
    if (index !== this.index || !this.frame) await this.show(index < 0 ? this.first : index);
    if (!this.frame) return;
    if (said.has("layer") && said.get("layer") in this.frame.layers) this.layer = said.get("layer");
    [this.view.flat, this.view.planet] = [said.get("flat") === "1", said.get("planet") === "1"];
    number("yaw", -360, 360);
    number("pitch", -90, 90);
    number("fov", 2, WIDEST[this.view.planet]);
    this.cursor = null;
    this.changed();
  }
}
