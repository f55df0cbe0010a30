"""``prbench view``: runs and recorded motion as pictures, films and pages.

``prbench explain``: one event's story.

``prbench diff``: what changed between two builds, and why.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation.differences import Difference


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
@click.argument("runs", type=opt.PATH, nargs=-1, metavar="[RUN...]")
@opt.data_option(required=False, help="The table(s) of the runs; not needed for the embedded synthetic datasets.")
@opt.out_file_option("Picture (.png), film (.mp4) or page (.html); of motion prediction .png or .svg.", required=True)
@opt.sequence_option("Show this sequence")
@opt.limit_option("4")
@click.option("--sample", type=int, default=0, metavar="K", help="Sample of runs with several (default 0, the first).")
@opt.permission_option
def view(*, permission: tuple[str, ...], **given: Any) -> Answer:
    """Show recorded and generated motion beside one another, as PNG, MP4 or HTML.

    RUN are the run folders to compare; without any, the recorded motion of --data is shown. Of motion prediction the
    futures are shown, as PNG or SVG.
    """
    from prbench.viewing.view import ViewRequest
    from prbench.viewing.view import view as draw

    request = ViewRequest(permitted=permission, **given)
    with progress(f"drawing {request.out.name}") as show:
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
        for scene in drawn.scenes:
            print(f"{scene.sequence_id}: {scene.title}")
            for motion in scene.motions:
                print(f"  {motion.label}: {drawn.told(scene, motion)}")
        for notice in report.notices:
            print(notice)
        print(f"view: {report.out}")

    return Answer(report, show_scores)


class OtherEvent(msgspec.Struct, frozen=True, kw_only=True):
    """Another event of the same recording.

    Attributes:
        event_id: Its id.
        seconds_later: Seconds from the explained event to it; negative if it happened before.
        action: ``pick`` or ``put``.
        object_name: Name of its object.
        same_object: Whether it is an event of the same object.
        outcome: ``sequence``, or why it became none.
    """

    event_id: str
    seconds_later: float
    action: str
    object_name: str
    same_object: bool
    outcome: str


class ExplainReport(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of one event, and the reasons; what a licence keeps, such as places, is left out.

    Attributes:
        event_id: Id of the event.
        sequence_id: Id of the sequence that it became; null if it became none.
        dataset: Name of the dataset.
        recording_id: Id of the recording.
        split: Split of the recording.
        action: ``pick`` or ``put``.
        object_id: Id of the object.
        object_name: Name of the object.
        hand: ``left`` or ``right``; null if it is not known.
        event_time: Time of the event on the recording's clock, in seconds.
        prime_time: Time of the first look at the goal, in seconds; null without one.
        outcome: ``sequence``, or why it became none, such as ``not_primed``.
        stages: The stages in the order in which curation asks: ``name``, ``verdict`` (``passed``, ``stopped here`` or
            ``not reached``) and ``text``, the numbers beside what they are compared with.
        other_events: Events around it, and those of the same object, by time.
        notice: Sentence that the dataset's terms ask a picture to show; empty if they ask for none.
        drawing: The picture, if one was asked for.
    """

    event_id: str
    sequence_id: str | None
    dataset: str
    recording_id: str
    split: str
    action: str
    object_id: str
    object_name: str
    hand: str | None
    event_time: float
    prime_time: float | None
    outcome: str
    stages: list[dict[str, str]]
    other_events: list[OtherEvent]
    notice: str
    drawing: Path | None


@command(
    "explain",
    example="prbench explain Mug_2/pick --data tables/adt --draw story.png",
    report=ExplainReport,
    writes_report=True,
)
@click.argument("event")
@click.option("--data", type=opt.PATH, required=True, metavar="DIR", help="Built dataset folder.")
@click.option("--draw", type=opt.OUT_FILE, metavar="FILE", help="Draw the story as PNG.")
@opt.permission_option
def explain(event: str, data: Path, draw: Path | None, permission: tuple[str, ...]) -> Answer:
    """Tell what became of one event and why.

    EVENT is an event id, or any part of it that fits one event only.
    """
    from prbench.viewing.explain import explain_event

    story = explain_event(data, event, permitted=permission)
    if draw is not None:
        from prbench.viewing.explain import draw_event_story

        draw_event_story(story, draw)
    here = story.event
    others = [
        vars(other)
        | {"seconds_later": other.event_time - here.event_time, "same_object": other.object_id == here.object_id}
        for other in story.neighbours
    ]
    # Each record takes the fields that it names; the others, such as places, stay out of the document.
    told: dict[str, Any] = vars(here) | vars(story) | {"drawing": draw, "other_events": others}
    told["stages"] = [vars(stage) for stage in story.stages]

    def show() -> None:
        print(story.text())
        if draw is not None:
            print(f"drawing: {draw}")

    return Answer(msgspec.convert(told, ExplainReport), show)


SHOWN = 40
_COLUMNS = ("kind", "recording_id", "event", "first", "second", "decided_by")


@command(
    "diff",
    example="prbench diff tables/adt tables/adt-wrist --csv changes.csv",
    report="prbench.curation.differences:Difference",
    writes_report=True,
)
@click.argument("first", type=opt.PATH, metavar="BUILD_A")
@click.argument("second", type=opt.PATH, metavar="BUILD_B")
@click.option("--csv", type=opt.OUT_FILE, metavar="FILE", help="Write every change as a line of CSV.")
@click.option("--all", "everything", is_flag=True, help=f"Print every change, not only the first {SHOWN}.")
def diff(first: Path, second: Path, csv: Path | None, everything: bool) -> Answer:
    """Say which events and sequences differ between two builds of a dataset, and which stage decided.

    BUILD_A and BUILD_B are built dataset folders. The exit code is 1 where they differ.
    """
    from prbench.curation.differences import compare_builds

    difference = compare_builds(first, second)
    if csv is not None:
        from prbench.files.storage import sole_file
        from prbench.tables import csv_lines

        with sole_file(csv) as temporary:
            temporary.write_text(csv_lines(_COLUMNS, map(vars, difference.changes)), encoding="utf-8", newline="\n")

    def show() -> None:
        _print(difference, everything=everything)
        if csv is not None:
            print(f"changes: {csv}")

    return Answer(difference, show, 0 if difference.equal else 1)


def _print(difference: Difference, *, everything: bool) -> None:
    from prbench.curation.differences import KINDS

    if difference.settings:
        print_table("what the builds were made with", ("", "first", "second"), difference.settings)
    changes = difference.changes
    counts = Counter(change.kind for change in changes)
    if changes:
        rows = [(kind, str(counts[kind]), meaning) for kind, meaning in KINDS.items() if kind in counts]
        print_table("changes", ("kind", "events", "meaning"), rows, numbers=(1,))
        shown = changes if everything else changes[:SHOWN]
        print_table(
            "events",
            ("kind", "recording", "event", "first", "second", "decided by"),
            [(c.kind, c.recording_id, c.event, c.first or "–", c.second or "–", c.decided_by) for c in shown],
        )
        if len(shown) < len(changes):
            print(f"… and {len(changes) - len(shown)} more: --all or --csv FILE")
    print(f"unchanged: {difference.unchanged_events} events, {difference.unchanged_sequences} of them sequences")
