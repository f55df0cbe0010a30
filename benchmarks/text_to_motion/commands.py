"""``prbench evaluate-text``: text-to-motion metrics of recorded motion and of a method on any table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command, note
from prbench.cli.options import (
    PATH,
    POSITIVE,
    device_option,
    option_option,
    out_file_option,
    seed_option,
    split_option,
    threads_option,
    weights_option,
)
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench_benchmarks.text_to_motion.report import ResultRow, TextEvaluation

_TITLES = {
    "r_precision_top_1": "R-precision top 1, %",
    "r_precision_top_2": "R-precision top 2, %",
    "r_precision_top_3": "R-precision top 3, %",
    "fid": "FID",
    "multimodal_distance": "multimodal distance",
    "diversity": "diversity",
    "multimodality": "multimodality",
}


class RepeatedMetric(msgspec.Struct, frozen=True, kw_only=True):
    """A metric over repetitions.

    Attributes:
        mean: Mean over repetitions; R-precision from 0 to 1, all others in units of the evaluator.
        half_width: 1.96 times the population standard deviation over the root of the number of repetitions; null for
            a single repetition.
        values: The value of each repetition.
    """

    mean: float | None
    half_width: float | None
    values: list[float | None]


class TextRow(msgspec.Struct, frozen=True, kw_only=True):
    """Real motions, real motions with other texts, or a method's motions.

    Attributes:
        source: ``real``, ``real, texts shuffled`` or the name of the method.
        metrics: Maps ids of metrics (``r_precision_top_1``, ``fid`` …) to their values.
        motions: Number of motions of a repetition.
        ranked_pairs: Number of those that are in whole batches of 32, within which texts are ranked.
        dropped_pairs: Number of those in the last, incomplete batch.
        duplicate_captions: Ranked texts that equal another one of their batch, mean over repetitions.
        repetitions: Number of repetitions.
        weights_sha256: Digest of the method's weights; null without weights.
        options: Options of the method.
        unsupported: Number of clips that are longer than the method can generate.
    """

    source: str
    metrics: dict[str, RepeatedMetric]
    motions: int
    ranked_pairs: int
    dropped_pairs: int
    duplicate_captions: float
    repetitions: int
    weights_sha256: str | None
    options: dict[str, str]
    unsupported: int


class TextReport(msgspec.Struct, frozen=True, kw_only=True):
    """The match of motions and texts; rows compare within a report, and with those of the same evaluator and settings.

    Attributes:
        out: The file that the numbers were written to.
        vectorisation: The way in which the evaluator reads texts.
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
        rows: The rows of the table.
        remarks: What a reader of the numbers has to know.
    """

    out: Path
    vectorisation: str
    evaluator_sha256: str
    representation: str
    dataset: str
    corpus_content_digest: str
    split: str
    kinds: list[str]
    clips: int
    left_out: int
    distinct_captions: int
    seed: int
    diversity_pairs: int
    rows: list[TextRow]
    remarks: list[str]


@command(
    "evaluate-text",
    section="run",
    example="prbench evaluate-text --evaluator evaluator/weights.safetensors --corpus corpora/nymeria --method mdm"
    " --out text.json",
    report=TextReport,
)
@click.option("--evaluator", type=PATH, required=True, metavar="FILE", help="Weights of a t2m-evaluator.")
@click.option("--corpus", type=PATH, required=True, metavar="DIR", help="A built corpus or dataset.")
@out_file_option("Where the numbers are written.", required=True, metavar="FILE.json")
@split_option()
@click.option(
    "--kind", "kinds", multiple=True, metavar="KIND", help="Only captions of this kind; repeatable (default: all)."
)
@click.option("--method", metavar="NAME", help="An installed method that takes texts (default: recorded motion alone).")
@weights_option
@option_option("method")
@click.option(
    "--repetitions",
    type=POSITIVE,
    metavar="N",
    help="Repetitions of the measurement (default 20, with --multimodality 5).",
)
@click.option("--prompts", type=POSITIVE, default=1000, metavar="N", help="Texts of each repetition (default 1000).")
@click.option("--multimodality", is_flag=True, help="Generate 30 motions for each of 100 texts as well.")
@click.option(
    "--diversity-pairs",
    type=POSITIVE,
    default=300,
    metavar="N",
    help="Pairs of motions behind the diversity (default 300).",
)
@click.option("--words", type=PATH, metavar="DIR", help="Word vectors and lists of a GloVe evaluator.")
@click.option("--text-path", metavar="DIR|ID", help="DistilBERT's files, if the evaluator reads with it.")
@seed_option("of crops, captions, pairs and noise")
@click.option(
    "--batch-size", type=POSITIVE, default=64, metavar="N", help="Motions that the method makes at once (default 64)."
)
@device_option
@threads_option
def evaluate_text(
    out: Path,
    method: str | None,
    weights: Path | None,
    options: tuple[tuple[str, str], ...],
    batch_size: int,
    kinds: tuple[str, ...],
    device: str,
    **given,
) -> Answer:
    """Measure how well motions match texts, with a trained text-motion evaluator."""
    from prbench_benchmarks.text_to_motion import evaluate
    from prbench_benchmarks.text_to_motion.generated import MethodRequest

    of_methods = {"weights": weights, "option": options, "multimodality": given["multimodality"]}
    for name, value in of_methods.items():
        if value and not method:
            raise UsageError(f"--{name} belongs to a method; name one with --method.")
    requested = None
    if method:
        requested = MethodRequest(name=method, weights=weights, options=options, device=device, batch_size=batch_size)
    request = evaluate.TextEvaluationRequest(kinds=frozenset(kinds), method=requested, device=device, **given)
    with progress("evaluating") as show:
        evaluation = evaluate.evaluate_text(request, show)
    evaluation.write(out)
    for remark in evaluation.notes:
        note(remark)
    report = _report(evaluation, out)
    return Answer(report, lambda: _print(report))


def _report(evaluation: TextEvaluation, out: Path) -> TextReport:
    return TextReport(
        out=out,
        vectorisation=evaluation.vectorisation,
        evaluator_sha256=evaluation.evaluator_sha256,
        representation=evaluation.representation,
        dataset=evaluation.dataset,
        corpus_content_digest=evaluation.corpus_content_digest,
        split=evaluation.split,
        kinds=list(evaluation.kinds),
        clips=evaluation.clips,
        left_out=evaluation.left_out,
        distinct_captions=evaluation.distinct_captions,
        seed=evaluation.seed,
        diversity_pairs=evaluation.diversity_pairs,
        rows=[_row(row) for row in evaluation.rows],
        remarks=list(evaluation.notes),
    )


def _row(row: ResultRow) -> TextRow:
    metrics = {
        name: RepeatedMetric(mean=value.mean, half_width=value.half_width, values=list(value.values))
        for name, value in row.metrics.items()
    }
    return TextRow(
        source=row.source,
        metrics=metrics,
        motions=row.motions,
        ranked_pairs=row.ranked_pairs,
        dropped_pairs=row.dropped_pairs,
        duplicate_captions=row.duplicate_captions,
        repetitions=row.repetitions,
        weights_sha256=row.weights_sha256,
        options=dict(row.options),
        unsupported=row.unsupported,
    )


def _print(report: TextReport) -> None:
    metrics = [name for name in _TITLES if any(name in row.metrics for row in report.rows)]
    table = [(_TITLES[name], *(_cell(name, row.metrics.get(name)) for row in report.rows)) for name in metrics]
    repetitions = report.rows[0].repetitions
    title = (
        f"{report.dataset}, {report.clips} clips of split {report.split}, texts read as"
        f" {report.vectorisation}; {repetitions} repetition{'' if repetitions == 1 else 's'}"
    )
    columns = range(1, len(report.rows) + 1)
    print_table(title, ("metric", *(row.source for row in report.rows)), table, numbers=columns)
    print(f"written: {report.out}")


def _cell(name: str, value: RepeatedMetric | None) -> str:
    if value is None or value.mean is None:
        return "–"
    scale = 100.0 if name.startswith("r_precision") else 1.0
    spread = "" if value.half_width is None else f" ± {value.half_width * scale:.2f}"
    return f"{value.mean * scale:.2f}{spread}"
