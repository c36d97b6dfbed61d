"""Another package: a camera, a source, a strategy, a modality and its source, an exporter of images, and of
datasets a truth and a format.

Each is written as an outsider would, with public names alone, and in at most 40 lines.
"""

import numpy as np

from omniscv import cameras, dataset, modalities, planning, sources
from omniscv.compose import files
from omniscv.planning import face_viewpoints


# -- a camera ----------------------------------------------------------------------------------------
@cameras.register
class Lambert(cameras.Camera):
    """A panorama with equal steps of height: ``theta = (2u/W - 1) pi``, ``sin phi = 1 - 2v/H`` (Lambert).

    Domain: every pixel, every direction. Source: Lambert's cylindrical equal-area projection, 1772.
    """

    name = "lambert"
    has_center = False

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)

    @classmethod
    def example(cls, width: int = 512) -> "Lambert":
        return cls(width, width // 3)

    def _unproject(self, pixels):
        theta = (2 * pixels[..., 0] / self.width - 1) * np.pi
        up = 1 - 2 * pixels[..., 1] / self.height
        level = np.sqrt((1 - up) * (1 + up))
        directions = np.stack([level * np.sin(theta), -up, level * np.cos(theta)], axis=-1)
        return np.zeros_like(directions), directions, np.ones(up.shape, bool)

    def _project(self, points):
        x, y, z = np.moveaxis(points / np.linalg.norm(points, axis=-1, keepdims=True), -1, 0)
        u = (np.arctan2(x, z) / np.pi + 1) * self.width / 2
        return np.stack([u, (1 + y) * self.height / 2], axis=-1), np.ones(u.shape, bool)


# -- a source ----------------------------------------------------------------------------------------
class Checkerboard(sources.Source):
    """A sphere of 5 m around the origin, with squares of ten degrees; masks are instance ids."""

    capabilities = sources.Capabilities(modes=frozenset({"lit", "object_mask", "depth"}), dialect="checker")

    def objects(self):
        return sources.ObjectTable({}, ids={"Dark": 7, "Light": 9})

    def capture(self, requests):
        for request in requests:
            view = request.view
            v, u = np.mgrid[: view.height, : view.width] + 0.5
            rays = np.stack([u - view.width / 2, v - view.height / 2, np.full(u.shape, view.focal_px)], -1)
            x, y, z = np.moveaxis(rays @ view.pose.R_w_c.T, -1, 0)
            squares = (
                np.arctan2(y, x) // np.radians(10) + np.arctan2(z, np.hypot(x, y)) // np.radians(10)
            ) % 2
            pixels = {
                "lit": np.repeat(np.where(squares, 220, 40).astype(np.uint8)[..., None], 3, axis=-1),
                "object_mask": np.where(squares, 9, 7).astype(np.uint16),
                "depth": (5 / view.ray_lengths()).astype(np.float32),
            }[request.mode]
            yield sources.Capture(request, view, pixels, {"scene": "checkerboard"})


def open_checkerboard(address):
    """``checker://``"""
    return Checkerboard()


sources.register("checker", open_checkerboard)


# -- a strategy --------------------------------------------------------------------------------------
@planning.register
class DepthFirst(planning.Strategy):
    """Faces in two rounds: depth, that the strategy is sent, then all that the image needs."""

    name = "depth-first"
    nearest = None

    def rounds(self, task):
        viewpoints = face_viewpoints(task, task.groups(), None)
        first = viewpoints[0]
        kept = yield planning.Round(
            (planning.Viewpoint(first.center_w, first.views, first.pixels[:0], ("depth",), keep=True),)
        )
        if kept is not None:
            DepthFirst.nearest = min(float(capture.pixels.min()) for capture in kept[0]["depth"])
        yield planning.Round(viewpoints)


# -- a modality and its source -----------------------------------------------------------------------
modalities.register(
    modalities.Modality("roughness", ("float32",), 0, "blended", "exr", ("Y",), outside=-1.0, doc="0 to 1")
)


class Rough(sources.SourceWrapper):
    """Another source, and how rough its surfaces are: 0.5 everywhere."""

    @property
    def capabilities(self):
        return sources.Capabilities(modes=self._source.capabilities.modes | {"roughness"})

    def capture(self, requests):
        for request in requests:
            if request.mode != "roughness":
                yield from self._source.capture([request])
                continue
            size = (request.view.height, request.view.width)
            yield sources.Capture(request, request.view, np.full(size, 0.5, np.float32))


sources.register("rough", lambda address: Rough(sources.open_source(address.removeprefix("rough:"))))


# -- an exporter of images ---------------------------------------------------------------------------
def write_ppm(path, pixels, row):
    """A colour layer as a portable pixmap."""
    height, width, _ = pixels.shape
    path.write_bytes(b"P6 %d %d 255\n" % (width, height) + np.ascontiguousarray(pixels).tobytes())


files.register("ppm", write_ppm)


# -- a truth of datasets -----------------------------------------------------------------------------
def brightness(observation, options):
    """The mean colour of each object that is seen, scaled by an option."""
    lit, labels = observation.image.lit, observation.labels
    return [
        {
            "instance_id": instance,
            "name": name,
            "mean": options.get("scale", 1.0) * float(lit[labels == instance].mean()),
        }
        for name, instance in observation.instances.items()
        if (labels == instance).any()
    ]


dataset.register_truth(dataset.Truth("brightness", brightness, needs=("lit", "labels")))


# -- a format of datasets ----------------------------------------------------------------------------
class Table:
    """``table.csv``: a line of key, object and brightness for each record."""

    name = "table"
    needs = ("truth",)

    def refuses(self, camera):
        return None if camera.central else "its pixels have several origins"

    def write(self, frames, out, options):
        rows = [(frame.key, each) for frame in frames for each in frame.truth["brightness"]]
        lines = [f"{key},{each['name']},{each['mean']:.2f}" for key, each in rows]
        (out / "table.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return [out / "table.csv"]


dataset.register(Table())
