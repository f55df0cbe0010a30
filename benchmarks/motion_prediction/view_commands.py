"""``prbench prediction view``: possible futures of some windows, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, SeveralValues, command, progress
from prbench.cli.options import (
    PATH,
    POSITIVE,
    device_option,
    limit_option,
    out_file_option,
    permission_option,
    seed_option,
)

if TYPE_CHECKING:
    from prbench_benchmarks.motion_prediction.futures import ShownWindow

_CONDITIONS = ("pose", "pose+head", "pose+gaze")


class ShownFutures(msgspec.Struct, frozen=True, kw_only=True):
    """The futures of one predictor in a window.

    Attributes:
        label: Predictor and condition.
        futures: Number of futures.
        score: What it scored in this window, in words.
    """

    label: str
    futures: int
    score: str


class ViewedWindow(msgspec.Struct, frozen=True, kw_only=True):
    """One window of the picture.

    Attributes:
        window_id: Its id.
        predictors: What each predictor saw in it.
    """

    window_id: str
    predictors: list[ShownFutures]


class FuturesReport(msgspec.Struct, frozen=True, kw_only=True):
    """The picture of futures.

    Attributes:
        out: The picture or page.
        windows: The windows in it.
        notices: Sentences that the dataset's terms ask for, as they stand in the view.
    """

    out: Path
    windows: list[ViewedWindow]
    notices: list[str]


@command(
    "view",
    example="prbench prediction view windows/mogaze --method nearest-past --condition pose pose+gaze --out futures.png",
    report=FuturesReport,
)
@click.argument("windows", type=PATH, metavar="WINDOWS")
@click.option(
    "--method",
    "methods",
    cls=SeveralValues,
    required=True,
    metavar="NAME...",
    help="Predictors: zero-velocity, constant-velocity, nearest-past, or installed ones.",
)
@click.option(
    "--condition",
    "conditions",
    cls=SeveralValues,
    type=click.Choice(_CONDITIONS),
    default=("pose",),
    help="What each predictor is told (default pose); with several, each of them.",
)
@click.option("--weights", type=PATH, metavar="FILE", help="Weights of the method (default: those that it comes with).")
@click.option(
    "--window", "window_ids", cls=SeveralValues, metavar="ID...", help="These windows; a part of an id will do."
)
@limit_option("1")
@click.option("--samples", type=POSITIVE, default=10, metavar="K", help="Futures of each predictor (default 10).")
@seed_option("of the futures")
@device_option
@permission_option
@out_file_option("Picture (.png, .svg) or page (.html).", required=True)
def view(
    windows: Path,
    methods: tuple[str, ...],
    conditions: tuple[str, ...],
    weights: Path | None,
    window_ids: tuple[str, ...],
    limit: int | None,
    samples: int,
    seed: int,
    device: str,
    permission: tuple[str, ...],
    out: Path,
) -> Answer:
    """Show possible futures of WINDOWS as a fan of bodies, beside what happened, as PNG, SVG or HTML."""
    from prbench_benchmarks.motion_prediction.batch import Condition
    from prbench_benchmarks.motion_prediction.view import FuturesRequest, view_futures

    request = FuturesRequest(
        windows=windows,
        out=out,
        methods=methods,
        conditions=tuple(Condition(each) for each in conditions),
        window_ids=window_ids,
        limit=limit,
        samples=samples,
        weights=weights,
        seed=seed,
        device=device,
        permitted=permission,
    )
    with progress(f"drawing {out.name}") as tell:
        drawn = view_futures(request, tell)
    report = FuturesReport(
        out=drawn.out,
        windows=[_window(each) for each in drawn.windows],
        notices=list(dict.fromkeys(each.notice for each in drawn.windows if each.notice)),
    )
    return Answer(report, lambda: _print(report))


def _window(window: ShownWindow) -> ViewedWindow:
    predictors = [ShownFutures(label=fan.label, futures=len(fan.joints), score=fan.score) for fan in window.fans]
    return ViewedWindow(window_id=window.window_id, predictors=predictors)


def _print(report: FuturesReport) -> None:
    """Say what was drawn, and what each predictor scored there."""
    for window in report.windows:
        print(window.window_id)
        for each in window.predictors:
            print(f"  {each.label}: {each.futures} futures, {each.score}")
    for notice in report.notices:
        print(notice)
    print(f"view: {report.out}")
