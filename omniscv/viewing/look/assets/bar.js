// The bars above and below the image: layers, tools, the time line.

class Bar {
  constructor(page) {
    this.page = page;
    const { shared } = page, on = (id, kind, does) => element(id).addEventListener(kind, does);
    [document.title, element("title").textContent] = [`${shared.title} \u2013 omniscv look`, shared.title];
    this.chips = page.names.map((name, i) => {
      const chip = made("button", titleOf(name), { role: "radio" });
      if (i < 9) chip.append(made("kbd", i + 1));
      chip.addEventListener("click", () => page.setLayer(i));
      return chip;
    });
    element("layers").replaceChildren(...this.chips);
    element("second").replaceChildren(...page.names.map((name) => made("option", titleOf(name), { value: name })));
    element("camera").replaceChildren(...Object.keys(shared.cameras).map((name) => made("option", name, { value: name })));
    on("second", "change", () => page.setLayer(page.names.indexOf(element("second").value), true));
    on("camera", "change", () => page.setCamera(element("camera").value));
    on("compare", "change", () => {
      page.compare = element("compare").value;
      page.changed();
    });
    on("sphere", "click", () => page.setFlat(false));
    on("flat", "click", () => page.setFlat(true));
    on("planet", "click", () => page.setPlanet(!page.view.planet));
    on("layout", "click", () => page.toggle("layout"));
    on("marks", "click", () => page.toggle("marks"));
    on("boxes", "click", () => page.nextBoxes());
    on("help", "click", () => element("keys").showModal());
    on("more", "click", () => page.togglePanel());
    on("before", "click", () => page.step(-1));
    on("after", "click", () => page.step(1));
    on("play", "click", () => page.play());
    on("time", "input", () => page.show(page.group[element("time").value]));
    on("map", "click", (event) => {
      const found = page.plan.nearest(event.offsetX, event.offsetY, page.group);
      if (found !== null) page.show(found);
    });
    if (matchMedia("(max-width: 760px)").matches) element("app").classList.add("closed");
  }

  update() {
    const { page } = this, { shared, camera, frame, line, group, look } = page, press = (id, on) => element(id).setAttribute("aria-pressed", on);
    element("subtitle").textContent = `${line.key} \u00b7 ${camera.model} ${camera.width}\u00d7${camera.height}`;
    element("subtitle").title = element("subtitle").textContent;
    this.chips.forEach((chip, i) => {
      chip.setAttribute("aria-checked", page.names[i] === page.layer);
      chip.disabled = !(page.names[i] in frame.layers);
    });
    const flat = page.view.flat || !camera.spherical;
    press("sphere", !flat);
    press("flat", flat);
    press("planet", page.view.planet && !flat);
    [element("sphere").disabled, element("planet").disabled] = [!camera.spherical, !camera.spherical];
    press("layout", look.layout);
    press("marks", look.marks);
    press("boxes", page.kinds > 0);
    element("boxes").textContent = page.kinds === 0 ? "Boxes" : page.boxKinds[page.kinds - 1] === "boxes3d" ? "Boxes 3-D" : "Boxes 2-D";
    [element("layout").hidden, element("boxes").hidden] = [!frame.layout, !page.boxKinds.length];
    element("marks").hidden = !(frame.layers.unsure || frame.layers.occluded);
    [element("compare").value, element("second").value, element("camera").value] = [page.compare, page.second, line.camera];
    element("second").hidden = page.compare === "off";
    element("compare").hidden = page.names.length < 2;
    element("camera").hidden = Object.keys(shared.cameras).length < 2;
    press("more", !element("app").classList.contains("closed"));
    element("timeline").hidden = group.length < 2;
    [element("time").max, element("time").value] = [group.length - 1, group.indexOf(page.index)];
    const time = line.time === null ? "" : ` \u00b7 ${Number(line.time.toFixed(3))} s`;
    element("moment").textContent = `${group.indexOf(page.index) + 1} / ${group.length}${time}`;
    element("play").textContent = page.playing ? "Pause" : "Play";
  }
}
