"""Files of captions with their references, and of motion tokens with texts (docs/specification/captions.md#files)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.errors import InputFileError
from prbench.files.arrays import first_repeated, read_parquet
from prbench.files.bounded import foreign_input, read_text, require, require_rows
from prbench.files.storage import file_digest, sole_writer, text_digest, write_bytes

_SPLITS = ("train", "validation", "test")
_MOST_CODES = 2**20


class CaptionRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line of a file of captions.

    Attributes:
        motion_id: Name of the motion.
        candidate: The caption that is scored.
        references: What people said of the motion.
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
    """Read captions: JSON Lines, or Parquet with the same columns where the file is called ``.parquet``.

    Raises:
        InputFileError: naming the line, if a field is missing or of another kind, a motion stands there twice, or a
            reference has no letters; an empty candidate is a caption as any other.
    """
    kind = "row" if path.suffix == ".parquet" else "line"
    rows: list[CaptionRow] = []
    places: list[int] = []
    for number, decode, content in _entries(path):
        try:
            rows.append(decode(content, type=CaptionRow))
        except msgspec.DecodeError as error:  # a ValidationError is one
            expected = "an object with motion_id, candidate and references (a list of texts)"
            raise InputFileError(path, f"{kind} {number}", expected=expected, found=str(error)) from error
        places.append(number)
    require(path, (rows, "", "at least one caption", "none", ""))
    for number, row in zip(places, rows):
        where = f"{kind} {number}, references of '{row.motion_id}'"
        good = bool(row.references) and all(map(has_letters, row.references))
        expected = "one text with letters or more"
        remedy = "Leave this motion, or the empty text, out."
        require(path, (good, where, expected, str(list(row.references)), remedy))
    twice = first_repeated(row.motion_id for row in rows)
    require(path, (twice is None, "motion_id", "every motion once", f"'{twice}' again", "Join its references."))
    return tuple(rows)


def _entries(path: Path) -> Iterator[tuple]:
    """Yield the number of each line or row, what decodes it, and its content."""
    if path.suffix == ".parquet":
        yield from ((place, msgspec.convert, row) for place, row in enumerate(_table(path).to_pylist(), start=1))
        return
    lines = read_text(path, expected="captions as JSON Lines").split("\n")
    yield from ((place, msgspec.json.decode, line) for place, line in enumerate(lines, start=1) if line.strip())


def write_captions(path: Path, rows: Sequence[CaptionRow]) -> None:
    """Write captions as JSON Lines, whole or not at all."""
    with sole_writer(path):
        write_bytes(path, b"".join(msgspec.json.encode(row) + b"\n" for row in rows))


class TokensInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What is known of a file of tokens; from its metadata, where they say.

    Attributes:
        dataset: Name of the corpus.
        title: Its title, else the file's name.
        synthetic: The people are synthetic.
        licence: Licence of texts and motions.
        identity_digest: Digest of the motions' names.
        content_digest: SHA-256 of the file.
    """

    dataset: str
    title: str
    synthetic: bool
    licence: str
    identity_digest: str
    content_digest: str


@dataclass(frozen=True, eq=False)
class TokensFile:
    """Motions as tokens, each with one text or more that describe all of it.

    Attributes:
        codes: Number of different tokens; those of a motion are 0 to ``codes`` - 1.
        splits: Split of each motion; None where the file has none, and every motion is of any split.
        left_out: Number of motions without any text that has letters.
        empty_texts: Number of texts without letters, which are left out.
    """

    path: Path
    info: TokensInfo
    codes: int
    motion_ids: tuple[str, ...]
    tokens: tuple[Int[np.ndarray, " tokens"], ...]
    texts: tuple[tuple[str, ...], ...]
    splits: tuple[str | None, ...]
    left_out: int
    empty_texts: int

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> TokensFile:
        """Read a Parquet file with the columns ``motion_id``, ``tokens``, ``text``, and ``split`` where it has one.

        Raises:
            InputFileError: naming row and column, if something is missing, of another kind, or out of range; if a
                motion stands there twice; or if no motion has a text.
        """
        table = _table(path)
        columns = {"motion_id": pa.string(), "tokens": pa.list_(pa.int32()), "text": pa.list_(pa.string())}
        if "split" in table.column_names:
            columns["split"] = pa.string()
        found = {}
        for name, kind in columns.items():
            require(path, (name in table.column_names, "", f"a column '{name}'", ", ".join(table.column_names), ""))
            try:
                found[name] = table[name].cast(kind).combine_chunks()
            except pa.ArrowException as error:
                is_kind = str(table[name].type)
                raise InputFileError(path, f"column '{name}'", expected=str(kind), found=is_kind) from error
            missing = np.asarray(found[name].is_null())
            require_rows(path, missing, "a value", "none", place="row", first=1, column=name)
        about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
        text = about.get("codes", "none")
        codes = int(text) if text.isdecimal() and len(text) < 9 else 0
        expected = f"a whole number from 1 to {_MOST_CODES}, how many different tokens there are"
        require(path, (1 <= codes <= _MOST_CODES, "metadata key 'codes'", expected, text, "Write the file again."))
        # A null among the tokens becomes -1, which is out of range.
        flat = found["tokens"].flatten().fill_null(-1).to_numpy(zero_copy_only=False)
        lengths = np.asarray(found["tokens"].value_lengths())
        tokens = np.split(flat, np.cumsum(lengths)[:-1]) if len(lengths) else []
        beyond = np.array([not part.size or part.min() < 0 or part.max() >= codes for part in tokens], dtype=bool)
        expected = f"one token or more, from 0 to {codes - 1}"
        shown = {"place": "row", "first": 1, "column": "tokens"}
        require_rows(path, beyond, expected, lambda row: f"{tokens[row].tolist()[:8]}", **shown)
        ids = found["motion_id"].to_pylist()
        twice = first_repeated(ids)
        require(path, (twice is None, "column 'motion_id'", "every motion once", f"'{twice}' again", ""))
        splits = found["split"].to_pylist() if "split" in found else [None] * len(ids)
        wrong = np.array([split is not None and split not in _SPLITS for split in splits], dtype=bool)
        require_rows(path, wrong, ", ".join(_SPLITS), lambda row: str(splits[row]), **shown | {"column": "split"})
        given = found["text"].to_pylist()
        texts = [tuple(filter(has_letters, each)) for each in given]
        kept = [place for place, each in enumerate(texts) if each]
        remedy = "A captioner learns from texts; write them beside the tokens."
        require(path, (kept, "column 'text'", "a text with letters", f"none in {len(ids)} rows", remedy))
        info = TokensInfo(
            dataset=about.get("dataset", path.stem),
            title=about.get("title", path.name),
            synthetic=about.get("synthetic") == "true",
            licence=about.get("licence", "unknown"),
            identity_digest=text_digest(*ids),
            content_digest=file_digest(path),
        )
        picked = (tuple(column[place] for place in kept) for column in (ids, tokens, texts, splits))
        return cls(path, info, codes, *picked, len(ids) - len(kept), sum(map(len, given)) - sum(map(len, texts)))

    def places(self, *splits: str) -> list[int]:
        """Return the places of the motions of some splits; all where none is named, or the file has none."""
        return [place for place, split in enumerate(self.splits) if not splits or split is None or split in splits]


def _table(path: Path) -> pa.Table:
    try:
        return read_parquet(path)
    except pa.ArrowException as error:
        raise InputFileError(path, "", expected="a Parquet file", found=str(error)) from error
