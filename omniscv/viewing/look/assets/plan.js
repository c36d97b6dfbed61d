// The plan: poses from above, X up and Y left, the room's floor, the view, and the point that is read.

class Plan {
  constructor(canvas, shared) {
    this.canvas = canvas;
    this.shared = shared;
    this.points = shared.frames.map(({ position }) => position);
  }

  // Metres to px; the px of a metre.
  fitted(floor, slice) {
    const all = [...this.points, ...floor, ...slice];
    const [xs, ys] = [0, 1].map((c) => all.map((each) => each[c]));
    const low = [Math.min(...xs), Math.min(...ys)], high = [Math.max(...xs), Math.max(...ys)];
    const { clientWidth: width, clientHeight: height } = this.canvas, room = 14;
    const scale = Math.min((height - 2 * room) / Math.max(1, high[0] - low[0]), (width - 2 * room) / Math.max(1, high[1] - low[1]));
    const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.place = ([x, y]) => [width / 2 - (y - middle[1]) * scale, height / 2 - (x - middle[0]) * scale];
    return scale;
  }

  draw({ index, group, rotation, yaw, halfView, floor, slice, hit }) {
    const { canvas } = this, ratio = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
    if (!canvas.clientWidth) return;
    Object.assign(canvas, { width: canvas.clientWidth * ratio, height: canvas.clientHeight * ratio });
    pen.scale(ratio, ratio);
    const scale = this.fitted(floor ?? [], slice);
    const all = (points) => points.map((each) => this.place(each));
    if (floor?.length) this.line(pen, all(floor), "#56616e", 1.5, "#1b222a");
    pen.fillStyle = "#6d7a88";
    for (const [x, y] of all(slice)) pen.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
    this.line(pen, all(group.map((each) => this.points[each])), "#3a4552", 1);
    const here = this.place(this.points[index]);
    this.wedge(pen, here, yaw, halfView);
    if (hit) {
      this.line(pen, [here, this.place(hit)], "#e69f00", 1.2);
      this.dot(pen, this.place(hit), 3, "#e69f00");
    }
    for (const each of group) this.dot(pen, this.place(this.points[each]), ...(each === index ? [5, "#7cc0ff"] : [3, "#8d98a5"]));
    this.heading(pen, here, rotation);
    this.bar(pen, scale);
  }

  // A line through places of the canvas, or an area.
  line(pen, places, color, width, fill = null) {
    pen.beginPath();
    places.forEach((place) => pen.lineTo(...place));
    [pen.strokeStyle, pen.lineWidth] = [color, width];
    if (fill) {
      pen.closePath();
      pen.fillStyle = fill;
      pen.fill();
    }
    pen.stroke();
  }

  dot(pen, place, size, color) {
    pen.beginPath();
    pen.arc(...place, size, 0, 2 * Math.PI);
    pen.fillStyle = color;
    pen.fill();
  }

  wedge(pen, [x, y], yaw, half) {
    const middle = -Math.PI / 2 - yaw / RADIAN, size = 46;
    const fill = pen.createRadialGradient(x, y, 0, x, y, size);
    fill.addColorStop(0, "rgb(124 192 255 / .55)");
    fill.addColorStop(1, "rgb(124 192 255 / 0)");
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, size, middle - half, middle + half);
    pen.fillStyle = fill;
    pen.fill();
  }

  // The frustum of the camera itself: the way its z axis points.
  heading(pen, [x, y], rotation) {
    const [dx, dy] = [-rotation[1][2], -rotation[0][2]], size = Math.hypot(dx, dy);
    if (size < 0.2) return; // up or down
    const [a, b] = [dx / size, dy / size];
    const ends = [[x + 15 * a - 7 * b, y + 15 * b + 7 * a], [x + 15 * a + 7 * b, y + 15 * b - 7 * a]];
    this.line(pen, [[x, y], ...ends, [x, y]], "#e9edf2", 1.4);
  }

  bar(pen, scale) {
    const metres = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 1e4, 1e5].find((each) => each * scale > 34) ?? 1e6;
    const [left, low] = [10, this.canvas.clientHeight - 10];
    [pen.fillStyle, pen.font] = ["#9aa5b3", "11px system-ui, sans-serif"];
    pen.fillRect(left, low, metres * scale, 2);
    pen.fillText(`${metres} m`, left, low - 5);
  }

  // The frame of a group nearest to a place of the canvas.
  nearest(x, y, group) {
    const far = (index) => Math.hypot(...this.place(this.points[index]).map((each, c) => each - [x, y][c]));
    const best = group.reduce((a, b) => (far(b) < far(a) ? b : a));
    return far(best) < 24 ? best : null;
  }
}
