"""The result of a text-to-motion evaluation as a file, and table S8 made of such files.

A file holds everything that decides its numbers, and the numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import sole_writer, write_json
from prbench.metrics import exported_unit
from prbench.protocol.published import load_published, published_table
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench_benchmarks.text_to_motion.metrics import Repeated

SCHEMA_VERSION = 1


class Retrieval(msgspec.Struct, frozen=True, kw_only=True):
    """How well texts find their motions, or motions their texts.

    Attributes:
        query: What asks: ``text`` or ``motion``.
        candidates: Number of pairs ranked together: 32, or all of a repetition.
        hit: What counts as a hit: the ``own`` partner, or any with the ``same caption``.
        r_at_1: Share of queries whose nearest candidate is a hit, from 0 to 1.
        r_at_5: The same for a hit among the nearest five.
        r_at_10: The same for a hit among the nearest ten.
        median_rank: Median over queries of the first hit's rank, from 1.
    """

    query: str
    candidates: int
    hit: str
    r_at_1: Repeated
    r_at_5: Repeated
    r_at_10: Repeated
    median_rank: Repeated


class ResultRow(msgspec.Struct, frozen=True, kw_only=True):
    """Real motions, real motions with other texts, or a method's motions.

    Attributes:
        source: ``real``, ``real, texts shuffled`` or the name of the method.
        metrics: Maps ids of metrics (``r_precision_top_1``, ``fid`` …) to their values.
        motions: Number of motions of a repetition.
        ranked_pairs: Number of those that are in whole batches of 32, within which texts are ranked.
        dropped_pairs: Number of those in the last, incomplete batch.
        duplicate_captions: Ranked texts that equal another one of their batch, mean over repetitions. The motion of
            the other counts as a wrong one.
        repetitions: Number of repetitions.
        weights_sha256: Digest of the method's weights; null without weights.
        options: Options of the method.
        unsupported: Number of clips that are longer than the method can generate.
        retrieval: Retrieval in both directions; empty unless it was asked for.
    """

    source: str
    metrics: dict[str, Repeated]
    motions: int
    ranked_pairs: int
    dropped_pairs: int
    duplicate_captions: float
    repetitions: int
    weights_sha256: str | None = None
    options: dict[str, str] = {}
    unsupported: int = 0
    retrieval: tuple[Retrieval, ...] = ()


class NearMotion(msgspec.Struct, frozen=True, kw_only=True):
    """A recorded clip near a generated motion, in the evaluator's space.

    Attributes:
        sequence_id: Sequence that the motion was generated for.
        sample: Which of the run's motions for it.
        rank: 1 for the nearest clip.
        clip: Id of the clip.
        distance: Euclidean distance of the embeddings, in units of the evaluator.
        texts: The clip's captions.
    """

    sequence_id: str
    sample: int
    rank: int
    clip: str
    distance: float
    texts: tuple[str, ...]


class TextEvaluation(msgspec.Struct, frozen=True, kw_only=True):
    """The match of motions and texts; rows compare within it, and with those of the same evaluator and settings.

    Attributes:
        kind: What the file is.
        schema_version: Version of the file's format.
        vectorisation: The way in which the evaluator reads texts; numbers of different ones never compare.
        evaluator_sha256: Digest of the evaluator's weights.
        representation: Name of the representation of motion that the evaluator reads.
        dataset: Name of the corpus or dataset.
        corpus_content_digest: Digest of its content.
        split: Split that was evaluated.
        kinds: Kinds of captions that were used; empty for all.
        clips: Number of clips.
        left_out: Number of clips that were left out.
        distinct_captions: Number of different captions.
        seed: Seed of crops, captions, pairs and noise.
        diversity_pairs: Number of pairs of motions behind the diversity.
        prbench_version: Version that measured.
        rows: The rows of the table; none with ``nearest``.
        nearest: Clips nearest to each motion of a run, where they were asked for.
        notes: What a reader of the numbers has to know.
    """

    kind: str = "text-to-motion-evaluation"
    schema_version: int = SCHEMA_VERSION
    vectorisation: str
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
    nearest: tuple[NearMotion, ...] = ()
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


# What a cell takes over from a printed number.
_SAME = ("dataset", "condition", "method", "variant", "metric", "value", "note")
# The study's four metrics: title, direction of the better values, stored unit.
_METRICS: dict[str, tuple[str, Literal["higher", "lower"], str]] = {
    "r_precision_top_3": ("R Precision Top-3", "higher", "rate"),
    "fid": ("FID", "lower", ""),
    "multimodal_distance": ("Multimodal Distance", "lower", ""),
    "diversity": ("Diversity", "higher", ""),
}
_NOT_RECOMPUTED = "as reported by the file; motions are not at hand to hold the numbers against"


def table_s8(paths: Sequence[Path], *, with_published: bool) -> Table:
    """Make Table S8 from evaluations.

    Args:
        paths: Files of ``prbench evaluate-text``.
        with_published: Show the study's rows in a block of their own. They come from another evaluator and another
            test set, so there is no difference to them.

    Raises:
        InputFileError: if a file is no evaluation, or holds nearest motions in place of metrics.
    """
    evaluations = {path: TextEvaluation.read(path) for path in paths}
    blocks = []
    for path, found in evaluations.items():
        if not found.rows:
            raise InputFileError(path, "rows", expected="metrics", found="none", remedy="Leave --nearest away.")
        title = (
            f"{path.name}: {found.dataset}, split {found.split}, {found.clips} clips, evaluator"
            f" {found.evaluator_sha256[:8]} ({found.vectorisation})"
        )
        rows = []
        for row in found.rows:
            about = {"dataset": found.dataset, "condition": "text", "method": row.source, "sequences": row.motions}
            cells = []
            for name, (_, _, unit) in _METRICS.items():
                measured = row.metrics.get(name)
                if measured is None:
                    continue
                half = measured.half_width
                bounds = (None, None) if half is None else (measured.mean - half, measured.mean + half)
                cells.append(metric_cell(name, unit, measured.mean, *bounds, note=_NOT_RECOMPUTED, **about))
            rows.append(Row(text={"motions": row.source}, cells=tuple(cells)))
        blocks.append(Block(title=title, rows=tuple(rows)))
    if with_published:
        rows = {}
        for number in load_published("S8"):
            plus_minus = f" ± {number.plus_minus}" if number.plus_minus else ""
            words, cells = rows.setdefault(number.variant, ({"motions": number.variant}, []))
            words[number.metric] = f"{number.printed}{plus_minus}"
            cell = Cell(
                **{name: getattr(number, name) for name in _SAME},
                sd=float(number.plus_minus) if number.plus_minus else None,
                unit=exported_unit(_METRICS[number.metric][2]),
                origin=number.source,
            )
            cells.append(cell)
        published = tuple(Row(text=words, cells=tuple(cells)) for words, cells in rows.values())
        blocks.append(Block(title="Published: Prime and Reach, Table S8, Nymeria, another evaluator", rows=published))
    columns = [
        Column(key=name, title=title, better=better, unit=exported_unit(unit))
        for name, (title, better, unit) in _METRICS.items()
    ]
    return Table(
        number="S8",
        title=published_table("S8").title,
        columns=(Column(key="motions", title="Motions", text=True), *columns),
        blocks=tuple(blocks),
        notes=(
            "Intervals of measured numbers, and ±, are 1.96 standard errors over repetitions. Numbers of different"
            " evaluators never compare.",
            f"Measured numbers stand {_NOT_RECOMPUTED}.",
            *published_table("S8").notes,
            *(note for found in evaluations.values() for note in found.notes),
        ),
    )
