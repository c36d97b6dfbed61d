"""Triton kernels that sample on a device. They do what the kernels of :mod:`omniscv.compose` do, in the same
order of operations, so that labels and depth agree to the bit: launch them with :data:`OPTIONS`.

A program has a block of rays of one image; those of the same rays follow each other.
"""

import triton
import triton.language as tl

OPTIONS = {"SIZE": 256, "num_warps": 4, "enable_fp_fusion": False}
"""Of a launch: rays of a program, and that products are rounded before they are added, as on a processor."""
OF_LOOK_UP = OPTIONS | {"SIZE": 64, "num_warps": 1}
"""Few rays of one warp: most views are left out."""


@triton.jit
def look_up(
    directions, turns, projections, view, x, y, unseen, count, images,
    VIEWS: tl.constexpr, BEYOND: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    """Write the view that sees each ray most centrally, and the point there; -1 where none does.

    Args:
        directions: (3, count) float64, NaN if not valid.
        turns: (images, VIEWS, 3, 3) float64, to the frames of views.
        projections: (VIEWS, 6) float64: fx, fy, cx and cy from the middle, half the width and height.
        view: (images, count) int16, written.
        x: (images, count) float32, written, px.
        y: (images, count) float32, written, px.
        unseen: () int32, to which the number of valid rays is added that no view sees.
        count: of the rays.
        images: of orientations.
        VIEWS: their number.
        BEYOND: half sizes of a view within which it sees rays.
        SIZE: rays of a program.
    """
    image, ray = tl.program_id(0) % images, tl.program_id(0) // images * SIZE + tl.arange(0, SIZE)
    inside = ray < count
    a = tl.load(directions + ray, inside, other=0.0)
    b = tl.load(directions + count + ray, inside, other=0.0)
    c = tl.load(directions + 2 * count + ray, inside, other=0.0)
    half_width, half_height = tl.load(projections + 4), tl.load(projections + 5)
    best, which = tl.full([SIZE], BEYOND, tl.float64), tl.full([SIZE], -1, tl.int32)
    best_u, best_v = tl.zeros([SIZE], tl.float64), tl.zeros([SIZE], tl.float64)
    for k in range(VIEWS):
        R, of = turns + 9 * (image * VIEWS + k), projections + 6 * k
        z = tl.load(R + 6) * a + tl.load(R + 7) * b + tl.load(R + 8) * c
        p = tl.load(of) * (tl.load(R) * a + tl.load(R + 1) * b + tl.load(R + 2) * c)
        q = tl.load(of + 1) * (tl.load(R + 3) * a + tl.load(R + 4) * b + tl.load(R + 5) * c)
        p, q = p + tl.load(of + 2) * z, q + tl.load(of + 3) * z
        # Divisions take longest: none where no ray of the block may lie nearer to this view's middle.
        farthest = best * z * BEYOND
        near = (z > 0) & (tl.abs(p) <= farthest * half_width) & (tl.abs(q) <= farthest * half_height)
        if tl.max(near.to(tl.int32)) > 0:
            u, v = p / z, q / z
            off = tl.maximum(tl.abs(u) / half_width, tl.abs(v) / half_height)
            better = near & (off < best)
            best, which = tl.where(better, off, best), tl.where(better, k, which)
            best_u, best_v = tl.where(better, u, best_u), tl.where(better, v, best_v)
    at = image.to(tl.int64) * count + ray
    tl.store(view + at, which, inside)
    tl.store(x + at, (best_u + half_width).to(tl.float32), inside)
    tl.store(y + at, (best_v + half_height).to(tl.float32), inside)
    missing = tl.sum((inside & (which < 0) & (a == a)).to(tl.int32))
    if missing > 0:
        tl.atomic_add(unseen, missing)


@triton.jit
def blend(
    picture, corners, view, x, y, out, count, images, width,
    CHANNELS: tl.constexpr, STEP: tl.constexpr, ROUND: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    """Write (images, CHANNELS, count) values between pixels, bilinear; 0 where no view sees the ray.

    Args:
        picture: (H, width, STEP), an atlas; a pixel is read at once.
        corners: (V, 2) int32, x and y of each view's first pixel in it.
        view: as :func:`look_up` writes it.
        x: as :func:`look_up` writes it.
        y: as :func:`look_up` writes it.
        out: (images, CHANNELS, count), written.
        count: of the rays.
        images: of orientations.
        width: of the atlas, px.
        CHANNELS: that are written.
        STEP: channels of the atlas, a power of two.
        ROUND: whether values become whole numbers.
        SIZE: rays of a program.
    """
    image, ray = tl.program_id(0) % images, tl.program_id(0) // images * SIZE + tl.arange(0, SIZE)
    inside, at = ray < count, image.to(tl.int64) * count + ray
    k = tl.load(view + at, inside, other=-1).to(tl.int32)
    across, down = tl.load(x + at, inside, other=0.0) - 0.5, tl.load(y + at, inside, other=0.0) - 0.5
    seen, column, row = k >= 0, tl.floor(across), tl.floor(down)
    s, t = (across - column)[:, None], (down - row)[:, None]
    c = column.to(tl.int32) + tl.load(corners + 2 * k, seen, other=0)
    r = row.to(tl.int32) + tl.load(corners + 2 * k + 1, seen, other=0)
    channel, seen = tl.arange(0, STEP)[None, :], seen[:, None]
    first = picture + ((r.to(tl.int64) * width + c) * STEP)[:, None] + channel
    below = first + width * STEP
    above_left = tl.load(first, seen, other=0).to(tl.float32)
    above_right = tl.load(first + STEP, seen, other=0).to(tl.float32)
    below_left = tl.load(below, seen, other=0).to(tl.float32)
    below_right = tl.load(below + STEP, seen, other=0).to(tl.float32)
    above = above_left + s * (above_right - above_left)
    value = above + t * (below_left + s * (below_right - below_left) - above)
    if ROUND:
        value = tl.floor(value + 0.5)
    to = out + (image.to(tl.int64) * CHANNELS * count + ray)[:, None] + channel.to(tl.int64) * count
    tl.store(to, value.to(out.dtype.element_ty), inside[:, None] & (channel < CHANNELS))


@triton.jit
def take(
    stack, projections, view, x, y, out, count, images, width, height,
    CHANNELS: tl.constexpr, ALONG: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    """Write (images, CHANNELS, count) values of the nearest pixels; 0 where no view sees the ray.

    Args:
        stack: (V, height, width, CHANNELS).
        projections: (V, 4) float64: fx, fy, cx, cy.
        view: as :func:`look_up` writes it.
        x: as :func:`look_up` writes it.
        y: as :func:`look_up` writes it.
        out: (images, CHANNELS, count), written.
        count: of the rays.
        images: of orientations.
        width: of a view, px.
        height: of a view, px.
        CHANNELS: of a pixel.
        ALONG: values are planar depth; write distances along the rays.
        SIZE: rays of a program.
    """
    image, ray = tl.program_id(0) % images, tl.program_id(0) // images * SIZE + tl.arange(0, SIZE)
    inside, at = ray < count, image.to(tl.int64) * count + ray
    k = tl.load(view + at, inside, other=-1).to(tl.int64)
    px, py = tl.load(x + at, inside, other=0.0), tl.load(y + at, inside, other=0.0)
    seen = k >= 0
    c = tl.minimum(tl.maximum(px.to(tl.int32), 0), width - 1)
    r = tl.minimum(tl.maximum(py.to(tl.int32), 0), height - 1)
    first = stack + ((k * height + r) * width + c) * CHANNELS
    for j in tl.static_range(CHANNELS):
        value = tl.load(first + j, seen, other=0)
        if ALONG:
            of = projections + 4 * k
            fx, fy = tl.load(of, seen, other=1.0), tl.load(of + 1, seen, other=1.0)
            u = (px.to(tl.float64) - tl.load(of + 2, seen, other=0.0)) / fx
            v = (py.to(tl.float64) - tl.load(of + 3, seen, other=0.0)) / fy
            value = value.to(tl.float64) * tl.sqrt(1.0 + u * u + v * v)
        to = out + (image.to(tl.int64) * CHANNELS + j) * count + ray
        tl.store(to, value.to(out.dtype.element_ty), inside)
