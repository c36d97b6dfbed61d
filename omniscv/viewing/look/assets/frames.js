// The frames of a page: in it, or programs beside it; the last ones that were used are kept.

const KEPT_PIXELS = 3e7;
const BITS = { unsure: 1, occluded: 2, label_edge: 4 };

class Frames {
  constructor(shared) {
    this.shared = shared;
    this.known = new Map();
    this.waiting = new Map();
    this.released = () => {};
    window.lookFrame = (index, data) => this.waiting.get(index)?.resolve(data);
  }

  // The frame, decoded; the same promise for every call while it is kept.
  get(index) {
    const found = this.known.get(index) ?? this.read(index).then((data) => this.decoded(data, index));
    this.known.delete(index);
    this.known.set(index, found);
    found.catch(() => this.known.delete(index));
    this.forget();
    return found;
  }

  forget() {
    const size = (index) => {
      const { width, height } = this.shared.cameras[this.shared.frames[index].camera];
      return width * height;
    };
    let pixels = 0;
    [...this.known.keys()].reverse().forEach((index, age) => {
      pixels += size(index);
      if (age < 2 || pixels <= KEPT_PIXELS) return;
      this.known.get(index).then(this.released, () => {});
      this.known.delete(index);
    });
  }

  async read(index) {
    if (this.shared.folder === null) return JSON.parse(document.getElementById(`frame-${index}`).textContent);
    const script = document.createElement("script"), name = `${String(index).padStart(5, "0")}.js`;
    const place = `${encodeURIComponent(this.shared.folder)}/${name}`;
    const failed = new Error(`expected the file ${this.shared.folder}/${name} beside this page`);
    try {
      return await new Promise((resolve, reject) => {
        this.waiting.set(index, { resolve });
        script.onerror = () => reject(failed);
        script.onload = () => reject(failed); // after lookFrame, which has resolved it
        script.src = place;
        document.head.append(script);
      });
    } finally {
      this.waiting.delete(index);
      script.remove();
    }
  }

  async decoded(data, index) {
    const layers = {};
    await Promise.all(
      Object.entries(data.layers).map(async ([name, layer]) => {
        const values = layer.form === "picture" ? { bitmap: await bitmapOf(layer) } : await unpack(layer);
        layers[name] = { form: layer.form, ...values };
      }),
    );
    const camera = this.shared.cameras[this.shared.frames[index].camera];
    return { index, layers, boxes: data.boxes, layout: data.layout, marks: marksOf(layers, camera), textures: {} };
  }
}

// All marks of a pixel as bits of one number; null without any.
function marksOf(layers, { width, height }) {
  const named = Object.keys(layers).filter((name) => layers[name].form === "marks");
  if (!named.length) return null;
  const marks = new Uint8Array(width * height);
  for (const name of named) layers[name].data.forEach((each, i) => (marks[i] |= each && bitOf(name)));
  return marks;
}

// Layers of other modalities share a bit.
const bitOf = (name) => BITS[name] ?? 8;
