"""Compiles most kernels into the cache on disk, once: else each worker of pytest compiles all of them."""

import omniscv
from omniscv.planning import ImageRays

MODES = ("lit", "object_mask", "depth", "normals")
POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)


def main() -> None:
    """Renders a tiny image of every model, some with every filter, with colours in bytes and in floats, and
    some with finer views."""
    with omniscv.open_source("scene://four-wall") as source:
        for name in omniscv.cameras.names():
            camera = omniscv.cameras.model(name).example(16)
            one_way = camera.central or ImageRays(camera).scattered
            for strategy in ("auto",) if one_way else ("auto", "exact"):
                omniscv.render(camera, POSE, source, MODES, strategy=strategy, face_size=16)
        ring = omniscv.cameras.create("noncentral-panorama", width=16, height=8, radius=1.0)
        for camera in (omniscv.cameras.model("equirectangular").example(32), ring):
            omniscv.render(camera, POSE, source, MODES, accuracy=0.001, most_captures=60)
    for address in ("scene://four-wall", "scene://four-wall?lit=float32", "mock://four-wall"):
        with omniscv.open_source(address) as source:
            for filter in ("nearest", "bilinear", "bicubic", "area"):
                omniscv.render(camera, POSE, source, MODES, face_size=16, filter=filter, normals="from-depth")


if __name__ == "__main__":
    main()
