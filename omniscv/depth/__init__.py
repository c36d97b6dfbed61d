"""What captured pictures say of surfaces: depth, labels and normals along rays, and how far they may be off.

Every image pixel asks one question of this package: *what does my ray meet?* Three answers exist, and all
are given as one class, :class:`~omniscv.depth.hits.KnownDepth`:

- **sampled**: the ray starts at the centre of the captures. The picture is read at the ray's own pixel
  (:mod:`~omniscv.depth.ray_lookup`, :mod:`~omniscv.depth.depth_pictures`).
- **marched**: the ray starts elsewhere. It is followed through the depth that a centre captured, until it
  meets a surface or passes behind one (:mod:`~omniscv.depth.depth_shell`,
  :mod:`~omniscv.depth.ray_marching`). The result is a :class:`~omniscv.depth.hits.Hits`; several centres
  narrow each other's doubt (``Hits.narrow``), and ``Hits.known_depth`` turns it into a ``KnownDepth``.
- **seen from elsewhere**: recordings made with ``viewpoints: N`` compare what is seen from several centres
  (:mod:`omniscv.compose.seen_points`).

What a bound is made of
-----------------------

``KnownDepth.error`` bounds ``|distance - true distance|`` along the ray, in metres. It is a sum:

1. *Rounding.* Stored depth has digits, a unit and perhaps a greatest value
   (:class:`omniscv.geometry.precision.Precision`). Rounding is half a step of what was stored.
2. *Bending.* Inverse planar depth is linear in the pixel on a plane, so interpolation of it is exact there
   (:mod:`~omniscv.depth.surfaces`). Its second differences say how far a surface bends between pixels;
   rounding is allowed for before a difference counts as a bend.
3. *Edges.* Neighbours that do not continue each other show two surfaces. Nothing is interpolated across:
   the nearest pixel's surface is continued by its own slope, and the step between both surfaces is added.
4. *Relief.* Bars, teeth, leaves and wires may be finer than the pixels. Patterns of second differences and
   of labels are signs of it (:mod:`~omniscv.depth.relief`); then the bound is what the neighbourhood
   reaches.
5. *What captures say.* Lossy or fitted depth comes with its own bound, pixel by pixel; it is added.
6. *Parallax.* A ray that starts off the centre meets a plane elsewhere: the plane's slope times the offset.
   Near an edge, within the parallax, it may meet the other surface: the depths around are added. A marched
   ray has, instead of these, the parts of its way that no centre sees: a short part widens the bound, a
   long one makes the pixel *unsure*.

The bound is infinite where nothing bounds it, and 0 for the sky where depth reaches to infinity. A depth is
*in doubt* where its bound exceeds :data:`~omniscv.depth.hits.DOUBTFUL` of it.

What a picture cannot show is not in a bound: a thing narrower than a pixel that no pixel meets. ``checks:
beat`` captures in a second size to find it, and the page on accuracy gives figures.

Labels are never blended. A label is that of the nearest pixel, in doubt within a pixel of a boundary, where
relief is, and where parallax reaches a boundary (:mod:`~omniscv.depth.nearest`). Colours are interpolated
(:mod:`~omniscv.depth.interpolation`).
"""
