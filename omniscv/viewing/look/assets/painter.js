// Draws the layers of a frame into the panes of the stage.

const FORM = { picture: 0, ids: 1, scalar: 2, vectors: 3, marks: 4 };

class Painter {
  constructor(gpu, shared) {
    this.gpu = gpu;
    this.shared = shared;
    this.ofCamera = new Map();
    this.palettes = { labels: this.palette(shared.labels), classes: this.palette(shared.classes) };
    this.ramps = {};
    for (const [name, data] of Object.entries(shared.ramps)) this.ramps[name] = gpu.texture("u1x3", 256, 1, bytesOf(data));
  }

  palette(table) {
    const colors = new Uint8Array(3 * 65536);
    for (let id = 1; id < 65536; id++) colors.fill(110, 3 * id, 3 * id + 3);
    for (const [id, { color }] of Object.entries(table)) for (let c = 0; c < 3; c++) colors[3 * id + c] = parseInt(color.substr(1 + 2 * c, 2), 16);
    colors.set([34, 40, 48]);
    return this.gpu.texture("u1x3", 256, 256, colors);
  }

  camera(camera) {
    if (!this.ofCamera.has(camera)) {
      const { gpu } = this, N = camera.sphere?.cells;
      const tables = N && {
        uKinds: gpu.texture("u4", N, 6 * N, camera.kinds),
        uNodes: gpu.texture("f4x2", N + 1, 6 * (N + 1), camera.nodes),
        uTables: gpu.texture("f4x2", 2048, camera.tables.length / 4096, camera.tables),
      };
      const valid = camera.valid ? gpu.texture("u1", camera.width, camera.height, camera.valid) : gpu.everywhere;
      this.ofCamera.set(camera, { uKinds: gpu.noNumber, uNodes: gpu.noColor, uTables: gpu.noColor, ...tables, uValid: valid });
    }
    return this.ofCamera.get(camera);
  }

  // The texture of a layer, made when it is first shown; "all marks" are one.
  layer(frame, name, camera) {
    if (!(name in frame.textures)) {
      const { gpu } = this, { width, height } = camera, found = frame.layers[name];
      const make = {
        picture: () => gpu.picture(found.bitmap, camera.wraps), ids: () => gpu.texture("u2", width, height, found.data),
        scalar: () => gpu.texture("f4", width, height, found.data), vectors: () => gpu.texture("i1x3", width, height, found.data),
        marks: () => gpu.texture("u1", width, height, frame.marks),
      };
      frame.textures[name] = make[found?.form ?? "marks"]();
    }
    return frame.textures[name];
  }

  textures(frame, name, camera, look) {
    const { gpu } = this, form = frame.layers[name]?.form, of = (wanted) => (form === wanted ? this.layer(frame, name, camera) : gpu.noColor);
    const focus = look.focus && frame.layers[look.focus.layer] ? this.layer(frame, look.focus.layer, camera) : gpu.noNumber;
    return {
      ...this.camera(camera),
      uPicture: of("picture"), uScalar: of("scalar"), uVectors: of("vectors"),
      uIds: form === "ids" ? this.layer(frame, name, camera) : gpu.noNumber,
      uFocusIds: focus, uMarks: frame.marks ? this.layer(frame, "all marks", camera) : gpu.noNumber,
      uPalette: this.palettes[name === "classes" ? "classes" : "labels"], uRamp: this.ramps[look.ramp],
    };
  }

  // pane: {port, clip, layer}, px of the screen; view: what View.of returns.
  paint(frame, camera, pane, view, look, samples) {
    const name = pane.layer, layer = frame.layers[name];
    const ends = look.ends[name] ?? [0.1, 10];
    const focus = look.focus && frame.layers[look.focus.layer] ? look.focus.id : 0;
    const perScreen = view.flat ? view.plane[2] : (camera.density ?? 1) / view.projection.focal;
    const numbers = {
      uSamples: ["1i", samples], uFlat: ["1i", view.flat], uStereographic: ["1i", view.projection.stereographic],
      uClosed: ["1i", camera.closed], uFocal: ["1f", view.projection.focal], uCameraView: ["3x3", view.R_c_v],
      uWorldView: ["3x3", view.R_w_v], uPlane: ["3f", ...view.plane], uSize: ["2f", camera.width, camera.height],
      uCells: ["1i", camera.sphere?.cells ?? 1], uFine: ["1i", camera.sphere?.fine ?? 1], uForm: ["1i", FORM[layer?.form] ?? 4],
      uLevel: ["1f", Math.log2(perScreen / samples)], uEnds: ["2f", Math.log(ends[0]), Math.log(Math.max(ends[1], ends[0] * 1.001))],
      uFocus: ["1ui", focus], uBit: ["1ui", layer?.form === "marks" ? bitOf(name) : 0],
      uHatch: ["1ui", look.marks && frame.marks ? BITS.unsure | BITS.occluded : 0],
    };
    this.gpu.draw(pane.port, pane.clip, numbers, this.textures(frame, name, camera, look));
  }
}
