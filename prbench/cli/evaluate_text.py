"""``prbench evaluate-text``: text-to-motion metrics of recorded motion and of a method on any table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_split, command, key_value, positive
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.workflows.text_to_motion.evaluate import TextEvaluationRequest
    from prbench.workflows.text_to_motion.report import Interval, TextEvaluation

_TITLES = {
    "r_precision_top_1": "R-precision top 1, %",
    "r_precision_top_2": "R-precision top 2, %",
    "r_precision_top_3": "R-precision top 3, %",
    "fid": "FID",
    "multimodal_distance": "multimodal distance",
    "diversity": "diversity",
    "multimodality": "multimodality",
}


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "evaluate-text",
        summary="measure how well motions match texts, with a trained text-motion evaluator",
        example="prbench evaluate-text --evaluator evaluator/weights.safetensors --corpus corpora/nymeria --method mdm"
        " --out text.json",
        execute=_evaluate,
    )
    parser.add_argument("--evaluator", type=Path, required=True, metavar="FILE", help="weights of a t2m-evaluator")
    parser.add_argument("--corpus", type=Path, required=True, metavar="DIR", help="a built corpus or dataset")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.json", help="where the numbers are written")
    add_split(parser)
    parser.add_argument("--kind", action="append", default=[], metavar="KIND", help="only captions of it; repeatable")
    parser.add_argument("--method", metavar="NAME", help="an installed method that takes texts; none for real motion")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="the method's weights")
    parser.add_argument(
        "--option", type=key_value, action="append", default=[], metavar="KEY=VALUE", help="for the method; repeatable"
    )
    parser.add_argument("--repetitions", type=positive, metavar="N", help="default 20, with --multimodality 5")
    parser.add_argument("--prompts", type=positive, default=1000, metavar="N", help="texts a repetition (default 1000)")
    parser.add_argument("--multimodality", action="store_true", help="30 motions for each of 100 texts as well")
    parser.add_argument("--diversity-pairs", type=positive, default=300, metavar="N", help="default 300")
    parser.add_argument("--words", type=Path, metavar="DIR", help="word vectors and lists of a GloVe evaluator")
    parser.add_argument("--text-path", metavar="DIR|ID", help="DistilBERT's files, if the evaluator reads with it")
    parser.add_argument("--seed", type=int, default=0, help="of crops, captions, pairs and noise (default 0)")
    parser.add_argument("--batch-size", type=positive, default=64, metavar="N", help="of the method (default 64)")
    parser.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1 …")
    parser.add_argument("--threads", type=positive, default=1, metavar="N", help="default 1")


def _evaluate(arguments: argparse.Namespace) -> int:
    from prbench.workflows.text_to_motion.evaluate import evaluate_text

    with progress("evaluating") as show:
        evaluation = evaluate_text(_request(arguments), show)
    evaluation.write(arguments.out)
    _print(evaluation)
    print(f"written: {arguments.out}")
    return 0


def _request(arguments: argparse.Namespace) -> TextEvaluationRequest:
    from prbench.errors import UsageError
    from prbench.workflows.text_to_motion.evaluate import TextEvaluationRequest
    from prbench.workflows.text_to_motion.generated import MethodRequest

    given = [name for name in ("weights", "option", "multimodality") if getattr(arguments, name)]
    if given and not arguments.method:
        raise UsageError(f"--{given[0]} belongs to a method; name one with --method.")
    method = arguments.method and MethodRequest(
        name=arguments.method,
        weights=arguments.weights,
        options=tuple(arguments.option),
        device=arguments.device,
        batch_size=arguments.batch_size,
    )
    return TextEvaluationRequest(
        evaluator=arguments.evaluator,
        corpus=arguments.corpus,
        split=arguments.split,
        kinds=frozenset(arguments.kind),
        method=method or None,
        repetitions=arguments.repetitions,
        multimodality=arguments.multimodality,
        prompts=arguments.prompts,
        diversity_pairs=arguments.diversity_pairs,
        seed=arguments.seed,
        device=arguments.device,
        threads=arguments.threads,
        words=arguments.words,
        text_path=arguments.text_path,
    )


def _print(evaluation: TextEvaluation) -> None:
    metrics = [name for name in _TITLES if any(name in row.metrics for row in evaluation.rows)]
    table = [(_TITLES[name], *(_cell(name, row.metrics.get(name)) for row in evaluation.rows)) for name in metrics]
    repetitions = evaluation.rows[0].repetitions
    title = (
        f"{evaluation.dataset}, {evaluation.clips} clips of split {evaluation.split}, texts read as"
        f" {evaluation.vectorisation}; {repetitions} repetition{'' if repetitions == 1 else 's'}"
    )
    columns = range(1, len(evaluation.rows) + 1)
    print_table(title, ("metric", *(row.source for row in evaluation.rows)), table, numbers=columns)
    for note in evaluation.notes:
        print(note, file=sys.stderr)


def _cell(name: str, interval: Interval | None) -> str:
    if interval is None:
        return "–"
    scale = 100.0 if name.startswith("r_precision") else 1.0
    spread = "" if interval.half_width is None else f" ± {interval.half_width * scale:.2f}"
    return f"{interval.mean * scale:.2f}{spread}"
