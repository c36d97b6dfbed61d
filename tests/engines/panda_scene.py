"""Panda3D behind the mock server: it draws the views of a GLB file, with textures and a depth buffer.

:class:`PandaScene` has the methods of ``mock_server.Scene`` that a running world calls, and draws in
:meth:`PandaScene.view`. Panda3D belongs to one thread.
"""

from __future__ import annotations

import copy
import hashlib
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import gltf
import numpy as np
from panda3d import core as panda

from mock_server.scene import Hits, ViewHits

panda.load_prc_file_data(
    "",
    "window-type none\ngl-version 3 3\naudio-library-name null\ntextures-power-2 none\nnotify-level error\n",
)
NEAR_M = 0.02
FAR_M = 500.0
_VERTEX = """#version 330
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelMatrix, p3d_ModelViewMatrix;
in vec4 p3d_Vertex; in vec3 p3d_Normal; in vec2 p3d_MultiTexCoord0;
out vec3 world, eye, normal; out vec2 uv;
void main() {
  gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
  world = (p3d_ModelMatrix * p3d_Vertex).xyz;
  eye = (p3d_ModelViewMatrix * p3d_Vertex).xyz;
  normal = mat3(p3d_ModelMatrix) * p3d_Normal;
  uv = p3d_MultiTexCoord0;
}"""
_DATA = """#version 330
in vec3 world, eye, normal; uniform float label; out vec4 color;
void main() { // label, planar depth, and the normal on an octahedron
  vec3 n = normalize(normal); n /= abs(n.x) + abs(n.y) + abs(n.z);
  vec2 below = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  color = vec4(label, -eye.z, n.z >= 0.0 ? n.xy : below);
}"""
_LIT = """#version 330
in vec3 world, eye, normal; in vec2 uv; uniform sampler2D p3d_Texture0; out vec4 color;
void main() { // a lamp below the ceiling
  vec3 n = normalize(normal), l = vec3(0.4, -0.3, 2.4) - world;
  float lamp = max(dot(n, normalize(l)), 0.0) * 3.0 / (1.0 + 0.6 * dot(l, l));
  color = vec4(texture(p3d_Texture0, uv).rgb * (0.45 + 0.12 * n.z + lamp), 1.0);
}"""


class Aim(NamedTuple):
    """A camera: its centre, columns right, down and forward, tangents of its half angles, and its size."""

    center: np.ndarray
    R_w_c: np.ndarray
    tangents: tuple[float, float]
    size: tuple[int, int]


class Engine:
    """A GLB file in Panda3D, in a thread of its own; float targets for data, 8 bits for colours."""

    def __init__(self, path):
        self._thread = ThreadPoolExecutor(1, "panda3d")
        self._targets = {}
        self._run(self._open, path)

    def draw(self, kind, aim, hidden, matrices):
        """Return (H, W, 4) of ``data`` (float32) or ``lit`` (uint8); matrices (4, 4) move objects."""
        return self._run(self._draw, kind, aim, hidden, matrices)

    def _run(self, work, *arguments):
        return self._thread.submit(work, *arguments).result()

    def _open(self, path):
        self._engine = panda.GraphicsEngine.get_global_ptr()
        self._pipe = panda.GraphicsPipeSelection.get_global_ptr().make_module_pipe("p3headlessgl")
        self._host = self._output("host", panda.FrameBufferProperties.get_default(), (1, 1))
        self._root = panda.NodePath("root")
        model = panda.NodePath(gltf.load_model(str(path)))
        model.reparent_to(self._root)
        self.nodes = {node.get_parent().get_name(): node for node in model.find_all_matches("**/+GeomNode")}
        self._rest = {name: _array(node.get_mat(self._root)) for name, node in self.nodes.items()}
        self.points = {name: self._points(name) for name in self.nodes}
        for label, name in enumerate(sorted(self.nodes), start=1):
            self.nodes[name].set_shader_input("label", float(label))
        self._shaders = {
            kind: panda.Shader.make(panda.Shader.SL_GLSL, _VERTEX, code)
            for kind, code in (("data", _DATA), ("lit", _LIT))
        }
        self._camera = panda.Camera("camera")
        self._eye = self._root.attach_new_node(self._camera)

    def _points(self, name):
        points = []
        for geom in self.nodes[name].node().get_geoms():
            reader = panda.GeomVertexReader(geom.get_vertex_data(), "vertex")
            while not reader.is_at_end():
                points.append(tuple(reader.get_data3()))
        return np.array(points) @ self._rest[name][:3, :3] + self._rest[name][3, :3]

    def _output(self, name, properties, size, *shared):
        flags = panda.GraphicsPipe.BF_refuse_window
        return self._engine.make_output(
            self._pipe, name, 0, properties, panda.WindowProperties.size(*size), flags, *shared
        )

    def _target(self, kind, size):
        if (kind, size) not in self._targets:
            properties = panda.FrameBufferProperties()
            properties.set_rgba_bits(*[32 if kind == "data" else 8] * 4)
            properties.set_float_color(kind == "data")
            properties.set_depth_bits(32)
            output = self._output(kind, properties, size, self._host.get_gsg(), self._host)
            texture = panda.Texture()
            if kind == "data":
                texture.set_format(panda.Texture.F_rgba32)
                texture.set_component_type(panda.Texture.T_float)
            modes = panda.GraphicsOutput.RTM_copy_ram, panda.GraphicsOutput.RTP_color
            output.add_render_texture(texture, *modes)
            output.set_clear_color((0, 0, 0, 0) if kind == "data" else (0.55, 0.7, 0.9, 1))
            output.make_display_region().set_camera(self._eye)
            self._targets[kind, size] = output, texture
        return self._targets[kind, size]

    def _draw(self, kind, aim, hidden, matrices):
        for name, node in self.nodes.items():
            (node.hide if name in hidden else node.show)()
            moved = self._rest[name] @ matrices[name] if name in matrices else self._rest[name]
            node.set_mat(self._root, panda.LMatrix4f(*moved.ravel().tolist()))
        lens = panda.PerspectiveLens()
        lens.set_fov(*np.degrees(2 * np.arctan(aim.tangents)).tolist())
        lens.set_near_far(NEAR_M, FAR_M)
        self._camera.set_lens(lens)
        frame = np.eye(4)  # rows: right, forward, up, centre
        frame[:3, :3] = aim.R_w_c[:, 0], aim.R_w_c[:, 2], -aim.R_w_c[:, 1]
        frame[3, :3] = aim.center
        self._eye.set_mat(self._root, panda.LMatrix4f(*frame.ravel().tolist()))
        self._root.set_shader(self._shaders[kind])
        output, texture = self._target(kind, aim.size)
        for other, _ in self._targets.values():
            other.set_active(other is output)
        self._engine.render_frame()
        dtype = np.float32 if kind == "data" else np.uint8
        pixels = np.frombuffer(texture.get_ram_image(), dtype).reshape(*aim.size[::-1], 4)
        return pixels[::-1, :, [2, 1, 0, 3]]


class PandaScene:
    """What a running world of the mock server asks of a scene; poses are those of the boxes' middles."""

    moving = ()
    time = 0.0
    room = None

    def __init__(self, name, path):
        self.name = name
        self._engine = Engine(path)
        self._digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self.objects = tuple(sorted(self._engine.nodes))
        self.static = frozenset(
            name for name in self.objects if name.startswith(("Wall", "Floor", "Ceiling"))
        )
        self._poses = {}

    def label(self, name):
        return 1 + self.objects.index(name)

    def digest(self):
        return self._digest

    def pose(self, name):
        points = self._engine.points[name]
        return self._poses.get(name) or (np.eye(3), (points.min(axis=0) + points.max(axis=0)) / 2)

    def vertices(self, name):
        points = self._engine.points[name]
        R_w_o, center = self.pose(name)
        return (points - (points.min(axis=0) + points.max(axis=0)) / 2) @ R_w_o.T + center

    def bounds(self, name):
        points = self.vertices(name)
        return points.min(axis=0), points.max(axis=0)

    def at(self, time_s, poses=None):
        other = copy.copy(self)
        other._poses = {name: (np.array(R), np.array(t)) for name, (R, t) in (poses or {}).items()}
        return other

    def trace(self, origins, directions, hidden=frozenset()):
        """Return what one ray meets, for sweeps of the pawn: a picture of one pixel."""
        forward = np.asarray(directions, float) / np.linalg.norm(directions)
        right = np.cross(forward, (0.3, 0.2, 1.0))
        right /= np.linalg.norm(right)
        aim = Aim(
            np.asarray(origins, float),
            np.stack([right, np.cross(forward, right), forward], 1),
            (1e-3, 1e-3),
            (1, 1),
        )
        label, depth, normal = self._data(aim, hidden)
        return Hits(label[0, 0], depth[0, 0], normal[0, 0], lambda: np.zeros(3))

    def view(self, center, rays, length, hidden=frozenset(), near_m=0.0):
        """Draw what ``mock_server.Scene.view`` traces."""
        height, width = length.shape
        points = rays * length[..., None]
        across = (points[0, -1] - points[0, 0]) / max(width - 1, 1)
        down = (points[-1, 0] - points[0, 0]) / max(height - 1, 1)
        x, y = (step / np.linalg.norm(step) for step in (across, down))
        tangents = np.linalg.norm(across) * width / 2, np.linalg.norm(down) * height / 2
        aim = Aim(
            np.asarray(center, float), np.stack([x, y, np.cross(x, y)], axis=1), tangents, (width, height)
        )
        label, depth, normal = self._data(aim, hidden)
        engine = self._engine
        matrices = self._matrices()
        return ViewHits(
            label,
            depth * length,
            normal,
            lambda: engine.draw("lit", aim, hidden, matrices)[..., :3] / 255.0,
            depth,
        )

    def _matrices(self):
        matrices = {}
        for name, (R_w_o, center) in self._poses.items():
            points = self._engine.points[name]
            matrix = np.eye(4)
            matrix[:3, :3] = R_w_o.T
            matrix[3, :3] = center - R_w_o @ (points.min(axis=0) + points.max(axis=0)) / 2
            matrices[name] = matrix
        return matrices

    def _data(self, aim, hidden):
        """Return (H, W) labels, planar depth and normals (H, W, 3)."""
        pixels = self._engine.draw("data", aim, hidden, self._matrices()).astype(np.float64)
        label = np.rint(pixels[..., 0]).astype(np.uint16)
        seen = label > 0
        flat = pixels[..., 2:]
        z = 1 - np.abs(flat).sum(axis=-1)
        folded = (1 - np.abs(flat[..., ::-1])) * np.where(flat >= 0, 1, -1)
        normal = np.concatenate([np.where((z >= 0)[..., None], flat, folded), z[..., None]], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return label, np.where(seen, pixels[..., 1], np.inf), normal * seen[..., None]


def _array(matrix):
    return np.array(matrix).reshape(4, 4)
