"""``prbench explain``: one event's story."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import OUT_FILE, PATH, permission_option


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
@click.option("--data", type=PATH, required=True, metavar="DIR", help="Built dataset folder.")
@click.option("--draw", type=OUT_FILE, metavar="FILE", help="Draw the story as PNG.")
@permission_option
def explain(event: str, data: Path, draw: Path | None, permission: tuple[str, ...]) -> Answer:
    """Tell what became of one event and why.

    EVENT is an event id, or any part of it that fits one event only.
    """
    from prbench.viewing.explain import explain_event

    story = explain_event(data, event, permitted=permission)
    if draw is not None:
        from prbench.viewing.event_story import draw_event_story

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
