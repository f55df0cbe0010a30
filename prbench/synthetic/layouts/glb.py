"""Triangles as binary glTF, in the way of the object library: millimetres below a scaled (and turned) node."""

from __future__ import annotations

import json
import struct

import numpy as np

from prbench.readers.hot3d.format import ObjectMesh

_SCALE = 0.001
_QUARTER_TURN = (0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5))  # x y z w, about the vertical
_SHIFT = (0.0045, -0.0205, -0.0155)
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_FLOAT, _SHORT, _TRIANGLES = 5126, 5123, 4


def glb_bytes(mesh: ObjectMesh, *, name: str, turned: bool) -> bytes:
    """The file of one model: the node's transform brings its raw vertices into the object's frame.

    Args:
        mesh: In the object's frame, metres; less than 65,536 vertices.
        name: Of the node.
        turned: Whether the node turns and shifts what it holds, besides scaling it.
    """
    node: dict[str, object] = {"name": name, "mesh": 0, "scale": [_SCALE] * 3}
    raw = mesh.vertices
    if turned:
        node |= {"rotation": list(_QUARTER_TURN), "translation": list(_SHIFT)}
        x, y, z = (raw - _SHIFT).T
        raw = np.column_stack([z, y, -x])  # the node turns it back: (x, y, z) becomes (-z, y, x)
    vertices = (raw / _SCALE).astype("<f4")
    faces = mesh.faces.astype("<u2")
    content = vertices.tobytes() + faces.tobytes()
    description = {
        "asset": {"version": "2.0", "generator": "prbench"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": _TRIANGLES}]}],
        "accessors": [
            {
                "type": "VEC3",
                "componentType": _FLOAT,
                "count": len(vertices),
                "bufferView": 0,
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {"type": "SCALAR", "componentType": _SHORT, "count": faces.size, "bufferView": 1},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": vertices.nbytes},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": faces.nbytes},
        ],
        "buffers": [{"byteLength": len(content)}],
    }
    text = json.dumps(description).encode()
    chunks = _chunk(_JSON, text, b" ") + _chunk(_BINARY, content, b"\0")
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks


def _chunk(kind: int, content: bytes, padding: bytes) -> bytes:
    content += padding * (-len(content) % 4)
    return struct.pack("<II", len(content), kind) + content
