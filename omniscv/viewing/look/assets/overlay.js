// Lines over the images: layouts, boxes, the place that is read, captions, the divider.

const EDGE = { floor: "#ffbe28", ceiling: "#3cc8ff", vertical: "#6eff6e" };
const FAR_PX = 4; // from the wrap of a panorama: a line does not go across the whole image

class Overlay {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
  }

  clear(width, height, ratio) {
    if (this.canvas.width !== width * ratio || this.canvas.height !== height * ratio) Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, width, height);
  }

  // box: of the port, {x, y, width, height} from the upper left corner; clip alike.
  within(box, clip, draw) {
    const { pen } = this;
    pen.save();
    pen.beginPath();
    pen.rect(clip.x, clip.y, clip.width, clip.height);
    pen.clip();
    pen.translate(box.x + box.width / 2, box.y + box.height / 2);
    draw();
    pen.restore();
  }

  line(view, camera, pixels, color, width = 2, dash = []) {
    const { pen } = this;
    pen.beginPath();
    let before = null, last = 0;
    for (let i = 0; i < pixels.length; i += 2) {
      const place = placeOf(view, camera, pixels[i], pixels[i + 1]);
      const across = i > 0 && view.flat && camera.wraps && Math.abs(pixels[i] - last) > camera.width / FAR_PX;
      if (place && before && !across) pen.lineTo(...place);
      else if (place) pen.moveTo(...place);
      [before, last] = [place, pixels[i]];
    }
    pen.setLineDash([]);
    pen.lineJoin = "round";
    [pen.lineWidth, pen.strokeStyle] = [width + 2, "rgb(0 0 0 / .55)"];
    pen.stroke();
    pen.setLineDash(dash);
    [pen.lineWidth, pen.strokeStyle] = [width, color];
    pen.stroke();
    pen.setLineDash([]);
  }

  layout(view, camera, layout) {
    for (const edge of layout.edges) {
      if (!edge.room) this.line(view, camera, edge.line, "#8d949c", 1);
      else this.line(view, camera, edge.line, EDGE[edge.kind], 2, edge.seen ? [] : [5, 6]);
    }
    for (const { kind, room, seen, pixel } of layout.corners) {
      const place = placeOf(view, camera, ...pixel), { pen } = this;
      if (!place) continue;
      pen.beginPath();
      pen.arc(...place, 5, 0, 2 * Math.PI);
      [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [seen && room ? EDGE[kind] : "#0d1014", room ? EDGE[kind] : "#8d949c", 2];
      pen.fill();
      pen.stroke();
    }
  }

  boxes(view, camera, boxes, colors) {
    for (const { id, name, lines } of boxes) {
      const color = colors[id]?.color ?? "#e9edf2";
      for (const line of lines) this.line(view, camera, line, color, 1.6);
      this.name(view, camera, lines, name, color);
    }
  }

  // A name at the highest point that is shown.
  name(view, camera, lines, name, color) {
    let best = null;
    for (const line of lines) {
      for (let i = 0; i < line.length; i += 2) {
        const place = placeOf(view, camera, line[i], line[i + 1]);
        if (place && (!best || place[0] + place[1] < best[0] + best[1])) best = place;
      }
    }
    if (best) this.label(name, best[0] + 2, best[1] - 6, color);
  }

  // A text on a dark ground, with a bar in a colour before it.
  label(text, x, y, color = null) {
    const { pen } = this;
    pen.font = "600 12px system-ui, sans-serif";
    const width = pen.measureText(text).width;
    pen.fillStyle = "rgb(13 16 20 / .78)";
    pen.beginPath();
    pen.roundRect(x - 7, y - 13, width + 13, 18, 5);
    pen.fill();
    if (color) {
      pen.fillStyle = color;
      pen.fillRect(x - 7, y - 11, 3, 14);
    }
    pen.fillStyle = "#e9edf2";
    pen.fillText(text, x, y);
  }

  cross(x, y, strong) {
    const { pen } = this, size = strong ? 9 : 7;
    for (const [width, color] of [[3.5, "rgb(0 0 0 / .6)"], [1.5, strong ? "#7cc0ff" : "rgb(255 255 255 / .85)"]]) {
      pen.beginPath();
      for (const [a, b] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        pen.moveTo(x + 3 * a, y + 3 * b);
        pen.lineTo(x + size * a, y + size * b);
      }
      [pen.lineWidth, pen.strokeStyle] = [width, color];
      pen.stroke();
    }
  }

  divider(x, height) {
    const { pen } = this;
    pen.fillStyle = "#e9edf2";
    pen.fillRect(x - 1, 0, 2, height);
    pen.beginPath();
    pen.roundRect(x - 13, height / 2 - 20, 26, 40, 9);
    pen.fill();
    pen.fillStyle = "#151a20";
    for (const side of [-1, 1]) {
      pen.beginPath();
      pen.moveTo(x + 9 * side, height / 2);
      pen.lineTo(x + 3 * side, height / 2 - 6);
      pen.lineTo(x + 3 * side, height / 2 + 6);
      pen.fill();
    }
  }
}
