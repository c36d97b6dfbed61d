"""Compiles most kernels into the cache on disk, once: else each worker of pytest compiles all of them."""

import omniscv

MODES = ("lit", "object_mask", "depth", "normals")


def main() -> None:
    """Renders a tiny image of every model, and one with every filter."""
    pose = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)
    with omniscv.open_source("scene://four-wall") as source:
        for name in omniscv.cameras.names():
            camera = omniscv.cameras.model(name).example(16)
            for strategy in ("auto",) if camera.central else ("auto", "adaptive"):
                omniscv.render(camera, pose, source, MODES, strategy=strategy, face_size=16)
        for filter in ("nearest", "bilinear", "bicubic", "area"):
            omniscv.render(camera, pose, source, MODES, face_size=16, filter=filter)


if __name__ == "__main__":
    main()
