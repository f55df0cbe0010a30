"""glTF 2.0 in one binary file: the skeleton, its animation, a body of capsules bound to it, and the goal with its box.

Source: the glTF 2.0 specification (Khronos Group, 2021): little-endian numbers, each view aligned to four bytes,
smallest and largest values of positions and times, rotations as x y z w.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import BONES, N_JOINTS, Joint
from prbench.viewing.exporting.skeleton import CHILDREN, PosedSkeleton
from prbench.viewing.replay.scene import GOAL_COLOUR, Goal, Scene, ShownMotion, rgb

# Radius of the bone that ends in each joint, metres; that of the pelvis is not used.
_RADII = (
    0.0, 0.08, 0.08, 0.1, 0.075, 0.075, 0.1, 0.055, 0.055, 0.1, 0.04, 0.04, 0.055, 0.06, 0.06, 0.06, 0.055, 0.055,
    0.045, 0.045, 0.035, 0.035,
)  # fmt: skip
_HEAD_RADIUS = 0.1
_POINT = 0.03  # metres; a goal without extent is drawn as a cube of this side
_TYPES = {"float32": 5126, "uint16": 5123, "uint8": 5121}
_SHAPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_VERTICES, _TRIANGLES = 34962, 34963  # what a buffer view is for


class _Gltf:
    """A document that grows: its JSON, and the bytes behind it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, *, target: int | None = None, bounds: bool = False, unit: bool = False) -> int:
        """Add an array and return the number of its accessor; ``unit`` reads whole numbers as 0 to 1."""
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
        self.data += bytes(-len(self.data) % 4)
        if target is not None:
            self.views[-1]["target"] = target
        kind = {"componentType": _TYPES[values.dtype.name], "type": _SHAPES[values.shape[1:]], "count": len(values)}
        if bounds:
            kind["min"] = np.atleast_1d(values.min(axis=0)).tolist()
            kind["max"] = np.atleast_1d(values.max(axis=0)).tolist()
        if unit:
            kind["normalized"] = True
        self.accessors.append({"bufferView": len(self.views) - 1, **kind})
        return len(self.accessors) - 1

    def primitive(self, mesh: trimesh.Trimesh, colour: tuple[float, float, float, float]) -> dict[str, Any]:
        """Add a surface of one colour, and return the primitive."""
        material: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0.0}}
        if colour[3] < 1:
            material |= {"alphaMode": "BLEND", "doubleSided": True}
        self.materials.append(material)
        positions = self.add(mesh.vertices.astype(np.float32), target=_VERTICES, bounds=True)
        normals = self.add(mesh.vertex_normals.astype(np.float32), target=_VERTICES)
        indices = self.add(mesh.faces.astype(np.uint16).ravel(), target=_TRIANGLES)
        attributes = {"POSITION": positions, "NORMAL": normals}
        return {"attributes": attributes, "indices": indices, "material": len(self.materials) - 1}


def write_glb(scene: Scene, motion: ShownMotion, posed: PosedSkeleton, path: Path, about: dict[str, Any]) -> None:
    """Write a motion as an animated glTF binary; metres, Y up, canonical frame.

    Args:
        scene: The sequence; its goal is left out where it has none.
        motion: One motion of it.
        posed: The same as rotations.
        path: The file.
        about: What is said of the motion; stands in the document's ``extras``.
    """
    gltf = _Gltf()
    nodes: list[dict[str, Any]] = []
    for joint in Joint:
        place = posed.root[0] if joint == Joint.PELVIS else posed.offsets[joint]
        quaternion = Rotation.from_matrix(posed.local[0, joint]).as_quat()
        nodes.append({"name": joint.name.lower(), "translation": place.tolist(), "rotation": quaternion.tolist()})
        if CHILDREN[joint]:
            nodes[-1]["children"] = list(CHILDREN[joint])
    animation = _animation(gltf, scene, posed)
    rest = posed.offsets.copy()
    for parent, child in BONES:
        rest[child] = rest[parent] + rest[child]
    inverse = np.tile(np.eye(4, dtype=np.float32), (N_JOINTS, 1, 1))
    inverse[:, 3, :3] = -rest  # stored column after column
    skin = {"joints": list(range(N_JOINTS)), "inverseBindMatrices": gltf.add(inverse), "skeleton": 0}
    meshes = [{"name": "body", "primitives": _body(gltf, rest, motion.colour)}]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    if scene.goal is not None:
        nodes.append({"name": "goal", "mesh": 1, "translation": scene.goal.location.tolist()})
        box = _box(scene.goal)
        meshes.append({"name": "goal", "primitives": [gltf.primitive(box, (*_shade(GOAL_COLOUR), 0.4))]})
    document = {
        "asset": {"version": "2.0", "generator": "prbench", "copyright": about["notice"] or about["licence"]},
        "scene": 0,
        "scenes": [{"name": scene.sequence_id, "nodes": [0, *range(N_JOINTS, len(nodes))], "extras": about}],
        "nodes": nodes,
        "meshes": meshes,
        "skins": [skin],
        "animations": [{"name": motion.label, **animation}],
        "materials": gltf.materials,
        "accessors": gltf.accessors,
        "bufferViews": gltf.views,
        "buffers": [{"byteLength": len(gltf.data)}],
    }
    text = msgspec.json.encode(document)
    text += b" " * (-len(text) % 4)
    chunks = ((b"JSON", text), (b"BIN\0", bytes(gltf.data)))
    body = b"".join(len(content).to_bytes(4, "little") + kind + content for kind, content in chunks)
    path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body)


def _animation(gltf: _Gltf, scene: Scene, posed: PosedSkeleton) -> dict[str, Any]:
    """Add the channels: the pelvis's place, and every joint's rotation."""
    times = gltf.add(scene.times.astype(np.float32), bounds=True)
    outputs = [("translation", 0, posed.root)]
    for joint in Joint:
        quaternions = Rotation.from_matrix(posed.local[:, joint]).as_quat()
        # Both signs mean one rotation; viewers that draw between two frames turn the short way only with equal ones.
        turned = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0
        quaternions[1:][np.cumsum(turned) % 2 == 1] *= -1
        outputs.append(("rotation", int(joint), quaternions))
    samplers = []
    channels = []
    for number, (kind, node, values) in enumerate(outputs):
        samplers.append({"input": times, "output": gltf.add(values.astype(np.float32)), "interpolation": "LINEAR"})
        channels.append({"sampler": number, "target": {"node": node, "path": kind}})
    return {"samplers": samplers, "channels": channels}


def _body(gltf: _Gltf, rest: np.ndarray, colour: str) -> list[dict[str, Any]]:
    """Add a capsule a bone and a head; left limbs are lighter, so that the sides can be told apart."""
    parts: dict[bool, list[tuple[trimesh.Trimesh, int]]] = {False: [], True: []}
    for parent, child in BONES:
        radius = _RADII[child]
        ends = [rest[parent], rest[child]]
        sphere = _HEAD_RADIUS if child == Joint.HEAD else radius
        ball = trimesh.creation.icosphere(subdivisions=1, radius=sphere).apply_translation(rest[child])
        is_left = Joint(child).name.startswith("LEFT")
        # The ball closes the bone at its child, and so moves with the bone.
        parts[is_left].append((ball, parent))
        if np.linalg.norm(ends[1] - ends[0]) > radius / 100:
            parts[is_left].append((trimesh.creation.cylinder(radius=radius, segment=ends, sections=12), parent))
    primitives = []
    for is_left, pieces in parts.items():
        mesh = trimesh.util.concatenate([piece for piece, _ in pieces])
        shade = np.array(_shade(colour))
        red, green, blue = (0.5 + 0.5 * shade if is_left else shade).tolist()
        primitive = gltf.primitive(mesh, (red, green, blue, 1.0))
        bones = np.zeros((len(mesh.vertices), 4), dtype=np.uint8)
        bones[:, 0] = np.concatenate([np.full(len(piece.vertices), joint) for piece, joint in pieces])
        weights = np.tile(np.array([255, 0, 0, 0], dtype=np.uint8), (len(bones), 1))
        primitive["attributes"]["JOINTS_0"] = gltf.add(bones, target=_VERTICES)
        primitive["attributes"]["WEIGHTS_0"] = gltf.add(weights, target=_VERTICES, unit=True)
        primitives.append(primitive)
    return primitives


def _box(goal: Goal) -> trimesh.Trimesh:
    """Return the goal's box around its location; a small cube where it has no extent."""
    corners = goal.box_corners - goal.location
    if np.ptp(corners, axis=0).max() < _POINT:
        corners = trimesh.creation.box((_POINT,) * 3).vertices
    return trimesh.convex.convex_hull(corners)


def _shade(colour: str) -> list[float]:
    """Return red, green and blue, 0 to 1, linear, as glTF has them."""
    return [(part / 255) ** 2.2 for part in rgb(colour)]
