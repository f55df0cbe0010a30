"""Small files that declare or unpack to far more than memory holds."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import h5py
import numpy as np

MEGABYTE = 2**20


def npy_header(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    """The beginning of a ``.npy`` of any shape, without a value."""
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue()


def npz(path: Path, name: str, megabytes: int) -> Path:
    """One compressed array of zeros, with a header that is right: (frames, 22, 3) of float32."""
    frames = megabytes * MEGABYTE // 264
    content = npy_header((frames, 22, 3)) + bytes(frames * 264)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(f"{name}.npy", content)
    return path


def zipped(path: Path, member: str, content: bytes, *, kind: int = zipfile.ZIP_DEFLATED) -> Path:
    """An archive of one member."""
    with zipfile.ZipFile(path, "w", kind) as archive:
        archive.writestr(member, content)
    return path


def declaring(path: Path, size: int) -> Path:
    """The same archive of one member, whose table of contents declares another size."""
    content = bytearray(path.read_bytes())
    entry = content.rfind(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = struct.pack("<I", size)
    path.write_bytes(content)
    return path


def encrypted(path: Path) -> Path:
    """The same archive, its first member marked as encrypted."""
    content = bytearray(path.read_bytes())
    content[content.find(b"PK\x03\x04") + 6] |= 1
    content[content.find(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)
    return path


def empty_rows(path: Path, name: str, rows: int, columns: int) -> Path:
    """A dataset of HDF5 that declares rows of which none is stored; its attributes stay."""
    with h5py.File(path, "r+") as file:
        attributes = dict(file[name].attrs)
        del file[name]
        entry = file.create_dataset(name, shape=(rows, columns), chunks=(1000, columns), dtype="f8", compression="gzip")
        for key, value in attributes.items():
            entry.attrs[key] = value
    return path
