"""``prbench evaluate-text``: text-to-motion metrics of recorded motion and of a method on any table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench_benchmarks.text_to_motion.metrics import Repeated
    from prbench_benchmarks.text_to_motion.report import Retrieval, TextEvaluation

_TITLES = {
    "r_precision_top_1": "R-precision top 1, %",
    "r_precision_top_2": "R-precision top 2, %",
    "r_precision_top_3": "R-precision top 3, %",
    "fid": "FID",
    "multimodal_distance": "multimodal distance",
    "diversity": "diversity",
    "multimodality": "multimodality",
}


@command(
    "evaluate-text",
    section="run",
    example="prbench evaluate-text --evaluator evaluator/weights.safetensors --corpus corpora/nymeria --method mdm"
    " --out text.json",
    report="prbench_benchmarks.text_to_motion.report:TextEvaluation",
)
@click.option("--evaluator", type=opt.PATH, required=True, metavar="FILE", help="Weights of a t2m-evaluator.")
@click.option("--corpus", type=opt.PATH, required=True, metavar="DIR", help="A built corpus or dataset.")
@opt.out_file_option("Where the numbers are written.", required=True, metavar="FILE.json")
@opt.split_option()
@opt.option("--kind", "kinds", "Only captions of this kind; repeatable (default: all).", multiple=True, metavar="KIND")
@click.option("--method", metavar="NAME", help="An installed method that takes texts (default: recorded motion alone).")
@opt.weights_option
@opt.option_option("method")
@opt.number_option("--repetitions", "Repetitions of the measurement (default 20, with --multimodality 5).")
@opt.number_option("--prompts", "Texts of each repetition (default 1000).", default=1000)
@click.option("--multimodality", is_flag=True, help="Generate 30 motions for each of 100 texts as well.")
@click.option(
    "--retrieval",
    is_flag=True,
    help="R@1, R@5, R@10 and median rank among 32 and among all, from texts and from motions: slow for huge splits.",
)
@opt.path_option("--nearest", "In place of metrics, name the clips nearest to each motion of a run.", metavar="RUN")
@opt.number_option("--limit", "With --nearest: motions of each dataset at most (default all).")
@opt.number_option("--neighbours", "With --nearest: clips named for each motion (default 3).", default=3)
@opt.number_option("--diversity-pairs", "Pairs of motions behind the diversity (default 300).", default=300)
@click.option("--words", type=opt.PATH, metavar="DIR", help="Word vectors and lists of a GloVe evaluator.")
@click.option("--text-path", metavar="DIR|ID", help="DistilBERT's files, if the evaluator reads with it.")
@opt.seed_option("of crops, captions, pairs and noise")
@opt.number_option("--batch-size", "Motions that the method makes at once (default 64).", default=64)
@opt.device_option
@opt.threads_option
def evaluate_text(out: Path, kinds: tuple[str, ...], **given) -> Answer:
    """Measure how well motions match texts, with a trained text-motion evaluator."""
    from prbench_benchmarks.text_to_motion import evaluate

    for option, name in (("weights",) * 2, ("option", "options"), ("multimodality",) * 2):
        if given[name] and not given["method"]:
            raise UsageError(f"--{option} belongs to a method; name one with --method.")
    if given["nearest"] and (given["method"] or given["retrieval"]):
        raise UsageError("--nearest takes the place of metrics: leave --method and --retrieval away.")
    if given["limit"] and not given["nearest"]:
        raise UsageError("--limit belongs to the motions of a run; name one with --nearest.")
    request = evaluate.TextEvaluationRequest(kinds=frozenset(kinds), **given)
    with progress("evaluating") as show:
        evaluation = evaluate.evaluate_text(request, show)
    evaluation.write(out)
    for remark in evaluation.notes:
        note(remark)
    return Answer(evaluation, lambda: _print(evaluation, out))


def _print(report: TextEvaluation, out: Path) -> None:
    if report.nearest:
        near = [
            (one.sequence_id, *map(str, (one.sample, one.rank)), one.clip, f"{one.distance:.4g}", " | ".join(one.texts))
            for one in report.nearest
        ]
        title = f"nearest of {report.clips} clips of {report.dataset}, split {report.split}, in the evaluator's space"
        print_table(title, ("sequence", "sample", "rank", "clip", "distance", "texts"), near, numbers=(1, 2, 4))
        return print(f"written: {out}")
    metrics = [name for name in _TITLES if any(name in row.metrics for row in report.rows)]
    table = [(_TITLES[name], *(_cell(name, row.metrics.get(name)) for row in report.rows)) for name in metrics]
    repetitions = report.rows[0].repetitions
    title = (
        f"{report.dataset}, {report.clips} clips of split {report.split}, texts read as"
        f" {report.vectorisation}; {repetitions} repetition{'' if repetitions == 1 else 's'}"
    )
    columns = range(1, len(report.rows) + 1)
    print_table(title, ("metric", *(row.source for row in report.rows)), table, numbers=columns)
    rankings = [
        (row.source, own.query, str(own.candidates), *_cells(own), *_cells(equal))
        for row in report.rows
        for own, equal in zip(row.retrieval[::2], row.retrieval[1::2])
    ]
    if rankings:
        title = "retrieval, means of repetitions; on the right, all partners of the same caption are hits"
        names = ("R@1, %", "R@5, %", "R@10, %", "median rank")
        header = ("motions", "asked by", "among", *names, *(f"{name}\nsame caption" for name in names))
        print_table(title, header, rankings, numbers=range(2, len(header)))
    print(f"written: {out}")


def _cell(name: str, value: Repeated | None) -> str:
    if value is None:
        return "–"
    scale = 100.0 if name.startswith("r_precision") else 1.0
    spread = "" if value.half_width is None else f" ± {value.half_width * scale:.2f}"
    return f"{value.mean * scale:.2f}{spread}"


def _cells(found: Retrieval) -> tuple[str, ...]:
    shares = (found.r_at_1, found.r_at_5, found.r_at_10)
    return (*(f"{share.mean:.2%}".removesuffix("%") for share in shares), f"{found.median_rank.mean:.1f}")
