"""A conditions file in memory: its rows, batches of them, and what it says about itself, which never names the data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int

from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import text_digest
from prbench.harness.planning import rows_of

FORMAT_VERSION = 1
METADATA_KEY = "prbench_conditions"
"""Key of the Parquet metadata, and name of the array in an ``.npz``, that holds the information as JSON."""
DEFAULT_BATCH_SIZE = 64
_SUFFIXES = (".parquet", ".npz")


class ConditionsInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings that the rows of a conditions file were made with. A method may see them as it may see the rows."""

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    """The run's seed, behind opaque ids and noise seeds."""
    samples: int
    """Rows of each sequence, with noise of their own."""
    split: str
    limit: int | None
    max_frames: int | None
    """Longer sequences, at the rate of the file, were left out."""
    native_fps: float | None
    """Rate that ``n_frames`` and ``fps`` are given at; None for the table's own."""
    protocol_version: int
    tables: tuple[str, ...]
    """Fingerprints of the tables, sorted."""

    def as_json(self) -> str:
        """One line, sorted keys."""
        return msgspec.json.encode(self, order="sorted").decode()

    @classmethod
    def from_json(cls, text: str | bytes, path: Path) -> ConditionsInfo:
        """Read what :meth:`as_json` wrote.

        Args:
            text: JSON.
            path: The file that it stands in, for messages.

        Raises:
            InputFileError: if it is of a newer version or not what the format asks for.
        """
        remedy = "Export the conditions again with `prbench export-conditions`."
        try:
            version = msgspec.json.decode(text, type=_Versioned).format_version
            if version == FORMAT_VERSION:
                return msgspec.json.decode(text, type=cls)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise InputFileError(
                path, METADATA_KEY, expected="what prbench wrote about the file", found=str(error), remedy=remedy
            ) from error
        raise InputFileError(
            path, METADATA_KEY, expected=f"format version {FORMAT_VERSION}", found=str(version), remedy=remedy
        )


class _Versioned(msgspec.Struct):
    format_version: int


def fingerprints(identities: Iterable[str]) -> tuple[str, ...]:
    """One digest a table, sorted. Whoever has the table recognises it; the key of the opaque ids does not follow.

    Args:
        identities: Identity digests of the tables.
    """
    return tuple(sorted(text_digest("prbench conditions", identity) for identity in identities))


@dataclass(frozen=True)
class SampledBatch:
    """Some rows of a conditions file as a method gets them."""

    sample: int
    """Number of the motion that is drawn of each sequence; the same for all rows."""
    rows: Int[np.ndarray, " batch"]
    """Their places in the file, from 0."""
    batch: ConditionBatch


@dataclass(frozen=True, kw_only=True)
class ConditionsFile:
    """One row a motion to be generated, sorted by opaque id, then sample. Canonical frame, metres."""

    info: ConditionsInfo
    opaque_id: tuple[str, ...]
    sample: Int[np.ndarray, " n"]
    noise_seed: Int[np.ndarray, " n"]
    n_frames: Int[np.ndarray, " n"]
    fps: Float[np.ndarray, " n"]
    text: tuple[str, ...] | None = None
    initial_joints: Float[np.ndarray, "n 22 3"] | None = None
    previous_joints: Float[np.ndarray, "n 22 3"] | None = None
    goal_joints: Float[np.ndarray, "n 22 3"] | None = None
    goal_location: Float[np.ndarray, "n 3"] | None = None

    def __len__(self) -> int:
        return len(self.opaque_id)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the columns that depend on the condition, in the order of the format."""
        return given_columns(self.info.condition)

    def rows(self, rows: Int[np.ndarray, " rows"]) -> ConditionsFile:
        """Some of the rows, in the order given."""
        return rows_of(self, rows)

    def batches(self, batch_size: int = DEFAULT_BATCH_SIZE) -> Iterator[SampledBatch]:
        """All rows in batches of one sample and one frame rate, each as long as the file's order allows.

        Args:
            batch_size: Largest number of rows in a batch.
        """
        if batch_size < 1:
            raise UsageError(f"expected a batch size of 1 or more, found {batch_size}.")
        for sample in np.unique(self.sample):
            for fps in np.unique(self.fps):
                rows = np.flatnonzero((self.sample == sample) & (self.fps == fps))
                for start in range(0, len(rows), batch_size):
                    part = rows[start : start + batch_size]
                    yield SampledBatch(int(sample), part, self.rows(part)._as_batch(float(fps)))

    def _as_batch(self, fps: float) -> ConditionBatch:
        given: dict[str, Any] = {name: getattr(self, name) for name in self.given}
        return ConditionBatch(
            condition=self.info.condition,
            n_frames=self.n_frames.astype(np.int64),
            fps=fps,
            opaque_id=self.opaque_id,
            noise_seed=tuple(self.noise_seed.tolist()),
            **given,
        )


def given_columns(condition: Condition) -> tuple[str, ...]:
    """Return the columns that a condition fills beyond those that every file has, in the order of the format."""
    order = ("text", "initial_joints", "previous_joints", "goal_joints", "goal_location")
    return tuple(name for name in order if name in GIVEN[condition])


def require_suffix(path: Path) -> None:
    """Refuse a name that does not say which format is meant.

    Raises:
        UsageError: naming the two suffixes.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path}: expected a name that ends in {' or '.join(_SUFFIXES)}, found '{path.suffix}'.")
