"""Renders a scene inside Blender, as requests on the standard input say.

Blender's licence is the GNU GPL. This program runs inside Blender's process: omniscv talks to it over pipes,
and imports nothing of it. It needs Blender 5.0, or ``bpy``, and the NumPy that comes with them.

Frames each way: 4 bytes, the length, big endian, then so much JSON; ``MARK`` comes before the first one.
Pictures go to files in the folder that requests name.
"""

import json
import math
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

sys.path.append(os.path.dirname(os.path.abspath(__file__)))  # Blender knows nothing of omniscv

from inside_scene import (  # type: ignore[import-not-found]
    make_instances_real,
    named_objects,
    select_scene,
    show_as_rendered,
    vertices_of,
)

MARK = b"\n--omniscv-blender-1--\n"
MOST_OBJECTS = 32_767  # what a pass index can be
CAMERA = "omniscv.camera"
Message = dict[str, Any]


class World:
    """The opened scene.

    Attributes:
        ids: name of each object that pictures may show to its pass index.
        named: those names to the objects.
        metres: of a unit of the scene.
        viewer: where the scene's own camera is, in units; None without one.
    """

    def __init__(self, settings: Message) -> None:
        self.settings = settings
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=settings["path"], load_ui=False, use_scripts=False)
        self.scene = select_scene(settings["scene"])
        bpy.context.window.scene = self.scene
        self.layer = rendered_layer(self.scene)
        bpy.context.window.view_layer = self.layer
        self.scene.frame_set(self.scene.frame_current if settings["frame"] is None else settings["frame"])
        self.metres = self.scene.unit_settings.scale_length
        show_as_rendered(self.layer)
        make_instances_real(self.scene)
        self.number_objects()
        self.hidden: set[str] = set()
        self.moved: set[str] = set()
        self.undo: list[tuple[Any, str, Any]] = []  # what draws have changed: owner, attribute, value before
        self.sockets = settings_of(self.scene, self.layer, self.named.values())
        self.viewer = None
        if self.scene.camera:
            self.viewer = tuple(self.scene.camera.matrix_world.translation)
        self.camera = bpy.data.objects.new(CAMERA, bpy.data.cameras.new(CAMERA))
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        self.prepare()

    def number_objects(self) -> None:
        """Give each object that pictures may show a pass index, and note where it is."""
        self.named = named_objects(self.layer)
        if len(self.named) > MOST_OBJECTS:
            raise RuntimeError(f"expected at most {MOST_OBJECTS} objects, got {len(self.named)}")
        for item in bpy.data.objects:
            item.pass_index = 0
        self.ids: dict[str, int] = {}
        self.described: dict[str, Any] = {}  # the world matrices of objects as the file has them
        for index, name in enumerate(sorted(self.named), start=1):
            self.ids[name] = index
            self.named[name].pass_index = index
            self.described[name] = self.named[name].matrix_world.copy()

    def description(self) -> Message:
        """Return what is known of the scene before anything is rendered."""
        libraries = [bpy.path.abspath(item.filepath) for item in bpy.data.libraries]
        files = set(libraries)
        for image in bpy.data.images:
            if image.source == "FILE" and not image.packed_file:
                files.add(bpy.path.abspath(image.filepath, library=image.library))
        return {
            "scene": self.scene.name,
            "frame": self.scene.frame_current,
            "objects": self.ids,
            "world": self.scene.world is not None,
            "lights": sizes_of(self.sockets["lights"]),
            "materials": sizes_of(self.sockets["materials"]),
            "metres": self.metres,
            "transfer": self.transfer(),
            "camera": None if self.viewer is None else [self.metres * x for x in self.viewer],
            "libraries": sorted(filter(os.path.isfile, libraries)),
            "missing": sorted(path for path in files if not os.path.isfile(path)),
        }

    def transfer(self) -> str:
        """Return what 8-bit colours say of light: known of view transforms that change no contrast."""
        view = self.scene.view_settings
        display = self.scene.display_settings.display_device
        changed = view.look != "None" or view.gamma != 1 or view.use_curve_mapping or display != "sRGB"
        known = {} if changed else {"Standard": "srgb", "Raw": "linear"}
        return known.get(view.view_transform, "unknown")

    def prepare(self) -> None:
        """Set what all renders have in common: pictures as they are, without anything drawn over them."""
        render = self.scene.render
        cycles = self.scene.cycles
        render.engine = "CYCLES"
        render.resolution_percentage = 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        render.dither_intensity = 0
        render.use_file_extension = False
        render.use_persistent_data = True
        for switch in ("use_border", "use_multiview", "use_motion_blur", "use_freestyle", "use_stamp",
                       "use_compositing", "use_sequencer"):  # fmt: skip
            setattr(render, switch, False)
        for layer in self.scene.view_layers:
            layer.use = layer == self.layer
        cycles.use_animated_seed = False
        cycles.seed = self.settings["seed"]
        use_device(self.scene, self.settings["device"])
        if self.settings["threads"]:
            render.threads_mode = "FIXED"
            render.threads = self.settings["threads"]
        names = ("pixel_filter_type", "filter_width", "max_bounces")
        self.look = {name: getattr(cycles, name) for name in names}

    def render(self, request: Message) -> Message:
        """Render one view into a file: colours, or all data at the centres of the pixels."""
        self.change(request)
        self.aim(request)
        file = os.path.join(request["folder"], request["file"])
        self.scene.render.filepath = file
        if request["kind"] == "lit":
            self.set_colors()
        else:
            self.set_data()
        bpy.ops.render.render(write_still=True, scene=self.scene.name, layer=self.layer.name)
        if not os.path.exists(file):
            raise RuntimeError("Blender has rendered no picture")
        return {"metres": self.metres}

    def aim(self, request: Message) -> None:
        """Set the camera: a pose from Blender's camera axes (x right, y up, z back) to its world."""
        data = self.camera.data
        render = self.scene.render
        tangent = request["tan_half_fov"]
        data.sensor_fit = "HORIZONTAL"
        data.lens = max(1.0, 18 / tangent)  # mm, at least 1
        data.sensor_width = 2 * data.lens * tangent
        near_m, far_m = self.settings["clip"]
        data.clip_start = near_m / self.metres
        data.clip_end = far_m / self.metres
        render.resolution_x, render.resolution_y = request["size"]
        pose = Matrix(request["R_w_b"]).to_4x4()
        pose.translation = [x / self.metres for x in request["position"]]
        self.camera.matrix_world = pose

    def set_data(self) -> None:
        """One sample at the centre of every pixel, without light; Blender knows no filter below 0.01 px."""
        cycles = self.scene.cycles
        self.use_passes("z", "normal", "object_index")
        cycles.samples = 1
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = False
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 0.01
        cycles.max_bounces = 0
        multi_layer_exr(self.scene.render.image_settings)

    def set_colors(self) -> None:
        """As many samples as the address says, through the scene's pixel filter."""
        cycles = self.scene.cycles
        image = self.scene.render.image_settings
        self.use_passes("combined")
        for name, value in self.look.items():
            setattr(cycles, name, value)
        cycles.samples = self.settings["samples"]
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = self.settings["denoiser"] != "none"
        if cycles.use_denoising:
            cycles.denoiser = self.settings["denoiser"].upper()
        if self.settings["lit"] == "float32":
            multi_layer_exr(image)
            return
        image.media_type = "IMAGE"
        image.file_format = "PNG"
        image.color_mode = "RGB"
        image.color_depth = "8"
        image.compression = 0

    def use_passes(self, *names: str) -> None:
        """Render only these passes."""
        for setting in self.layer.bl_rna.properties:
            if setting.identifier.startswith("use_pass_"):
                setattr(self.layer, setting.identifier, False)
        for name in names:
            setattr(self.layer, f"use_pass_{name}", True)

    def change(self, request: Message) -> None:
        """Hide and place objects, and set lights and materials; whatever was changed before is put back."""
        hidden = set(request["hidden"])
        poses = request["poses"]
        for name in hidden ^ self.hidden:
            self.named[name].hide_render = name in hidden
        for name in sorted(self.moved | poses.keys()):
            place(self.named[name], self.described[name], poses.get(name), self.metres)
        self.hidden = hidden
        self.moved = set(poses)
        for owner, attribute, value in reversed(self.undo):
            setattr(owner, attribute, value)
        self.undo = []
        for kind, by_name in self.sockets.items():
            for name, settings in request["varied"].get(kind, {}).items():
                for key, value in settings.items():
                    self.set(*by_name[name][key], value)
        bpy.context.view_layer.update()

    def set(self, owner: Any, attribute: str, value: Any) -> None:
        """Set an ``attribute`` of its ``owner``: a value, or a vector's first ones.

        Colours of shaders have an alpha, which stays; angles are degrees.
        """
        before = getattr(owner, attribute)
        if not isinstance(before, float):
            before = tuple(before)
            value = (*value, *before[len(value) :])
        self.undo.append((owner, attribute, before))
        if attribute == "temperature":
            self.undo.append((owner, "use_temperature", owner.use_temperature))
            owner.use_temperature = True
        if attribute == "angle":
            value = math.radians(value)
        setattr(owner, attribute, value)

    def boxes(self, request: Message) -> Message:
        """Return by object its place, and a box around its vertices in its own axes, instances included."""
        self.change(request)
        names = {index: name for name, index in self.ids.items()}
        points: dict[str, Any] = {}
        for instance in bpy.context.evaluated_depsgraph_get().object_instances:
            name = names.get(instance.object.pass_index)
            if name is not None and len(vertices := vertices_of(instance)):
                points.setdefault(name, []).append(vertices)
        places = {}
        for name, item in self.named.items():
            places[name] = [self.metres * x for x in item.matrix_world.translation]
        boxes = {}
        for name, parts in points.items():
            boxes[name] = self.box(np.concatenate(parts), self.named[name].matrix_world)
        return {"places": places, "boxes": boxes}

    def box(self, points: NDArray[np.float64], matrix: Any) -> list[Any]:
        """Return centre, axes in rows, and size of a box, in metres.

        It is around ``points`` (N, 3), in units of the scene, along the axes of an object's world ``matrix``.
        """
        axes = np.array(matrix.to_quaternion().to_matrix())
        along = points @ axes
        low = along.min(axis=0)
        high = along.max(axis=0)
        center = axes @ ((low + high) / 2)
        return [(self.metres * center).tolist(), axes.T.tolist(), (self.metres * (high - low)).tolist()]


LIGHT = {"power": "energy", "kelvin": "temperature", "color": "color", "angle_deg": "angle"}
"""Attributes of lights by the names that jobs have for them."""

Settings = dict[str, tuple[Any, str]]
"""By the name of a setting, its owner and attribute."""


def rendered_layer(scene: Any) -> Any:
    """Return the first view layer that is used; the first one of all if none is."""
    for layer in scene.view_layers:
        if layer.use:
            return layer
    return scene.view_layers[0]


def settings_of(scene: Any, layer: Any, items: Any) -> dict[str, dict[str, Settings]]:
    """Return what draws may set of lights and materials, by kind and name.

    Args:
        scene: whose world counts as a light.
        layer: whose lights are rendered.
        items: the objects that are rendered, whose materials may be set.
    """
    lights: dict[str, Settings] = {}
    for item in layer.objects:
        if item.type == "LIGHT" and not item.hide_render:
            if item.data.users > 1:
                item.data = item.data.copy()
            lights[item.name] = settings_of_light(item.data)
    if scene.world is not None and (inputs := inputs_of(scene.world)):
        lights["World"] = inputs
    by_name: dict[str, Any] = {}
    for item in items:
        for slot in item.material_slots:
            if slot.material:
                by_name[slot.material.name] = slot.material
    materials: dict[str, Settings] = {}
    for name, material in sorted(by_name.items()):
        if inputs := inputs_of(material):
            materials[name] = inputs
    return {"lights": lights, "materials": materials}


def settings_of_light(light: Any) -> Settings:
    """Return those of :data:`LIGHT` that a light has."""
    settings = {}
    for name, attribute in LIGHT.items():
        if hasattr(light, attribute):
            settings[name] = (light, attribute)
    return settings


def inputs_of(shaded: Any) -> Settings:
    """Return the inputs of a material's or world's shader by name: ``base_color`` is Base Color.

    They are those of the node at the output that no other node gives.
    """
    output = shaded.node_tree and shaded.node_tree.get_output_node("CYCLES")
    if not output:
        return {}
    inputs = {}
    for link in output.inputs["Surface"].links:
        for socket in link.from_node.inputs:
            if not socket.is_linked and socket.enabled and socket.type in ("VALUE", "RGBA", "VECTOR"):
                inputs[socket.name.lower().replace(" ", "_")] = (socket, "default_value")
    return inputs


def sizes_of(by_name: dict[str, Settings]) -> dict[str, dict[str, int]]:
    """Return, by name of a light or material, how many numbers each of its settings has."""
    sizes: dict[str, dict[str, int]] = {}
    for name, settings in by_name.items():
        sizes[name] = {}
        for key, (owner, attribute) in settings.items():
            sizes[name][key] = 1 if isinstance(getattr(owner, attribute), float) else 3
    return sizes


def place(item: Any, described: Any, pose: Any, metres: float) -> None:
    """Place an object; what would move it otherwise is removed.

    Args:
        item: the object.
        described: its world matrix as the file has it.
        pose: its rotation and its position in metres; None to put it back where it was.
        metres: of a unit of the scene.
    """
    item.animation_data_clear()
    item.constraints.clear()
    item.parent = None
    matrix = described.copy()
    if pose is not None:
        R_w_o, position = pose
        turn = Matrix(R_w_o) @ described.to_quaternion().to_matrix().transposed()
        matrix = turn.to_4x4() @ described
        matrix.translation = [x / metres for x in position]
    item.matrix_world = matrix


def multi_layer_exr(image: Any) -> None:
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "32"
    image.exr_codec = "NONE"


def use_device(scene: Any, device: str) -> None:
    """Render a ``scene`` on the CPU, or on all devices of a type: ``device`` is ``cpu`` or, say, ``cuda``."""
    scene.cycles.device = "CPU" if device == "cpu" else "GPU"
    if device == "cpu":
        return
    preferences = bpy.context.preferences.addons["cycles"].preferences
    try:
        preferences.compute_device_type = device.upper()
    except TypeError:
        raise RuntimeError(f"expected a device of kind {device}, which this Blender does not know") from None
    preferences.refresh_devices()
    for item in preferences.devices:
        item.use = item.type == device.upper()
    if not any(item.use for item in preferences.devices):
        raise RuntimeError(f"expected a device of kind {device}, found none")


# -- the pipes ------------------------------------------------------------------------------------------


def main() -> None:
    """Answer requests until the input ends, which is when the process that started this one is gone."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # drops what Blender prints
    replies.write(MARK)
    send(replies, {"version": list(bpy.app.version)})
    requests = queue.SimpleQueue[Message]()
    world: Any = None
    threading.Thread(target=read, args=(sys.stdin.buffer, requests), daemon=True).start()
    while True:
        request = requests.get()
        try:
            if request["do"] == "open":
                world = World(request)
                answer = world.description()
            elif request["do"] == "render":
                answer = world.render(request)
            else:
                answer = world.boxes(request)
        except (RuntimeError, MemoryError) as wrong:  # what Blender reports; other errors end this program
            answer = {"error": " ".join(str(wrong).split()) or type(wrong).__name__}
        send(replies, answer)


def read(stream: IO[bytes], requests: "queue.SimpleQueue[Message]") -> None:
    """Read requests from a ``stream``, and put them in the queue ``requests``.

    Their end ends this program at once, even while it renders, and removes the folders that they have named.
    """
    folders: set[str] = set()
    while len(head := stream.read(4)) == 4:
        request = json.loads(stream.read(int.from_bytes(head, "big")))
        folders.add(request["folder"])
        requests.put(request)
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def send(stream: IO[bytes], message: Message) -> None:
    """Write a ``message`` to a ``stream``, as one frame."""
    data = json.dumps(message).encode()
    stream.write(len(data).to_bytes(4, "big") + data)
    stream.flush()


if __name__ == "__main__":
    main()
