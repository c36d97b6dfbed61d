// Frames: world (X forward, Y left, Z up); camera and view (x right, y down, z forward). Matrices are lists of rows.

const RADIAN = 180 / Math.PI;
const LEVEL = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]];

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
const times = (M, v) => M.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const transposed = (M) => [0, 1, 2].map((i) => [M[0][i], M[1][i], M[2][i]]);
const product = (A, B) => transposed(transposed(B).map((column) => times(A, column)));

// R_w_v of a level view: yaw to the left, nose up, degrees.
function viewRotation(yaw, pitch) {
  const [a, b] = [yaw / RADIAN, pitch / RADIAN];
  const forward = [Math.cos(b) * Math.cos(a), Math.cos(b) * Math.sin(a), Math.sin(b)];
  const right = [Math.sin(a), -Math.cos(a), 0];
  const down = [
    forward[1] * right[2] - forward[2] * right[1],
    forward[2] * right[0] - forward[0] * right[2],
    forward[0] * right[1] - forward[1] * right[0],
  ];
  return transposed([right, down, forward]);
}

const anglesOf = (w) => [Math.atan2(w[1], w[0]) * RADIAN, Math.asin(clamp(w[2] / Math.hypot(...w), -1, 1)) * RADIAN];

// Between points of a port, px from its middle, and directions of the view; fov is across the shorter side.
class Projection {
  constructor(fov, stereographic, width, height) {
    const half = Math.min(width, height) / 2, angle = fov / 2 / RADIAN;
    this.stereographic = stereographic;
    this.focal = stereographic ? half / (2 * Math.tan(angle / 2)) : half / Math.tan(angle);
  }

  ray(x, y) {
    const [a, b] = [x / this.focal, y / this.focal], square = a * a + b * b;
    const z = this.stereographic ? 1 - square / 4 : 1, size = this.stereographic ? 1 + square / 4 : Math.sqrt(1 + square);
    return [a / size, b / size, z / size];
  }

  // null for what is behind, or too far out.
  point(d) {
    const depth = this.stereographic ? (1 + d[2]) / 2 : d[2];
    return depth < 0.02 ? null : [(this.focal * d[0]) / depth, (this.focal * d[1]) / depth];
  }
}
