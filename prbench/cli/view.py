"""``prbench view``: generated and recorded motion as pictures, films and pages.

``prbench explain``: one event's story. ``prbench diff``: what changed between two builds, and why. ``prbench review``:
a page on which a person looks through events and corrects them.
"""

from __future__ import annotations

import sys
import webbrowser
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note, progress, session
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.viewing.explain import StoryStage


class ViewReport(msgspec.Struct, frozen=True, kw_only=True):
    """The pictures that were drawn.

    Attributes:
        out: The picture, film or page.
        sequences: Ids of the sequences in it.
        links: Addresses of their motions in a page, in the same order; empty for a picture or film.
        left_out: Number of sequences that a page has no room for.
        notices: Sentences that the datasets' terms ask for, as they stand in the view.
        caption: Text below the picture in a paper; empty for films and pages.
    """

    out: Path
    sequences: list[str]
    links: list[str]
    left_out: int
    notices: list[str]
    caption: str


LOOKS = "Draw when gaze was on which object around an event (.png, .svg, .pdf)"
SHOWN_SEQUENCES = 10  # that are printed; the report holds all


@command("view", example="prbench view runs/static --data tables/adt", report=ViewReport)
@click.argument("runs", type=opt.PATH, nargs=-1, metavar="[RUN...]")
@opt.data_option(required=False, help="The table(s) of the runs; not needed for the embedded synthetic datasets.")
@opt.out_file_option(
    "Page (.html), picture (.png, .svg, .pdf) or film (.mp4); of motion prediction a picture (default: motions.html in"
    " the run's folder; in this folder for several runs, for none, and where the run's cannot be written)."
)
@opt.sequence_option("Show this sequence")
@opt.limit_option("4; in a page as many as 40 MB hold, the worst first")
@click.option("--sample", type=int, default=0, metavar="K", help="Sample of runs with several (default 0, the first).")
@opt.root_option("Recordings of the table: a page shows their objects, and the scan of their scene.", required=False)
@opt.path_option("--mesh", "Another mesh of the scene (.ply, .obj, .glb), in the coordinates of the recordings.")
@opt.reader_options(remark="only those that name files or folders have to be said again")
@opt.flag("--open", "Open it in the browser; on a terminal only.")
@opt.permission_option
def view(*, permission: tuple[str, ...], options: opt.Pairs, open: bool, **given: Any) -> Answer:
    """Show recorded and generated motion beside one another, in a page to play and turn, or as a picture or film.

    RUN are the run folders to compare; without any, the recorded motion of --data is shown. Of motion prediction the
    futures are shown, as a picture.
    """
    from prbench.viewing.player.links import PAGE
    from prbench.viewing.view import ViewRequest
    from prbench.viewing.view import view as draw

    if given["out"] is None and any(session().shown_place(str(run)) != str(run) for run in given["runs"]):
        given["out"] = Path(PAGE)  # the folder of a run at a URL is a copy that nobody looks into
    request = ViewRequest(permitted=permission, option=options, **given)
    with progress(f"drawing {(request.out or Path(PAGE)).name}") as show:
        drawn = draw(request, show)
    told = {name: getattr(drawn, name) for name in ("out", "links", "left_out", "caption")}
    report = ViewReport(sequences=[scene.sequence_id for scene in drawn.scenes], notices=list(drawn.notices), **told)
    if drawn.left_out:
        note(f"the page has no room for {drawn.left_out} more sequences; --sequence or --limit choose others.")

    def show_scores() -> None:
        for number, scene in enumerate(drawn.scenes[:SHOWN_SEQUENCES]):
            print(f"{scene.sequence_id}: {scene.title}")
            for motion in scene.motions:
                print(f"  {motion.label}: {drawn.told(scene, motion)}")
            for link in report.links[number : number + 1]:
                print(f"  {link}")
        if len(drawn.scenes) > SHOWN_SEQUENCES:
            print(f"… and {len(drawn.scenes) - SHOWN_SEQUENCES} more (--json lists all)")
        for notice in report.notices:
            print(notice)
        if report.caption:
            print(f"caption: {report.caption}")
        print(f"view: {report.out}")
        if open and sys.stdout.isatty():
            webbrowser.open(report.out.absolute().as_uri())
        elif open:
            note("--open: this is no terminal, so no browser was opened.")

    return Answer(report, show_scores)


class ExplainReport(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of one event, and the reasons; what a licence keeps, such as places, is left out.

    Attributes:
        event_id: Id of the event.
        sequence_id: Id of the sequence that it became; null if it became none.
        dataset: Name of the dataset.
        recording_id: Id of the recording.
        outcome: ``sequence``, or why it became none, such as ``not_primed``.
        stages: The stages in the order in which curation asks, with the numbers beside what they are compared with.
        notice: Sentence that the dataset's terms ask a picture to show; empty if they ask for none.
        video: ``event_time``, ``prime_time`` (seconds of the video), ``event_frame``, ``prime_frame`` (from 0); empty
            where the dataset does not tell.
    """

    event_id: str
    sequence_id: str | None
    dataset: str
    recording_id: str
    outcome: str
    stages: tuple[StoryStage, ...]
    notice: str
    video: dict[str, float]


@command("explain", example="prbench explain Mug_2/pick --data tables/adt --draw story.png", report=ExplainReport)
@click.argument("event")
@click.option("--data", type=opt.PATH, required=True, metavar="DIR", help="Built dataset folder.")
@opt.option("--draw", "Draw the story (.png, .svg, .pdf).", type=opt.OUT_FILE, metavar="FILE")
@opt.option("--picture", f"{LOOKS}; needs --root.", type=opt.OUT_FILE, metavar="FILE")
@opt.root_option("The recordings that the table was built from.", required=False)
@opt.reader_options(remark="only those that name files or folders have to be said again")
@opt.permission_option
def explain(
    *, event: str, data: Path, draw: Path | None, picture: Path | None, root: Path | None, **given: Any
) -> Answer:
    """Tell what became of one event and why.

    EVENT is an event id, or any part of it that fits one event only.
    """
    from prbench.viewing.explain import draw_event_story, explain_event

    if (picture is None) != (root is None):
        raise UsageError("--picture FILE and --root DIR belong together: gaze stands in the recordings.")
    permission = given["permission"]
    story = explain_event(data, event, permitted=permission)
    if draw is not None:
        draw_event_story(story, draw)
    caption = ""
    if picture is not None and root is not None:
        from prbench.viewing.looks import draw_event_looks

        caption = draw_event_looks(data, story.event, root, picture, given["options"], permission)
    # The report takes the fields that it names; the others, such as places, stay out of it.
    told = {name: getattr(story.event, name) for name in ("event_id", "sequence_id", "recording_id", "outcome")}
    told["video"] = {name: float(text) for name, text in (story.event.video or {}).items()}
    report = ExplainReport(dataset=story.dataset, stages=story.stages, notice=story.notice, **told)

    def show() -> None:
        print(story.text())
        if draw is not None:
            print(f"drawing: {draw}")
        if picture is not None:
            print(f"caption: {caption}\npicture: {picture}")

    return Answer(report, show)


_REVIEW = "prbench review tables/adt --root /data/ADT --out review.html"


@command("review", example=_REVIEW, report="prbench.viewing.review:Review")
@click.argument("data", type=opt.PATH, metavar="TABLE")
@opt.root_option("The recordings that the table was built from.")
@opt.out_file_option("The page (.html).", required=True)
@click.option("--outcome", "outcomes", multiple=True, metavar="NAME", help="Only events with this outcome; repeatable.")
@click.option("--recording", "recordings", default="*", metavar="GLOB", help="Only recordings whose name matches.")
@click.option("--object", "objects", default="", metavar="TEXT", help="Only objects with this in their name or id.")
@opt.option("--max-confidence", "Only events at most so sure, from 0 to 1.", type=opt.NumberRange(0, 1), metavar="X")
@opt.number_option("--limit", "Only the N most doubtful events (default: all).")
@opt.reader_options(remark="of the table's own options only those that name files or folders have to be said again")
@opt.permission_option
@opt.engine_options()
def review(
    *, root: Path, options: opt.Pairs, permission: tuple[str, ...], engine: EngineChoice, **given: Any
) -> Answer:
    """Write a page on which a person looks through events and corrects them.

    TABLE is a built dataset. The page needs neither server nor network; what it saves is a file for `build-dataset
    --corrections`.
    """
    from prbench.viewing.review import write_review

    where = opt.opened(engine, reads=(root,))
    with progress("reading recordings") as tell:
        done = write_review(root=root, option=options, permitted=permission, engine=where, progress=tell, **given)
    for name, problem in done.without_picture.items():
        note(f"no pictures: {name}: {problem}")

    def show() -> None:
        print(f"{done.events} events, the most doubtful first; the body can be played for {done.motions}")
        print(f"page: {done.out}")

    return Answer(done, show, NOT_EVERYTHING if done.without_picture else 0)


# Changes that are printed; the report holds all.
SHOWN = 40


_DIFF = "prbench diff tables/adt tables/adt-wrist --out changes.json"


@command("diff", example=_DIFF, report="prbench.curation.differences:Difference")
@click.argument("first", type=opt.PATH, metavar="BUILD_A")
@click.argument("second", type=opt.PATH, metavar="BUILD_B")
def diff(first: Path, second: Path) -> Answer:
    """Say which events and sequences differ between two builds of a dataset, and which stage decided.

    BUILD_A and BUILD_B are built dataset folders. The exit code is 1 where they differ.
    """
    from prbench.curation.differences import KINDS, compare_builds

    difference = compare_builds(first, second)
    changes = difference.changes

    def show() -> None:
        if difference.settings:
            print_table("what the builds were made with", ("", "first", "second"), difference.settings)
        counts = Counter(change.kind for change in changes)
        if changes:
            rows = [(kind, str(counts[kind]), meaning) for kind, meaning in KINDS.items() if kind in counts]
            print_table("changes", ("kind", "events", "meaning"), rows, numbers=(1,))
            header = ("kind", "recording", "event", "first", "second", "decided by")
            rows = [tuple(value or "–" for value in vars(change).values()) for change in changes[:SHOWN]]
            print_table("events", header, rows)
        if len(changes) > SHOWN:
            print(f"… and {len(changes) - SHOWN} more: --out FILE")
        print(f"unchanged: {difference.unchanged_events} events, {difference.unchanged_sequences} of them sequences")

    return Answer(difference, show, 0 if difference.equal else 1)
