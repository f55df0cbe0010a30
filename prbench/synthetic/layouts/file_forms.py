"""CSV files as the releases of the Aria datasets write them."""

from __future__ import annotations

import io
import json
import pickle
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.readers.hot3d.format import ObjectMesh
from prbench.storage import atomic_path


def split_columns(names: Sequence[str], columns: np.ndarray) -> dict[str, object]:
    """Return the columns of an array under their names."""
    return {name: columns[:, index] for index, name in enumerate(names)}


def write_csv(path: Path, columns: Mapping[str, object]) -> None:
    """Write a table: plain header, no quotes, empty cells for NaN.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write((",".join(columns) + "\n").encode())
        pyarrow.csv.write_csv(
            table, file, pyarrow.csv.WriteOptions(include_header=False, quoting_style="none", batch_size=65536)
        )


_TEXT = re.compile(rb"X(?P<length>.{4})(?P<key>\d{6,20})", re.DOTALL)
_KEY = b"X" + struct.pack("<I", 1) + b"0"


def pickled_tensors(values: Mapping[str, np.ndarray], *, requires_grad: Collection[str] = ()) -> bytes:
    """Return a pickled dictionary of torch tensors.

    Args:
        values: float32 arrays of one axis by name.
        requires_grad: Names of those that the writing program had optimised.
    """
    import torch

    tensors = {
        name: torch.tensor(array, dtype=torch.float32, requires_grad=name in requires_grad)
        for name, array in values.items()
    }
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=4).dump(tensors)
    return buffer.getvalue()


class _Pickler(pickle.Pickler):
    """Writes storages from templates, everything else as usual."""

    def reducer_override(self, obj: Any) -> Any:
        import torch
        from torch.storage import TypedStorage, _load_from_bytes

        if not isinstance(obj, TypedStorage):
            return NotImplemented
        raw = torch.empty(0, dtype=torch.float32).set_(obj._untyped_storage).numpy().astype("<f4").tobytes()
        return _load_from_bytes, (_storage_head(len(raw) // 4) + raw,)


@cache
def _storage_head(size: int) -> bytes:
    """Return what ``torch.save`` writes before float32 numbers, with a fixed key for the memory address."""
    import torch

    buffer = io.BytesIO()
    torch.save(torch.zeros(size)._typed_storage(), buffer, _use_new_zipfile_serialization=False)
    head = buffer.getvalue()[: -4 * size]
    return _TEXT.sub(_fixed_key, head)


def _fixed_key(match: re.Match[bytes]) -> bytes:
    known = struct.unpack("<I", match["length"])[0]
    return _KEY + match["key"][known:] if known <= len(match["key"]) else match[0]


_SCALE = 0.001
_QUARTER_TURN = (0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5))  # x y z w, about the vertical
_SHIFT = (0.0045, -0.0205, -0.0155)
_MAGIC = 0x46546C67
_JSON = 0x4E4F534A
_BINARY = 0x004E4942
_FLOAT = 5126
_SHORT = 5123
_TRIANGLES = 4


def glb_bytes(mesh: ObjectMesh, *, name: str, turned: bool) -> bytes:
    """Return the file of one model: the node's transform brings its raw vertices into the object's frame.

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
