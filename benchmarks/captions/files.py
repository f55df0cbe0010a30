"""Files of captions with their references, and of motion tokens with texts (docs/specification/captions.md#files)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int

from prbench.errors import InputFileError
from prbench.files.arrays import first_repeated, read_parquet
from prbench.files.bounded import foreign_input, read_text, require, require_rows
from prbench.files.storage import atomic_path, file_digest, sole_writer, text_digest, write_bytes

_COLUMNS = pa.schema({"motion_id": pa.string(), "tokens": pa.list_(pa.int32()), "text": pa.list_(pa.string())})
_SPLITS = {"train", "validation", "test"}


class CaptionRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line of a file of captions.

    Attributes:
        motion_id: Name of the motion.
        candidate: The caption that is scored; may be empty.
        references: Texts that people wrote of the motion.
        cut: The captioner reached its limit before the caption's end.
    """

    motion_id: str
    candidate: str
    references: tuple[str, ...]
    cut: bool = False


def has_letters(text: str | None) -> bool:
    """Return True for a text that says something."""
    return any(map(str.isalpha, text or ""))


@foreign_input()
def read_captions(path: Path) -> tuple[CaptionRow, ...]:
    """Read captions from JSON Lines.

    Raises:
        InputFileError: naming the line, if a field is missing or of another kind, a reference has no letters, or a
            motion stands there twice.
    """
    rows = []
    for number, line in enumerate(read_text(path, expected="captions as JSON Lines").split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = msgspec.json.decode(line, type=CaptionRow)
        except msgspec.DecodeError as error:  # a ValidationError is one
            expected = "an object with motion_id, candidate and references (a list of texts)"
            raise InputFileError(path, f"line {number}", expected=expected, found=str(error)) from error
        good = bool(row.references) and all(map(has_letters, row.references))
        wanted = ("one text with letters or more", list(row.references), "Leave the motion, or the empty text, out.")
        require(path, (good, f"line {number}, references", *wanted))
        rows.append(row)
    twice = first_repeated(row.motion_id for row in rows)
    once = (twice is None, "motion_id", "every motion once", f"'{twice}' again", "Put its references in one line.")
    require(path, (rows, "", "at least one caption", "none", ""), once)
    return tuple(rows)


def write_captions(path: Path, rows: Sequence[CaptionRow]) -> None:
    """Write captions as JSON Lines, whole or not at all."""
    with sole_writer(path):
        write_bytes(path, b"".join(msgspec.json.encode(row) + b"\n" for row in rows))


@dataclass(frozen=True)
class TokensRow:
    """A motion as tokens, and its texts, each of which describes all of it."""

    motion_id: str
    tokens: Int[np.ndarray, " tokens"]
    text: tuple[str, ...]
    split: str


def write_tokens(path: Path, rows: Sequence[TokensRow], *, codes: int, **about: str) -> None:
    """Write motions as tokens, whole or not at all, with these metadata; equal rows give equal bytes."""
    schema = _COLUMNS.append(pa.field("split", pa.string())).with_metadata({"codes": str(codes), **about})
    columns = {name: [getattr(row, name) for row in rows] for name in schema.names}
    with sole_writer(path), atomic_path(path) as temporary:
        pq.write_table(pa.table(columns, schema=schema), temporary, compression="zstd", compression_level=1)


@dataclass(frozen=True)
class TokensFile:
    """Motions with texts; those without any are left out.

    Attributes:
        path: The file.
        codes: Number of different tokens; they are 0 to ``codes`` - 1.
        rows: The motions.
        left_out: Number of motions without a text that has letters.
        dataset: Name of the corpus, by the file's metadata; else the file's name.
        title: The file's name.
        synthetic: The people are synthetic, by the metadata.
        licence: Licence of motions and texts, by the metadata.
        identity_digest: Digest of the motions' names.
        content_digest: SHA-256 of the file.
    """

    path: Path
    codes: int
    rows: tuple[TokensRow, ...]
    left_out: int
    dataset: str
    title: str
    synthetic: bool
    licence: str
    identity_digest: str
    content_digest: str

    @property
    def info(self) -> TokensFile:
        """What a training's card tells of a table, which here is in the file itself."""
        return self

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> TokensFile:
        """Read a Parquet file with the columns ``motion_id``, ``tokens`` and ``text``; without ``split`` all is train.

        Raises:
            InputFileError: naming row and column, if something is missing, of another kind, or out of range, a motion
                stands there twice, or none has a text.
        """
        try:
            table = read_parquet(path)
            ids, lists, texts = table.select(_COLUMNS.names).cast(_COLUMNS).columns
        except (pa.ArrowException, KeyError) as error:
            expected = "a Parquet file with motion_id (text), tokens (whole numbers) and text (a list of texts) a row"
            raise InputFileError(path, "", expected=expected, found=str(error).rstrip(".")) from error
        names = ids.to_pylist()
        splits = table["split"].to_pylist() if "split" in table.column_names else ["train"] * len(names)
        about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
        codes = about.get("codes", "none")
        most = int(codes) if codes.isdecimal() and len(codes) < 8 else 0
        twice = first_repeated(names)
        other = set(splits) - _SPLITS
        require(
            path,
            (most, "metadata key 'codes'", "how many different tokens there are, 1 or more", codes, ""),
            (None not in names, "column 'motion_id'", "a name in every row", "none", ""),
            (twice is None, "column 'motion_id'", "every motion once", f"'{twice}' again", ""),
            (not other, "column 'split'", "train, validation or test", ", ".join(map(str, other)), ""),
        )
        array = lists.combine_chunks()
        values = array.values.fill_null(-1).to_numpy(zero_copy_only=False)
        tokens = [values[first:last] for first, last in pairwise(array.offsets.to_numpy())]
        beyond = np.array([not each.size or each.min() < 0 or each.max() >= most for each in tokens], dtype=bool)
        expected = f"one token or more, from 0 to {most - 1}"
        row_of = {"place": "row", "first": 1, "column": "tokens"}
        require_rows(path, beyond, expected, lambda row: f"{tokens[row].tolist()[:8]}", **row_of)
        kept = [tuple(filter(has_letters, each or ())) for each in texts.to_pylist()]
        rows = tuple(TokensRow(*row) for row in zip(names, tokens, kept, splits, strict=True) if row[2])
        require(path, (rows, "column 'text'", "a text with letters", f"none in {len(names)} rows", ""))
        known = {"dataset": about.get("dataset", path.stem), "licence": about.get("licence", "unknown")}
        known |= {"identity_digest": text_digest(*names), "content_digest": file_digest(path), "title": path.name}
        left_out = len(names) - len(rows)
        return cls(path, most, rows, left_out, synthetic=about.get("synthetic") == "true", **known)
