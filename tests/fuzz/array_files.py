"""Damages that only a program makes: arrays and tables of another kind, shape or content in sound files."""

from __future__ import annotations

import io
from pathlib import Path
from random import Random

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq


def other_content(path: Path, content: bytes, random: Random) -> str:
    """Rewrite an array or a column of a sound file; an empty answer where the file holds neither."""
    change = _CHANGES.get(path.suffix.lower())
    if change is None:
        return ""
    try:
        return change(path, content, random)
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException):
        path.write_bytes(content)  # the change fits no array of this file
        return ""


def _other_array(values: np.ndarray, random: Random) -> tuple[str, np.ndarray]:
    way = random.choice(
        ["text", "empty", "flat", "wider", "shorter", "whole numbers", "complex", "nan", "huge", "bytes", "scalar"]
    )
    spoilt = values.astype(np.float64) if np.issubdtype(values.dtype, np.number) else np.zeros(max(values.size, 1))
    flat = spoilt.reshape(-1)
    if flat.size:
        flat[random.randrange(flat.size)] = np.nan if way == "nan" else 9e29
    made = {
        "text": lambda: np.full(values.shape, "text"),
        "empty": lambda: np.empty((0, *values.shape[1:]), values.dtype),
        "flat": lambda: values.reshape(-1),
        "wider": lambda: np.stack([values, values], axis=-1),
        "shorter": lambda: values[: len(values) // 2],
        "whole numbers": lambda: values.astype(np.int64),
        "complex": lambda: values.astype(np.complex128),
        "nan": lambda: spoilt,
        "huge": lambda: spoilt,
        "bytes": lambda: np.full(values.shape, b"bytes"),
        "scalar": lambda: np.float64(1.0),
    }
    return way, np.asarray(made[way]())


def _npy(path: Path, content: bytes, random: Random) -> str:
    way, values = _other_array(np.load(io.BytesIO(content), allow_pickle=False), random)
    np.save(path, values)
    return way


def _npz(path: Path, content: bytes, random: Random) -> str:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = random.choice(sorted(arrays))
    way, arrays[name] = _other_array(arrays[name], random)
    np.savez(path, **arrays)
    return f"{way} {name}"


def _hdf5(path: Path, content: bytes, random: Random) -> str:
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        name = random.choice(sorted(names))
        values = file[name][()]
        del file[name]
        way = random.choice(["group", "array", "array", "soft link", "external link", "rows"])
        if way == "group":
            file.create_group(name)
        elif way == "soft link":
            file[name] = h5py.SoftLink("/" + name)
        elif way == "external link":
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif way == "rows":
            file.create_dataset(name, shape=(2**38, *values.shape[1:]), dtype=values.dtype, chunks=True)
        else:
            way, other = _other_array(np.asarray(values), random)
            file[name] = other.astype("S") if other.dtype.kind == "U" else other
    return f"{way} {name}"


def _parquet(path: Path, content: bytes, random: Random) -> str:
    table = pq.read_table(io.BytesIO(content))
    place = random.randrange(table.num_columns)
    name = table.column_names[place]
    column = table.column(place)
    way = random.choice(["dropped", "nulls", "text", "rows repeated", "rows lost", "reversed", "renamed"])
    if way == "dropped":
        table = table.remove_column(place)
    elif way == "nulls":
        table = table.set_column(place, name, pa.nulls(len(column), column.type))
    elif way == "text":
        table = table.set_column(place, name, pa.array(["text"] * len(column)))
    elif way == "rows repeated":
        table = pa.concat_tables([table, table.slice(0, 1)])
    elif way == "rows lost":
        table = table.slice(0, len(table) // 2)
    elif way == "reversed":
        table = table.take(list(reversed(range(len(table)))))
    else:
        table = table.rename_columns([f"{each}x" if each == name else each for each in table.column_names])
    pq.write_table(table, path)
    return f"{way} {name}"


_CHANGES = {".npy": _npy, ".npz": _npz, ".hdf5": _hdf5, ".h5": _hdf5, ".parquet": _parquet}
