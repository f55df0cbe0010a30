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
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import BONES, N_JOINTS, Joint
from prbench.viewing.exporting.skeleton import CHILDREN, pose_skeleton
from prbench.viewing.replay.scene import GOAL_COLOUR, Scene, rgb

# Radius of the bone that ends in each joint, metres; that of the pelvis is not used.
_RADII = (
    0.0, 0.08, 0.08, 0.1, 0.075, 0.075, 0.1, 0.055, 0.055, 0.1, 0.04, 0.04, 0.055, 0.06, 0.06, 0.06, 0.055, 0.055,
    0.045, 0.045, 0.035, 0.035,
)  # fmt: skip
_HEAD_RADIUS = 0.1
_SHORTEST = 0.001  # metres; shorter bones are a ball alone
_POINT = 0.03  # metres; a goal without extent is drawn as a cube of this side
_TYPES = {"float32": 5126, "uint16": 5123, "uint8": 5121}
_SHAPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class _Gltf:
    """A document that grows: its JSON, and the bytes behind it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []

    def add(self, values: np.ndarray) -> int:
        """Add an array, numbers with a point as float32, and return the number of its accessor."""
        values = values.astype(np.float32) if values.dtype.kind == "f" else values
        accessor: dict[str, Any] = {"bufferView": len(self.views), "count": len(values)}
        accessor |= {"componentType": _TYPES[values.dtype.name], "type": _SHAPES[values.shape[1:]]}
        if values.ndim < 3:  # demanded of positions and times, allowed for all
            accessor |= {name: np.atleast_1d(getattr(values, name)(axis=0)).tolist() for name in ("min", "max")}
        self.accessors.append(accessor)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.astype(values.dtype.newbyteorder("<")).tobytes()
        self.data += bytes(-len(self.data) % 4)
        return len(self.accessors) - 1

    def primitive(self, mesh: trimesh.Trimesh, colour: Float[np.ndarray, "3"], opacity: float = 1.0) -> dict[str, Any]:
        """Add a surface of one linear colour, 0 to 1, and return the primitive."""
        material = {"pbrMetallicRoughness": {"baseColorFactor": [*colour.tolist(), opacity], "metallicFactor": 0.0}}
        see_through = {"alphaMode": "BLEND", "doubleSided": True}
        self.materials.append(material if opacity == 1 else material | see_through)
        attributes = {"POSITION": self.add(mesh.vertices), "NORMAL": self.add(mesh.vertex_normals)}
        indices = self.add(mesh.faces.astype(np.uint16).ravel())
        return {"attributes": attributes, "indices": indices, "material": len(self.materials) - 1}


def write(scene: Scene, path: Path, about: dict[str, Any], _: object) -> Float[np.ndarray, "n 22"]:
    """Write the first motion of a scene as an animated glTF binary; metres, Y up, canonical frame.

    Args:
        scene: The sequence; its goal is left out where it has none.
        path: The file.
        about: What is said of the motion; stands in the scene's ``extras``.

    Returns:
        Distance of each joint in the file from the motion, metres.
    """
    posed = pose_skeleton(scene.motions[0].joints)
    gltf = _Gltf()
    rest = posed.offsets.copy()
    for parent, child in BONES:
        rest[child] = rest[parent] + rest[child]
    inverse = np.tile(np.eye(4), (N_JOINTS, 1, 1))
    inverse[:, 3, :3] = -rest  # stored column after column
    skin = {"joints": list(range(N_JOINTS)), "inverseBindMatrices": gltf.add(inverse), "skeleton": 0}
    nodes: list[dict[str, Any]] = []
    times = gltf.add(scene.times)
    samplers = [{"input": times, "output": gltf.add(posed.root)}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    for joint in Joint:
        quaternions = Rotation.from_matrix(posed.local[:, joint]).as_quat()
        # Both signs mean one rotation; viewers that draw between two frames turn the short way only with equal ones.
        turned = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0
        quaternions[1:][np.cumsum(turned) % 2 == 1] *= -1
        channels.append({"sampler": len(samplers), "target": {"node": int(joint), "path": "rotation"}})
        samplers.append({"input": times, "output": gltf.add(quaternions)})
        place = posed.offsets[joint] if joint else posed.root[0]
        node = {"name": joint.name.lower(), "translation": place.tolist(), "rotation": quaternions[0].tolist()}
        nodes.append(node | ({"children": list(CHILDREN[joint])} if CHILDREN[joint] else {}))
    meshes = [{"name": "body", "primitives": _body(gltf, rest, scene.motions[0].colour)}]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    if scene.goal is not None:
        corners = scene.goal.box_corners - scene.goal.location
        if np.ptp(corners, axis=0).max() < _POINT:
            corners = trimesh.creation.box((_POINT,) * 3).vertices
        box = gltf.primitive(trimesh.convex.convex_hull(corners), _linear(GOAL_COLOUR), 0.4)
        meshes.append({"name": "goal", "primitives": [box]})
        nodes.append({"name": "goal", "mesh": 1, "translation": scene.goal.location.tolist()})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "prbench", "copyright": about["notice"] or about["licence"]},
        "scene": 0,
        "scenes": [{"name": scene.sequence_id, "nodes": [0, *range(N_JOINTS, len(nodes))], "extras": about}],
        "nodes": nodes,
        "meshes": meshes,
        "skins": [skin],
        "animations": [{"name": scene.motions[0].label, "samplers": samplers, "channels": channels}],
    }
    document |= {"materials": gltf.materials, "accessors": gltf.accessors, "bufferViews": gltf.views}
    document["buffers"] = [{"byteLength": len(gltf.data)}]
    text = msgspec.json.encode(document)
    text += b" " * (-len(text) % 4)
    chunks = ((b"JSON", text), (b"BIN\0", bytes(gltf.data)))
    body = b"".join(len(content).to_bytes(4, "little") + kind + content for kind, content in chunks)
    path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body)
    return posed.error


def _body(gltf: _Gltf, rest: Float[np.ndarray, "22 3"], colour: str) -> list[dict[str, Any]]:
    """Add a capsule a bone and a head; left limbs are lighter, so that the sides can be told apart."""
    pieces: dict[bool, list[trimesh.Trimesh]] = {True: [], False: []}
    bones: dict[bool, list[int]] = {True: [], False: []}  # of each vertex
    for parent, child in BONES:
        size = _HEAD_RADIUS if child == Joint.HEAD else _RADII[child]
        parts = [trimesh.creation.icosphere(subdivisions=1, radius=size).apply_translation(rest[child])]
        if np.linalg.norm(rest[child] - rest[parent]) > _SHORTEST:
            parts.append(trimesh.creation.cylinder(_RADII[child], segment=rest[[parent, child]], sections=12))
        is_left = Joint(child).name.startswith("LEFT")
        pieces[is_left] += parts
        bones[is_left] += [parent] * sum(len(part.vertices) for part in parts)
    primitives = []
    for is_left, parts in pieces.items():
        shade = _linear(colour)
        mesh: Any = trimesh.util.concatenate(parts)
        primitive = gltf.primitive(mesh, 0.5 + 0.5 * shade if is_left else shade)
        of_bone = np.pad(np.array(bones[is_left], dtype=np.uint8)[:, None], ((0, 0), (0, 3)))
        primitive["attributes"]["JOINTS_0"] = gltf.add(of_bone)
        primitive["attributes"]["WEIGHTS_0"] = gltf.add(np.tile((1.0, 0.0, 0.0, 0.0), (len(of_bone), 1)))
        primitives.append(primitive)
    return primitives


def _linear(colour: str) -> Float[np.ndarray, "3"]:
    """Return red, green and blue, 0 to 1, linear, as glTF has them."""
    return (np.array(rgb(colour)) / 255) ** 2.2
