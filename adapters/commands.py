"""``prbench train``: train a method's network on tables."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress, session
from prbench.errors import UsageError
from prbench_adapters.trained_network import TrainedNetwork

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench_adapters.training.loop import Progress


class TrainReport(msgspec.Struct, frozen=True, kw_only=True):
    """A training, or the configuration that it would have.

    Attributes:
        method: What was trained.
        configuration: Every key of the resolved configuration, by table, with ``--show-config``; else null.
        trained: The result; null with ``--show-config``.
    """

    method: str
    configuration: dict[str, dict[str, Any]] | None
    trained: TrainedNetwork | None


@command(
    "train",
    section="train",
    example="prbench train --method pr --stage finetune --data tables/adt --out trained/pr",
    resumes=True,
    report=TrainReport,
)
@click.option("--method", required=True, metavar="NAME", help="What to train: mdm, pr, t2m-evaluator …")
@click.option("--stage", metavar="STAGE", help="pretrain or finetune; some methods have others (default: the first).")
@opt.data_option(required=False, help="Built dataset or corpus folder(s), whose split 'train' is learnt from.")
@opt.out_folder_option("Training folder: checkpoints, logs, weights; an interrupted training goes on in it.")
@opt.path_option(
    "--config",
    "A configuration of the method, or a .toml file (default: the stage's own, else small).",
    metavar="NAME|FILE",
)
@click.option(
    "--set",
    "overrides",
    type=opt.KeyValue(),
    multiple=True,
    metavar="TABLE.KEY=VALUE",
    help="Override a key, such as training.steps=1000 or model.width=256; repeatable.",
)
@click.option(
    "--refit",
    is_flag=True,
    help="Learn from the split 'validation' as well, once nothing is chosen by it; needs validation.every=0.",
)
@opt.fold_option
@opt.path_option("--init", "initial", "Weights to start from.")
@click.option("--device", default="cpu", help="cpu (default), cuda, cuda:1, mps.")
@click.option("--devices", type=opt.POSITIVE, default=1, metavar="N", help="Processes to train in (default 1).")
@opt.threads_option
@click.option("--loaders", type=int, default=0, metavar="N", help="Processes that load data (default 0).")
@opt.engine_options(help="Processes that prepare the data (default 1; with --engine ray all processors).")
@click.option("--wandb", metavar="PROJECT", help="Log to this project at Weights & Biases, beside TensorBoard.")
@click.option("--show-config", is_flag=True, help="Print the resolved configuration and stop.")
def train(
    *,
    method: str,
    data: tuple[Path, ...],
    out: Path | None,
    config: Path | None,
    loaders: int,
    engine: EngineChoice,
    show_config: bool,
    **given: Any,
) -> Answer | int:
    """Train a method's network on tables; the same command goes on with an interrupted training."""
    from prbench.harness.methods.installed import load_task
    from prbench_adapters.training.configuration import as_toml
    from prbench_adapters.training.run import TrainRequest, resolved
    from prbench_adapters.training.run import train as run_training

    configuration = None if config is None else str(config)
    if show_config:
        _, shown = resolved(load_task(method), configuration, stage=given["stage"], overrides=given["overrides"])
        report = TrainReport(method=method, configuration=msgspec.to_builtins(shown), trained=None)
        return Answer(report, lambda: print(as_toml(shown), end=""))
    if not data:
        raise UsageError("--data DIR is needed.")
    if out is None:
        raise UsageError("--out DIR is needed.")
    request = TrainRequest(method=method, data=data, out=out, configuration=configuration, workers=loaders, **given)
    bar_is_shown = sys.stderr.isatty() and not session().verbose
    with progress(f"training {method}") if bar_is_shown else contextlib.nullcontext() as tell:

        def report_progress(now: Progress) -> None:
            if tell is not None:
                tell(now.step, now.steps, _in_words(now.validation or now.row or {}))
            elif not session().quiet:
                # Each new line of the log goes to standard error, so that standard output holds the result alone.
                if now.row is not None:
                    print(f"step {now.step}/{now.steps}: {_in_words(now.row)}", file=sys.stderr, flush=True)
                if now.validation is not None:
                    print(f"validation at {now.step}: {_in_words(now.validation)}", file=sys.stderr, flush=True)

        trained = run_training(request, report=report_progress, engine=opt.opened(engine, reads=data))
    if trained is None:  # one of several processes that train together; the first one speaks for all
        return 0
    report = TrainReport(method=method, configuration=None, trained=trained)
    best = f" (of the best validation, after {trained.best_step} of {trained.steps} steps)"
    return Answer(report, lambda: print(f"weights: {trained.weights}{best if trained.best_step else ''}"))


def _in_words(row: Mapping[str, float | int]) -> str:
    """Write ``loss 0.123, joints 0.01, …``, without the step."""
    return ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in row.items() if name != "step")
