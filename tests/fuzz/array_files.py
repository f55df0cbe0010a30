"""Damages that only a program makes: arrays and tables of another kind, shape or content in sound files."""

from __future__ import annotations

import io
from pathlib import Path
from random import Random

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
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
        ["text", "empty", "flat", "wider", "shorter", "whole numbers", "complex", "nan", "huge", "bytes", "scalar",
         "swapped columns", "frozen", "millimetres", "kilometres", "negated", "reversed", "shifted", "zeros", "half",
         "big-endian", "Fortran", "repeated", "lost row", "dates", "records", "masks", "one axis more",
         "negative zeros"]
    )  # fmt: skip
    spoilt = values.astype(np.float64) if np.issubdtype(values.dtype, np.number) else np.zeros(max(values.size, 1))
    half = len(values) // 2 if values.ndim else 0
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
        "swapped columns": lambda: values[..., ::-1],
        "frozen": lambda: values[np.minimum(np.arange(len(values)), half)],
        "millimetres": lambda: values * 1000,
        "kilometres": lambda: values / 1000,
        "negated": lambda: -values,
        "reversed": lambda: values[::-1],
        "shifted": lambda: np.roll(values, 1, axis=0),
        "zeros": lambda: np.zeros_like(values),
        "half": lambda: values.astype(np.float16),
        "big-endian": lambda: values.astype(values.dtype.newbyteorder(">")),
        "Fortran": lambda: np.asfortranarray(values),
        "repeated": lambda: np.concatenate([values[:1], values]),
        "lost row": lambda: np.delete(values, half, axis=0),
        "dates": lambda: np.full(values.shape, np.datetime64("2024-02-29")),
        "records": lambda: np.zeros(values.shape, dtype=[("x", "f4"), ("y", "i8")]),
        "masks": lambda: values.astype(bool),
        "one axis more": lambda: values[None],
        "negative zeros": lambda: np.full(values.shape, -0.0),
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
    way = random.choice(
        ["dropped", "nulls", "text", "rows repeated", "rows lost", "reversed", "renamed", "upper case", "twice",
         "frozen", "swapped columns", "thousandfold", "one row lost", "id everywhere", "no rows", "other order",
         "no metadata", "dictionary", "negated"]
    )  # fmt: skip
    like = [name for name in table.column_names if table.schema.field(name).type == column.type]
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
    elif way == "twice":
        table = table.append_column(name, column)
    elif way in ("frozen", "id everywhere"):
        table = table.set_column(place, name, pa.chunked_array([column.combine_chunks().take([0] * len(column))]))
    elif way == "swapped columns":
        other = random.choice(like)
        table = table.set_column(place, name, table[other]).set_column(table.column_names.index(other), other, column)
    elif way in ("thousandfold", "negated"):
        factor = -1 if way == "negated" else 1000
        table = table.set_column(place, name, pc.multiply(column, factor).cast(column.type))
    elif way == "one row lost":
        table = pa.concat_tables([table.slice(0, len(table) // 2), table.slice(len(table) // 2 + 1)])
    elif way == "no rows":
        table = table.slice(0, 0)
    elif way == "other order":
        table = table.select(table.column_names[::-1])
    elif way == "no metadata":
        table = table.replace_schema_metadata(None)
    elif way == "dictionary":
        table = table.set_column(place, name, column.dictionary_encode())
    else:
        new = name.upper() if way == "upper case" else f"{name}x"
        table = table.rename_columns([new if each == name else each for each in table.column_names])
    pq.write_table(table, path)
    return f"{way} {name}"


_CHANGES = {".npy": _npy, ".npz": _npz, ".hdf5": _hdf5, ".h5": _hdf5, ".parquet": _parquet}
