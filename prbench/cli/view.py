"""``prbench view``: runs and recorded motion as pictures, films and pages."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import (
    NATIVE,
    PATH,
    data_option,
    limit_option,
    out_file_option,
    permission_option,
    sequence_option,
)
from prbench.cli.progress import progress


class ShownSequence(msgspec.Struct, frozen=True, kw_only=True):
    """One shown sequence.

    Attributes:
        sequence_id: Id of the sequence.
        dataset: Name of the dataset.
        title: Action, object, hand and split in words.
        motions: Scores of the recorded motion, unless the dataset's licence withholds it, and of each run, by the
            metric's id: rates are 0 or 1, lengths in metres; empty for a motion that was not scored.
    """

    sequence_id: str
    dataset: str
    title: str
    motions: dict[str, dict[str, float | None]]


class ViewReport(msgspec.Struct, frozen=True, kw_only=True):
    """The pictures that were drawn.

    Attributes:
        out: The picture, film or page.
        sequences: The sequences in it.
        notices: Sentences that the datasets' terms ask for, as they stand in the view.
    """

    out: Path
    sequences: list[ShownSequence]
    notices: list[str]


@command("view", example="prbench view runs/static --data tables/adt --out static.png", report=ViewReport)
@click.argument("runs", type=PATH, nargs=-1, metavar="[RUN...]")
@data_option(required=False, help="The table(s) of the runs; not needed for the embedded synthetic datasets.")
@out_file_option("Picture (.png), film (.mp4) or page (.html).", required=True)
@sequence_option("Show this sequence")
@limit_option("4")
@click.option("--sample", type=int, default=0, metavar="K", help="Sample of runs with several (default 0, the first).")
@click.option(
    "--scene",
    type=NATIVE,
    metavar="DIR",
    help="Your copy of the dataset: draws what stood around the bodies behind them (needs the extra open3d).",
)
@permission_option
def view(
    runs: tuple[Path, ...],
    data: tuple[Path, ...],
    out: Path,
    sequences: tuple[str, ...],
    limit: int | None,
    sample: int,
    scene: Path | None,
    permission: tuple[str, ...],
) -> Answer:
    """Show recorded and generated motion beside one another, as PNG, MP4 or HTML.

    RUN are the run folders to compare; without any, the recorded motion of --data is shown.
    """
    from prbench.viewing.view import ViewRequest
    from prbench.viewing.view import view as draw

    request = ViewRequest(
        out=out,
        runs=runs,
        data=data,
        sequences=sequences,
        limit=limit,
        sample=sample,
        permitted=permission,
        scene=scene,
    )
    with progress(f"drawing {out.name}") as show:
        drawn = draw(request, show)
    report = ViewReport(
        out=drawn.out,
        sequences=[
            ShownSequence(
                sequence_id=scene.sequence_id,
                dataset=scene.dataset,
                title=scene.title,
                motions={motion.label: dict(motion.scores) for motion in scene.motions},
            )
            for scene in drawn.scenes
        ],
        notices=list(drawn.notices),
    )

    def show_scores() -> None:
        from prbench.viewing.replay.measures import score_sentence

        for scene in drawn.scenes:
            print(f"{scene.sequence_id}: {scene.title}")
            for motion in scene.motions:
                print(f"  {motion.label}: {score_sentence(scene, motion) or 'not scored'}")
        for notice in report.notices:
            print(notice)
        print(f"view: {report.out}")

    return Answer(report, show_scores)
