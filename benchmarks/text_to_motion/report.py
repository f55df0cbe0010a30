"""The result of a text-to-motion evaluation as a file: everything that decides its numbers, and the numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from prbench.files.boundary import foreign_input
from prbench.files.bounded import read_whole
from prbench.files.locks import sole_writer
from prbench.files.storage import write_json
from prbench_benchmarks.text_to_motion.generated import Generator
from prbench_benchmarks.text_to_motion.metrics import METRICS, Measured, Repeated

SCHEMA_VERSION = 1


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """A metric over repetitions: mean ± 1.96 · population standard deviation / √repetitions."""

    mean: float
    half_width: float | None
    values: tuple[float, ...]

    @classmethod
    def of(cls, repeated: Repeated) -> Interval:
        """The same as a part of a file."""
        return cls(mean=repeated.mean, half_width=repeated.half_width, values=repeated.values)


class ResultRow(msgspec.Struct, frozen=True, kw_only=True):
    """Real motions, real motions with other texts, or a method's."""

    source: str
    """``real``, ``real, texts shuffled`` or a method's name."""
    metrics: dict[str, Interval]
    """Maps ids of :data:`prbench_benchmarks.text_to_motion.metrics.METRICS` to values; R-precision from 0 to 1."""
    motions: int
    """A repetition."""
    ranked_pairs: int
    """Motions of a repetition that are in whole batches of 32."""
    dropped_pairs: int
    """Motions of the last, incomplete batch of a repetition."""
    duplicate_captions: float
    """Ranked texts that equal another one of their batch, mean over repetitions; such a pair is counted as a miss."""
    repetitions: int
    weights_sha256: str | None = None
    options: dict[str, str] = {}
    unsupported: int = 0
    """Clips that are longer than the method can generate."""


@dataclass
class RowTally:
    """The measurements of one row's repetitions so far."""

    values: dict[str, list[float]] = field(default_factory=dict)
    last: Measured | None = None
    motions: int = 0
    duplicates: list[int] = field(default_factory=list)

    def add(self, measured: Measured, values: dict[str, float], motions: int) -> None:
        """Take in one repetition over so many motions: the metrics of its pairs, and those of its motions."""
        for name, value in (measured.values | values).items():
            self.values.setdefault(name, []).append(value)
        self.last, self.motions = measured, motions
        self.duplicates.append(measured.ranking.n_duplicates)

    def result(self, source: str, generator: Generator | None = None, unsupported: int = 0) -> ResultRow:
        """The row after at least one repetition."""
        assert self.last is not None
        ranking = self.last.ranking
        return ResultRow(
            source=source,
            metrics={name: Interval.of(Repeated.of(self.values[name])) for name in METRICS if name in self.values},
            motions=self.motions,
            ranked_pairs=ranking.n_pairs,
            dropped_pairs=ranking.n_dropped,
            duplicate_captions=float(np.mean(self.duplicates)),
            repetitions=len(self.duplicates),
            weights_sha256=generator.weights_sha256 if generator else None,
            options=dict(generator.request.options) if generator else {},
            unsupported=unsupported,
        )


class TextEvaluation(msgspec.Struct, frozen=True, kw_only=True):
    """One evaluation. Rows are comparable within it, and with others of the same evaluator, corpus and settings."""

    kind: str = "text-to-motion-evaluation"
    schema_version: int = SCHEMA_VERSION
    vectorisation: str
    """The way in which the evaluator reads texts; numbers of different ones belong in different columns."""
    evaluator_sha256: str
    representation: str
    dataset: str
    corpus_content_digest: str
    split: str
    kinds: tuple[str, ...]
    clips: int
    left_out: int
    distinct_captions: int
    seed: int
    diversity_pairs: int
    prbench_version: str
    rows: tuple[ResultRow, ...]
    notes: tuple[str, ...]

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        # One file, one writer: two evaluations into the same path would leave the rows of either.
        with sole_writer(path):
            write_json(path, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> TextEvaluation:
        """Read what :meth:`write` wrote."""
        return msgspec.json.decode(read_whole(path), type=cls)
