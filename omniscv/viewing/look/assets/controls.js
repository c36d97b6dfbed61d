// Mouse, touch and keyboard.

const KEYS = [
  ["drag, arrows", "look around, or move the image"], ["wheel, pinch, + \u2212", "zoom"], ["tap", "read that place; tap the middle to read there again"],
  ["1 to 9", "layer; with shift: the second one"], ["C", "compare: slider, side by side, off"], ["F", "sphere or flat"],
  ["P", "little planet"], [", and .", "frame before, after"], ["space", "play"], ["N", "next camera"], ["L", "room layout"],
  ["B", "boxes: in the image, in space, none"], ["U", "hatch what is not verified or hidden"], ["T", "colours: turbo, cividis"],
  ["H", "panel"], ["0, Home", "back to the start"], ["Escape", "all objects again"],
];
const TURN_PX = 60;

class Controls {
  constructor(page, stage) {
    this.page = page;
    this.stage = stage;
    this.pointers = new Map();
    stage.addEventListener("pointerdown", (event) => this.down(event));
    stage.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel"]) stage.addEventListener(kind, (event) => this.up(event));
    stage.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && !this.pointers.size && page.readAt(null));
    stage.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    stage.addEventListener("dblclick", () => page.reset());
    window.addEventListener("keydown", (event) => this.key(event));
    element("keys").querySelector("dl").replaceChildren(...KEYS.flatMap(([key, does]) => [made("dt", key), made("dd", does)]));
  }

  place(event) {
    const { left, top } = this.stage.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  down(event) {
    this.stage.setPointerCapture(event.pointerId);
    const at = this.place(event);
    this.pointers.set(event.pointerId, at);
    this.began = { at, moved: false, several: this.pointers.size > 1, divider: this.page.onDivider(...at) };
  }

  move(event) {
    const at = this.place(event), before = this.pointers.get(event.pointerId);
    if (!before) {
      this.stage.style.cursor = this.page.onDivider(...at) ? "ew-resize" : "";
      if (event.pointerType === "mouse") this.page.readAt(at);
      return;
    }
    if (Math.hypot(at[0] - this.began.at[0], at[1] - this.began.at[1]) > 5) this.began.moved = true;
    if (this.pointers.size === 2) this.pinch(event.pointerId, at);
    else if (this.began.divider) this.page.divide(at[0]);
    else if (this.began.moved) this.drag(at[0] - before[0], at[1] - before[1], at);
    this.pointers.set(event.pointerId, at);
    if (event.pointerType === "mouse") this.page.readAt(at);
  }

  drag(dx, dy, at) {
    const { page } = this, shown = page.shownAt(...at);
    this.stage.classList.add("moving");
    if (shown.flat) page.view.shift(dx, dy, shown, page.camera);
    else page.view.turn(dx, dy, shown);
    page.moved();
  }

  pinch(id, at) {
    const [other] = [...this.pointers].filter(([each]) => each !== id).map(([, place]) => place), before = this.pointers.get(id);
    const far = (a) => Math.max(20, Math.hypot(a[0] - other[0], a[1] - other[1]));
    this.page.zoom(far(at) / far(before), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
    this.drag((at[0] - before[0]) / 2, (at[1] - before[1]) / 2, at);
  }

  up(event) {
    const tapped = this.pointers.has(event.pointerId) && !this.began.moved && !this.began.several && event.type === "pointerup";
    this.pointers.delete(event.pointerId);
    this.stage.classList.remove("moving");
    if (tapped && event.pointerType !== "mouse" && !this.began.divider) this.page.tap(this.place(event));
    this.page.rested();
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    this.page.zoom(Math.exp(-clamp(event.deltaY * lines, -300, 300) * 0.0016), ...this.place(event));
  }

  key(event) {
    const typing = ["INPUT", "SELECT"].includes(event.target.tagName), page = this.page;
    if (event.ctrlKey || event.metaKey || event.altKey || element("keys").open || (typing && event.key !== "Escape")) return;
    const digit = /^Digit([1-9])$/.exec(event.code)?.[1];
    const arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const does = {
      f: () => page.setFlat(!page.view.flat), p: () => page.setPlanet(!page.view.planet), c: () => page.nextCompare(),
      ",": () => page.step(-1), ".": () => page.step(1), PageUp: () => page.step(-1), PageDown: () => page.step(1),
      " ": () => page.play(), n: () => page.nextCamera(), l: () => page.toggle("layout"), b: () => page.nextBoxes(),
      u: () => page.toggle("marks"), t: () => element("colors").click(), h: () => page.togglePanel(), "?": () => element("keys").showModal(),
      "+": () => page.zoom(1.2), "=": () => page.zoom(1.2), "-": () => page.zoom(1 / 1.2), 0: () => page.reset(), Home: () => page.reset(),
      Escape: () => page.release(),
    };
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (digit) page.setLayer(digit - 1, event.shiftKey);
    else if (arrows[event.key]) this.drag(...arrows[event.key].map((each) => each * TURN_PX), [1, 1]);
    else if (key === " " && event.target.tagName === "BUTTON") return;
    else if (does[key]) does[key]();
    else return;
    event.preventDefault();
    if (arrows[event.key]) page.rested();
  }
}
