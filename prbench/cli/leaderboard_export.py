"""``prbench leaderboard export``: a leaderboard of finished runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.checked_runs import collected_runs, tables_option
from prbench.cli.commands import Answer, command
from prbench.cli.leaderboard import EXAMPLE
from prbench.cli.options import PATH, out_file_option, workers_option

if TYPE_CHECKING:
    from prbench.board.tables import Leaderboard


class BoardMetric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One metric of one row of a leaderboard.

    Attributes:
        metric: Id of the metric, such as ``prime_success``.
        title: Its name in tables.
        unit: ``rate`` (from 0 to 1), ``ratio``, or a unit such as ``m``.
        mean: Mean over sequences.
        low: Lower bound of the interval of the mean; null where the data support none.
        high: Upper bound of the interval.
        level: Confidence level of the interval, such as 0.95.
        interval: Name of the estimator of the interval.
        sequences: Number of sequences behind the mean.
        recordings: Number of recordings that they come from.
        marks: What a reader of the interval needs to know: ``few_recordings``, ``one_recording``, ``all_equal``.
        flags: Number of motions that carry each remark.
        detectable: Smallest difference to an unrelated method of the same spread that is found with 80 % power, among
            the metrics that are compared; null where nothing can be tested.
        uncertainty: Shares of the mean's variance that come from ``recordings``, ``sequences`` and ``samples``.
    """

    metric: str
    title: str
    unit: str
    mean: float | None
    low: float | None
    high: float | None
    level: float
    interval: str
    sequences: int
    recordings: int
    marks: list[str]
    flags: dict[str, int]
    detectable: float | None
    uncertainty: dict[str, float]


class BoardCost(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The cost of a motion, on the machine of the run; null where nothing was measured or declared.

    Attributes:
        seconds_per_motion: Seconds a motion, batched as the run was.
        passes_per_motion: Network passes a motion, as the method declares.
        memory_mebibytes: Largest memory of the device, else of the process, in MiB.
        parameters: Parameters of the method's networks.
    """

    seconds_per_motion: float | None
    passes_per_motion: float | None
    memory_mebibytes: float | None
    parameters: int | None


class BoardRow(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run in the table of a dataset.

    Attributes:
        run: Name of the run folder.
        method: Name of the method.
        kind: ``built-in``, ``package``, ``program``, ``file``, ``control`` or ``unknown``: how it was reached.
        package: Package that the method was installed from, the program's command, or the name of the motions' file.
        isolation: How the method was kept apart (``process``, ``bubblewrap`` or ``container``); null if it was not.
        mark: A remark about its motions that readers must know; empty if there is none.
        version: Version of the package.
        weights_digest: Digest of its weights; null without weights.
        condition: What the method was given.
        control: ``shuffled-goal`` if it was given other sequences' goals; null if not.
        variant: Control, weights, options and the like, by which rows of one method differ.
        seed: Seed of the run.
        samples: Number of motions kept of each sequence.
        best_of: Number of motions drawn for each that was kept.
        gaze: Whether the motions bring gaze that the method generated.
        obstacles: Whether the method was given the solid boxes around each sequence.
        carry_on: Whether every put starts where the generated pick before it ends.
        scored: Number of sequences behind the numbers.
        verified: Whether the scores were held against the motions.
        why_unverified: The reason why not; empty if they were.
        unsupported: Number of sequences that are longer than the method can generate.
        ranks: Maps ids of metrics to ranks: one more than the number of methods that are better by a supported
            difference; empty where nothing is ranked.
        leads: Ids of metrics in which it is better than every other method, each by a supported difference.
        metrics: The scores.
        cost: Cost of a motion.
        says_nothing: Ids of metrics that say nothing about this method, because it stands still.
    """

    run: str
    method: str
    kind: str
    package: str
    isolation: str | None
    mark: str
    version: str
    weights_digest: str | None
    condition: str
    control: str | None
    variant: str
    seed: int
    samples: int
    best_of: int
    gaze: bool
    obstacles: bool
    carry_on: bool
    scored: int
    verified: bool
    why_unverified: str
    unsupported: int
    ranks: dict[str, int]
    leads: list[str]
    metrics: list[BoardMetric]
    cost: BoardCost
    says_nothing: list[str]


class BoardTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Runs on one dataset that compare: protocol, table, split and sequences agree.

    Attributes:
        dataset: Name of the dataset.
        title: The same for readers; holds the word "synthetic" where the data are.
        synthetic: Whether the data are synthetic.
        redistribution: Whether the licence lets recorded motion be passed on.
        protocol_digest: Digest of the rules by which the rows were scored.
        identity_digest: Digest of the table's sequences and their ids.
        content_digest: Digest of the table's content.
        split: Split of the table.
        selection_digest: Digest of the chosen sequences.
        own_protocol: Name and version of a protocol of the user's own; empty for prbench's.
        chosen_sequences: Number of the chosen sequences; above ``sequences`` where the table is of those alone that
            every method generated.
        left_sequences_out: Methods that left chosen sequences out, with how many.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        undecided: Sentences on what the data cannot decide, and the smallest differences that they can.
        rows: The runs, sorted by condition, controls last.
        benchmark: Name of the benchmark; absent for prime-and-reach.
    """

    dataset: str
    title: str
    synthetic: bool
    redistribution: str
    protocol_digest: str
    identity_digest: str
    content_digest: str
    split: str
    selection_digest: str
    own_protocol: str
    chosen_sequences: int
    left_sequences_out: list[str]
    sequences: int
    recordings: int
    undecided: list[str]
    rows: list[BoardRow]
    benchmark: str = ""


class MacroMean(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Means of one method over several datasets, each dataset counting alike.

    Attributes:
        method: Name of the method.
        kind: Whose method it is, in words.
        mark: A remark about its motions that readers must know; empty if there is none.
        condition: What the method was given.
        variant: Control, weights, options and the like, by which rows of one method differ.
        means: Maps ids of metrics to means; empty if the method lacks a dataset.
        intervals: Maps ids of metrics to the two bounds of the mean's 95 % interval, where each dataset has one.
        ranks: Maps ids of metrics to ranks, from 1; empty where nothing is ranked.
        verified: Whether the scores on all datasets were held against the motions.
        missing: Datasets that the method lacks.
    """

    method: str
    kind: str
    mark: str
    condition: str
    variant: str
    means: dict[str, float | None]
    intervals: dict[str, list[float]]
    ranks: dict[str, int]
    verified: bool
    missing: list[str]


class MacroMeans(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Methods over all datasets of one protocol.

    Attributes:
        datasets: Names of the datasets.
        synthetic: Whether one of them is synthetic.
        rows: The methods.
        benchmark: Name of the benchmark; absent for prime-and-reach.
    """

    datasets: list[str]
    synthetic: bool
    rows: list[MacroMean]
    benchmark: str = ""


class PublishedDifference(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured number beside the one that the study prints: rates in %, lengths in metres.

    Attributes:
        table: Table of the study, such as ``2``.
        dataset: Name of the dataset.
        condition: What the method was given.
        method: Name of the method.
        variant: Of the measured row.
        published_variant: Of the study's row that it stands beside.
        metric: Id of the metric.
        unit: ``%``, ``m`` or ``ratio``.
        measured: The measured number.
        published: The study's number.
        difference: measured - published.
        low: Lower bound of the difference's 95 % interval; null where the measured number has none.
        high: Upper bound of the interval.
        sequences: Number of sequences behind the measured number.
        published_sequences: Number of sequences in the study's test split.
        verified: Whether the measured scores were held against the motions.
        assumptions: Ids of what the study leaves open and could explain the difference.
        remarks: What else could.
        source: Where the study prints the number.
    """

    table: str
    dataset: str
    condition: str
    method: str
    variant: str
    published_variant: str
    metric: str
    unit: str
    measured: float
    published: float
    difference: float
    low: float | None
    high: float | None
    sequences: int
    published_sequences: int
    verified: bool
    assumptions: list[str]
    remarks: list[str]
    source: str


class Board(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A leaderboard; ``--format json`` writes the same.

    Attributes:
        schema_version: Version of this shape.
        tables: One table for each dataset and way of scoring it.
        macro_means: Means over datasets, for each protocol with two datasets or more.
        notes: What was left out, and which tables must not be compared.
        published: With ``--with-published``: differences to the study's numbers, on real recordings only; absent if
            there are none.
        assumptions: Maps the ids that they name to what the study leaves open; absent if there are none.
        not_beside_published: A sentence for each run beside which no published number stands; absent without.
    """

    schema_version: int
    tables: list[BoardTable]
    macro_means: list[MacroMeans]
    notes: list[str]
    published: list[PublishedDifference] = []
    assumptions: dict[str, str] = {}
    not_beside_published: list[str] = []


class BoardReport(msgspec.Struct, frozen=True, kw_only=True):
    """An exported leaderboard.

    Attributes:
        format: ``md``, ``csv`` or ``json``: what ``out`` is written in.
        out: The file; null if the leaderboard was printed.
        board: The leaderboard.
    """

    format: str
    out: Path | None
    board: Board


@command("export", example=EXAMPLE, report=BoardReport)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@click.option(
    "--format",
    type=click.Choice(["md", "csv", "json"]),
    default="md",
    help="Markdown (default), CSV or JSON.",
)
@out_file_option("Write the leaderboard to this file instead of printing it.")
@click.option(
    "--with-published",
    is_flag=True,
    help="Show the study's numbers behind the measured ones, and how far runs on real recordings are from them.",
)
@tables_option
@workers_option()
def export(
    runs: tuple[Path, ...], format: str, out: Path | None, with_published: bool, data: tuple[Path, ...], workers: int
) -> Answer:
    """Write a leaderboard of finished runs.

    RUN are run folders, or folders that hold some.
    """
    from prbench import board as boards
    from prbench.files.locks import sole_writer
    from prbench.files.storage import write_text

    board = boards.make_leaderboard(collected_runs(runs, data, workers, any_benchmark=True))
    text = _exported(board, format, with_published=with_published)
    if out is not None:
        with sole_writer(out):
            write_text(out, text)
    exported = msgspec.json.decode(_exported(board, "json", with_published=with_published), type=Board)
    report = BoardReport(format=format, out=out, board=exported)
    return Answer(report, lambda: print(text, end="") if out is None else print(f"leaderboard: {out}"))


def _exported(board: Leaderboard, format: str, *, with_published: bool) -> str:
    """Write a leaderboard in a format, with the study's numbers behind it if asked for."""
    from prbench import board as boards

    text = boards.export(board, format)
    if not with_published:
        return text
    from prbench.workflows.study.beside import add_published

    return add_published(text, board, format)
