"""Renders a scene inside Blender, as requests on the standard input say.

Blender's licence is the GNU GPL. This program runs inside Blender's process; omniscv starts it and talks to
it over pipes, and imports neither this folder nor anything of Blender. It needs Blender 5.0, the module
``bpy`` or the executable, and the NumPy that comes with them.

Frames each way: 4 bytes, the length, big endian, then so much JSON. ``MARK`` comes before the first one,
since Blender may have written to the standard output by then. Pictures go to files in the folder that
requests name.
"""

import json
import os
import queue
import shutil
import sys
import threading
from typing import IO, Any

import bpy  # type: ignore[import-not-found]
import numpy as np
from mathutils import Matrix  # type: ignore[import-not-found]
from numpy.typing import NDArray

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
import loading  # type: ignore[import-not-found]  # the file beside this one

MARK = b"\n--omniscv-blender-1--\n"
MOST_OBJECTS = 32_767  # what a pass index can be
CAMERA = "omniscv.camera"
Requests = queue.SimpleQueue[dict[str, Any]]


class World:
    """The opened scene.

    Attributes:
        ids: name of each object that pictures may show to its pass index.
        named: those names to the objects.
        metres: of a unit of the scene.
        viewer: where the scene's own camera is, in units; None without one.
    """

    def __init__(self, asked: dict[str, Any]) -> None:
        self.asked = asked
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=asked["path"], load_ui=False, use_scripts=False)
        self.scene = loading.chosen_scene(asked["scene"])
        bpy.context.window.scene = self.scene
        self.layer = next((each for each in self.scene.view_layers if each.use), self.scene.view_layers[0])
        bpy.context.window.view_layer = self.layer
        self.scene.frame_set(self.scene.frame_current if asked["frame"] is None else asked["frame"])
        self.metres = self.scene.unit_settings.scale_length
        loading.show_as_rendered(self.layer)
        loading.make_instances_real(self.scene)
        self.named = loading.named_objects(self.layer)
        if len(self.named) > MOST_OBJECTS:
            raise RuntimeError(f"expected at most {MOST_OBJECTS} objects, got {len(self.named)}")
        self.ids = {name: 1 + i for i, name in enumerate(sorted(self.named))}
        for each in bpy.data.objects:
            each.pass_index = 0
        for name, index in self.ids.items():
            self.named[name].pass_index = index
        self.hidden: set[str] = set()
        self.viewer = self.scene.camera and tuple(self.scene.camera.matrix_world.translation)
        self.camera = bpy.data.objects.new(CAMERA, bpy.data.cameras.new(CAMERA))
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        self.prepare()

    def description(self) -> dict[str, Any]:
        """Return what is known of the scene before anything is rendered."""
        paths = [bpy.path.abspath(each.filepath) for each in bpy.data.libraries]
        textures = [
            bpy.path.abspath(each.filepath, library=each.library)
            for each in bpy.data.images
            if each.source == "FILE" and not each.packed_file
        ]
        lights = [each for each in self.layer.objects if each.type == "LIGHT" and not each.hide_render]
        return {
            "scene": self.scene.name,
            "frame": self.scene.frame_current,
            "objects": self.ids,
            "world": self.scene.world is not None,
            "lights": len(lights),
            "metres": self.metres,
            "camera": None if self.viewer is None else [self.metres * each for each in self.viewer],
            "libraries": sorted(filter(os.path.isfile, paths)),
            "missing": sorted({each for each in (*paths, *textures) if not os.path.isfile(each)}),
        }

    def prepare(self) -> None:
        """Set what all renders have in common: pictures as they are, without anything drawn over them."""
        render, cycles = self.scene.render, self.scene.cycles
        render.engine = "CYCLES"
        render.resolution_percentage = 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        render.dither_intensity = 0
        render.use_file_extension = False
        render.use_persistent_data = True
        for switch in ("use_border", "use_multiview", "use_motion_blur", "use_freestyle", "use_stamp",
                       "use_compositing", "use_sequencer"):  # fmt: skip
            setattr(render, switch, False)
        for each in self.scene.view_layers:
            each.use = each == self.layer
        cycles.use_animated_seed = False
        cycles.seed = self.asked["seed"]
        use_device(self.scene, self.asked["device"])
        if self.asked["threads"]:
            render.threads_mode, render.threads = "FIXED", self.asked["threads"]
        self.look = {
            name: getattr(cycles, name) for name in ("pixel_filter_type", "filter_width", "max_bounces")
        }

    def render(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Render one view into a file: colours, or all data at the centres of the pixels."""
        self.hide(set(asked["hidden"]))
        self.aim(asked)
        file = os.path.join(asked["folder"], asked["file"])
        self.scene.render.filepath = file
        (self.set_colors if asked["kind"] == "lit" else self.set_data)()
        bpy.ops.render.render(write_still=True, scene=self.scene.name, layer=self.layer.name)
        if not os.path.exists(file):
            raise RuntimeError("Blender has rendered no picture")
        return {"metres": self.metres}

    def aim(self, asked: dict[str, Any]) -> None:
        """Set the camera: a pose from Blender's camera axes (x right, y up, z back) to its world."""
        data, render = self.camera.data, self.scene.render
        tangent = asked["tan_half_fov"]
        data.sensor_fit = "HORIZONTAL"
        data.lens = max(1.0, 18 / tangent)  # mm, at least 1
        data.sensor_width = 2 * data.lens * tangent
        data.clip_start, data.clip_end = (each / self.metres for each in self.asked["clip"])
        render.resolution_x, render.resolution_y = asked["size"]
        place = Matrix(asked["R_w_b"]).to_4x4()
        place.translation = [each / self.metres for each in asked["position"]]
        self.camera.matrix_world = place

    def set_data(self) -> None:
        """One sample at the centre of every pixel, without light."""
        cycles, render = self.scene.cycles, self.scene.render
        self.use_passes(combined=False)
        cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 1, False, False
        cycles.pixel_filter_type, cycles.filter_width, cycles.max_bounces = "BOX", 0.01, 0
        multi_layer_exr(render.image_settings)

    def set_colors(self) -> None:
        """As many samples as the address says, through the scene's pixel filter."""
        cycles, settings = self.scene.cycles, self.scene.render.image_settings
        self.use_passes(combined=True)
        for name, value in self.look.items():
            setattr(cycles, name, value)
        cycles.samples, cycles.use_adaptive_sampling = self.asked["samples"], False
        cycles.use_denoising = self.asked["denoiser"] != "none"
        if cycles.use_denoising:
            cycles.denoiser = self.asked["denoiser"].upper()
        if self.asked["lit"] == "float32":
            multi_layer_exr(settings)
            return
        settings.media_type, settings.file_format = "IMAGE", "PNG"
        settings.color_mode, settings.color_depth, settings.compression = "RGB", "8", 0

    def use_passes(self, combined: bool) -> None:
        """Render colours alone, or data alone."""
        for each in self.layer.bl_rna.properties:
            if each.identifier.startswith("use_pass_"):
                setattr(self.layer, each.identifier, False)
        self.layer.use_pass_combined = combined
        for name in () if combined else ("z", "normal", "object_index"):
            setattr(self.layer, f"use_pass_{name}", True)

    def hide(self, wanted: set[str]) -> None:
        """Hide objects from renders, and show the others again."""
        for name in wanted ^ self.hidden:
            self.named[name].hide_render = name in wanted
        self.hidden = wanted

    def boxes(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Return by object a box around its vertices in its own axes, instances in it included."""
        names = {index: name for name, index in self.ids.items()}
        points: dict[str, Any] = {}
        for each in evaluated().object_instances:
            name = names.get(each.object.pass_index)
            if name is not None and (found := vertices_of(each)) is not None:
                points.setdefault(name, []).append(found)
        return {
            "boxes": {
                name: self.box(np.concatenate(some), self.named[name].matrix_world)
                for name, some in points.items()
            }
        }

    def box(self, points: NDArray[np.float64], matrix: Any) -> list[Any]:
        """Return centre, axes in rows, and size, in metres."""
        axes = np.array(matrix.to_quaternion().to_matrix())
        along = points @ axes
        low, high = along.min(axis=0), along.max(axis=0)
        center = axes @ ((low + high) / 2)
        return [(self.metres * center).tolist(), axes.T.tolist(), (self.metres * (high - low)).tolist()]


def vertices_of(instance: Any) -> NDArray[np.float64] | None:
    """Return the vertices (N, 3) of an evaluated object in the world, in units; None where it has none."""
    each = instance.object
    if each.type in loading.MESHES:
        mesh = each.to_mesh()
        points = np.empty(3 * len(mesh.vertices) if mesh else 0, np.float32)
        if mesh:
            mesh.vertices.foreach_get("co", points)
        each.to_mesh_clear()
    else:
        points = np.array(each.bound_box, np.float32)
    matrix = np.array(instance.matrix_world)
    points = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return points if len(points) else None


def evaluated() -> Any:
    return bpy.context.evaluated_depsgraph_get()


def multi_layer_exr(settings: Any) -> None:
    settings.media_type, settings.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
    settings.color_depth, settings.exr_codec = "32", "NONE"


def use_device(scene: Any, device: str) -> None:
    """Render on the CPU, or on all devices of a kind, such as ``cuda``."""
    scene.cycles.device = "CPU" if device == "cpu" else "GPU"
    if device == "cpu":
        return
    preferences = bpy.context.preferences.addons["cycles"].preferences
    kind = device.upper()
    try:
        preferences.compute_device_type = kind
    except TypeError:
        raise RuntimeError(f"expected a device of kind {device}, which this Blender does not know") from None
    preferences.refresh_devices()
    for each in preferences.devices:
        each.use = each.type == kind
    if not any(each.use for each in preferences.devices):
        raise RuntimeError(f"expected a device of kind {device}, found none")


# -- the pipes ------------------------------------------------------------------------------------------


def main() -> None:
    """Answer requests until the input ends, which is when whoever started this is done, or gone."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what Blender prints goes nowhere
    replies.write(MARK)
    send(replies, {"version": list(bpy.app.version)})
    requests: Requests = queue.SimpleQueue()
    world: Any = None
    folders: set[str] = set()
    threading.Thread(target=read, args=(sys.stdin.buffer, requests, folders), daemon=True).start()
    while True:
        asked = requests.get()
        try:
            if asked["do"] == "open":
                world = World(asked)
                answer = world.description()
            else:
                answer = {"render": world.render, "boxes": world.boxes}[asked["do"]](asked)
        except (RuntimeError, MemoryError) as wrong:  # what Blender reports; all else ends this program
            answer = {"error": " ".join(str(wrong).split()) or type(wrong).__name__}
        send(replies, answer)


def read(stream: IO[bytes], requests: Requests, folders: set[str]) -> None:
    """Put requests in a queue. Their end ends this program at once, also in the middle of a picture, and
    removes the folders that they have named."""
    while len(head := stream.read(4)) == 4:
        asked = json.loads(stream.read(int.from_bytes(head, "big")))
        folders.add(asked["folder"])
        requests.put(asked)
    for each in folders:
        shutil.rmtree(each, ignore_errors=True)
    os._exit(0)


def send(stream: IO[bytes], message: dict[str, Any]) -> None:
    data = json.dumps(message).encode()
    stream.write(len(data).to_bytes(4, "big") + data)
    stream.flush()


if __name__ == "__main__":
    main()
