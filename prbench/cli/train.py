"""``prbench train``: train a method's network on tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_data, command, key_value, positive
from prbench.cli.progress import show_training
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.training.run import TrainRequest


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "train",
        summary="train a method's network on tables; the same command goes on with an interrupted training",
        example="prbench train --method pr --config small --stage finetune --data tables/adt --init mdm.safetensors"
        " --out trained/pr",
        execute=_train,
        resumes=True,
    )
    parser.add_argument("--method", required=True, metavar="NAME", help="what to train: mdm, pr, t2m-evaluator …")
    parser.add_argument("--stage", metavar="STAGE", help="pretrain or finetune (default: the method's first)")
    add_data(parser, required=False, help="built dataset or corpus folder(s), whose split 'train' is learnt from")
    parser.add_argument("--out", type=Path, metavar="DIR", help="training folder: checkpoints, logs, weights; resumes")
    parser.add_argument(
        "--config",
        default="small",
        metavar="NAME|FILE",
        help="a configuration of the method, or a .toml (default small)",
    )
    parser.add_argument(
        "--set",
        type=key_value,
        action="append",
        default=[],
        metavar="TABLE.KEY=VALUE",
        help="override a key, such as training.steps=1000 or model.width=256; repeatable",
    )
    parser.add_argument("--init", type=Path, metavar="FILE", help="weights to start from")
    parser.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1, mps")
    parser.add_argument("--devices", type=positive, default=1, metavar="N", help="processes to train in (default 1)")
    parser.add_argument("--threads", type=positive, default=1, metavar="N", help="threads a process (default 1)")
    parser.add_argument("--loaders", type=int, default=0, metavar="N", help="processes that load data (default 0)")
    parser.add_argument("--show-config", action="store_true", help="print the resolved configuration and stop")


def _train(arguments: argparse.Namespace) -> int:
    from prbench.training.run import train

    if arguments.show_config:
        return _show_configuration(arguments)
    request = _request(arguments)
    with show_training(f"training {arguments.method}") as show:
        report = train(request, report=show)
    if not report.first_process:
        return 0
    print(f"waited for data {report.waiting:.1%} of {report.seconds:.0f} s", file=sys.stderr)
    print(f"weights: {report.weights}")
    return 0


def _show_configuration(arguments: argparse.Namespace) -> int:
    from prbench.training.configuration import as_toml
    from prbench.training.installed import load_task
    from prbench.training.run import resolved

    _, configuration = resolved(
        load_task(arguments.method), arguments.config, stage=arguments.stage, overrides=arguments.set
    )
    print(as_toml(configuration), end="")
    return 0


def _request(arguments: argparse.Namespace) -> TrainRequest:
    from prbench.training.run import TrainRequest

    for option in ("data", "out"):
        if not getattr(arguments, option):
            raise UsageError(f"--{option} DIR is needed.")
    return TrainRequest(
        method=arguments.method,
        data=tuple(arguments.data),
        out=arguments.out,
        stage=arguments.stage,
        configuration=arguments.config,
        overrides=tuple(arguments.set),
        initial=arguments.init,
        device=arguments.device,
        devices=arguments.devices,
        threads=arguments.threads,
        workers=arguments.loaders,
    )
