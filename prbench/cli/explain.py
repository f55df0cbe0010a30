"""``prbench explain``: one event's story."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import OUT_FILE, PATH, permission_option

if TYPE_CHECKING:
    from prbench.sequences import Event
    from prbench.viewing.event_story import EventStory


class StageVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """One stage of curation and its verdict on the event.

    Attributes:
        name: Name of the stage, such as ``priming``.
        verdict: ``passed``, ``stopped here`` or ``not reached``.
        text: The numbers beside what they are compared with; empty for a stage that was not reached.
    """

    name: str
    verdict: str
    text: str


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
    """The outcome of one event, and the reasons.

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
        stages: The stages in the order in which curation asks.
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
    stages: list[StageVerdict]
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
    return Answer(_report(story, draw), lambda: _print(story, draw))


def _report(story: EventStory, drawing: Path | None) -> ExplainReport:
    event = story.event
    return ExplainReport(
        event_id=event.event_id,
        sequence_id=event.sequence_id,
        dataset=story.dataset,
        recording_id=event.recording_id,
        split=story.split,
        action=event.action,
        object_id=event.object_id,
        object_name=event.object_name,
        hand=event.hand,
        event_time=event.event_time,
        prime_time=event.prime_time,
        outcome=event.outcome,
        stages=[StageVerdict(name=stage.name, verdict=stage.verdict, text=stage.text) for stage in story.stages],
        other_events=[_other_event(other, event) for other in story.neighbours],
        notice=story.notice,
        drawing=drawing,
    )


def _other_event(other: Event, event: Event) -> OtherEvent:
    return OtherEvent(
        event_id=other.event_id,
        seconds_later=other.event_time - event.event_time,
        action=other.action,
        object_name=other.object_name,
        same_object=other.object_id == event.object_id,
        outcome=other.outcome,
    )


def _print(story: EventStory, drawing: Path | None) -> None:
    print(story.text())
    if drawing is not None:
        print(f"drawing: {drawing}")
