// Where the stage looks: angles in the world for spheres, a place in the image for flat ones; and the panes.

const WIDEST = { false: 130, true: 340 };

class View {
  constructor() {
    Object.assign(this, { yaw: 0, pitch: 0, fov: 80, flat: false, planet: false, u: 0.5, v: 0.5, zoom: 1 });
  }

  // What a port of a size shows of a camera: plane is [u, v at the middle, image px in a px of the screen].
  of(camera, rotation, width, height) {
    const flat = this.flat || !camera.spherical;
    const R_w_v = viewRotation(this.yaw, this.pitch);
    const fit = Math.max(camera.width / width, camera.height / height);
    return {
      flat, R_w_v, R_c_v: product(transposed(rotation), R_w_v),
      projection: new Projection(this.fov, this.planet, width, height),
      plane: [this.u * camera.width, this.v * camera.height, fit / this.zoom],
    };
  }

  turn(dx, dy, view) {
    if (view.flat) return;
    const perPixel = (RADIAN / view.projection.focal) * (this.planet ? 0.8 : 1);
    this.yaw = ((((this.yaw + dx * perPixel + 180) % 360) + 360) % 360) - 180;
    this.pitch = clamp(this.pitch + dy * perPixel, -90, 90);
  }

  shift(dx, dy, view, camera) {
    this.u = clamp(this.u - (dx * view.plane[2]) / camera.width, 0, 1);
    this.v = clamp(this.v - (dy * view.plane[2]) / camera.height, 0, 1);
  }

  // x, y: what stays where it is, px from the middle of the port.
  scale(factor, flat, x = 0, y = 0, view = null, camera = null) {
    if (!flat) {
      this.fov = clamp(this.fov / factor, 2, WIDEST[this.planet]);
      return;
    }
    const before = this.zoom;
    this.zoom = clamp(this.zoom * factor, 0.5, 400);
    if (!view) return;
    const gained = view.plane[2] * (1 - before / this.zoom);
    this.u = clamp(this.u + (x * gained) / camera.width, 0, 1);
    this.v = clamp(this.v + (y * gained) / camera.height, 0, 1);
  }

  setPlanet(on) {
    this.planet = on;
    Object.assign(this, on ? { fov: 250, pitch: -90, flat: false } : { fov: 80, pitch: clamp(this.pitch, -30, 30) });
  }
}

// The pixel that a pane shows at a place, px from the middle; {u, v, direction}: camera frame; null for none.
function pixelAt(view, camera, x, y) {
  if (!view.flat) {
    const direction = times(view.R_c_v, view.projection.ray(x, y)), pixel = camera.pixelOf(direction);
    return pixel && { u: pixel[0], v: pixel[1], direction };
  }
  const u = view.plane[0] + x * view.plane[2], v = view.plane[1] + y * view.plane[2];
  return camera.isValid(u, v) ? { u, v, direction: camera.rayOf(u, v)?.direction ?? null } : null;
}

// The place of a pixel in a port, px from its middle; null where it is not shown.
function placeOf(view, camera, u, v) {
  if (view.flat) return [(u - view.plane[0]) / view.plane[2], (v - view.plane[1]) / view.plane[2]];
  const ray = camera.rayOf(u, v);
  return ray && view.projection.point(times(transposed(view.R_c_v), ray.direction));
}
