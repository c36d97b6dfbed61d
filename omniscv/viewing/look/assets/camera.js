// A camera: directions of its frame to pixels and back, by the tables of directions.py.

class LookCamera {
  constructor(described) {
    Object.assign(this, described);
    this.closed = this.sphere === "closed";
    this.spherical = this.sphere !== null;
  }

  async load() {
    if (this.valid) this.valid = (await unpack(this.valid)).data;
    if (this.rays) {
      this.back = await unpack(this.rays.directions);
      this.origins = this.rays.origins && (await unpack(this.rays.origins)).data;
    }
    if (this.spherical && !this.closed) {
      const { nodes, kinds, tables } = this.sphere;
      this.nodes = this.pixels((await unpack(nodes)).data, nodes.shape[1] * nodes.shape[2]);
      this.kinds = (await unpack(kinds)).data;
      this.tables = this.pixels((await unpack(tables)).data, 2048 * Math.max(1, Math.ceil((tables.shape[1] * tables.shape[2]) / 2048)));
      this.sphere = { cells: this.sphere.cells, fine: this.sphere.fine };
    }
    return this;
  }

  // Fixed point to px, -1 for none, with room for so many pixels.
  pixels(fixed, count) {
    const found = new Float32Array(2 * count).fill(-1);
    for (let i = 0; i < fixed.length; i++) if (fixed[i]) found[i] = (fixed[i] - 1) / this.sphere.perPixel;
    return found;
  }

  isValid(u, v) {
    if (!(u >= 0 && v >= 0 && u < this.width && v < this.height)) return false;
    return !this.valid || this.valid[Math.floor(v) * this.width + Math.floor(u)] > 0;
  }

  // The pixel [u, v] that sees a direction of the camera's frame; null for none.
  pixelOf(d) {
    if (!this.spherical) return null;
    const found = this.closed ? this.closedPixel(d) : this.tablePixel(d);
    if (!found) return null;
    const [u, v] = [clamp(found[0], 0, this.width - 1e-6), clamp(found[1], 0, this.height - 1e-6)];
    return this.isValid(u, v) ? [u, v] : null;
  }

  closedPixel(d) {
    const u = Math.atan2(d[0], d[2]) / (2 * Math.PI) + 0.5, v = 0.5 + Math.asin(clamp(d[1], -1, 1)) / Math.PI;
    return [u * this.width, v * this.height];
  }

  tablePixel(d) {
    const [x, y, z] = d.map(Math.abs), axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2, size = Math.abs(d[axis]);
    const face = 2 * axis + (d[axis] < 0 ? 1 : 0), N = this.sphere.cells, fine = this.sphere.fine;
    const a = (d[(axis + 1) % 3] / size + 1) * 0.5 * N, b = (d[(axis + 2) % 3] / size + 1) * 0.5 * N;
    const i = clamp(Math.floor(a), 0, N - 1), j = clamp(Math.floor(b), 0, N - 1), [s, t] = [a - i, b - j];
    const kind = this.kinds[(face * N + j) * N + i];
    if (kind === 0) return null;
    if (kind === 1) {
      const first = 2 * ((face * (N + 1) + j) * (N + 1) + i), below = first + 2 * (N + 1), n = this.nodes;
      return [0, 1].map((c) => (n[first + c] * (1 - s) + n[first + 2 + c] * s) * (1 - t) + (n[below + c] * (1 - s) + n[below + 2 + c] * s) * t);
    }
    const row = clamp(Math.floor(t * fine), 0, fine - 1), column = clamp(Math.floor(s * fine), 0, fine - 1);
    const at = 2 * (((kind - 2) * fine + row) * fine + column);
    return this.tables[at] < 0 ? null : [this.tables[at], this.tables[at + 1]];
  }

  // {direction, origin} of a pixel, camera frame; null for none.
  rayOf(u, v) {
    if (this.closed || !this.rays) {
      const a = ((2 * u) / this.width - 1) * Math.PI, b = (0.5 - v / this.height) * Math.PI;
      return { direction: [Math.cos(b) * Math.sin(a), -Math.sin(b), Math.cos(b) * Math.cos(a)], origin: [0, 0, 0] };
    }
    const { width, height } = this.back, step = this.rays.step;
    const x = clamp((u - 0.5) / step, 0, width - 1), y = clamp((v - 0.5) / step, 0, height - 1);
    const near = this.node(Math.round(x), Math.round(y));
    const [i, j] = [Math.min(Math.floor(x), width - 2), Math.min(Math.floor(y), height - 2)];
    if (i < 0 || j < 0) return near;
    const corners = [this.node(i, j), this.node(i + 1, j), this.node(i, j + 1), this.node(i + 1, j + 1)];
    // Interpolated where all four exist and turn as little as neighbours do: not across seams.
    if (corners.some((each) => !each || dot(each.direction, corners[0].direction) < 0.9)) return near ?? corners.find(Boolean) ?? null;
    const [s, t] = [x - i, y - j], shares = [(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t];
    const mean = (key) => [0, 1, 2].map((c) => shares.reduce((sum, share, k) => sum + share * corners[k][key][c], 0));
    const direction = mean("direction"), size = Math.hypot(...direction);
    return { direction: direction.map((each) => each / size), origin: mean("origin") };
  }

  node(i, j) {
    const at = 3 * (j * this.back.width + i), d = this.back.data;
    if (!(d[at] || d[at + 1] || d[at + 2])) return null;
    const size = Math.hypot(d[at], d[at + 1], d[at + 2]);
    const origin = this.origins ? [this.origins[at], this.origins[at + 1], this.origins[at + 2]] : [0, 0, 0];
    return { direction: [d[at] / size, d[at + 1] / size, d[at + 2] / size], origin };
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
