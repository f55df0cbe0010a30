"""``prbench explain``: one event's story."""

from __future__ import annotations

import argparse
from pathlib import Path

from prbench.cli.arguments import add_permission, command


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "explain",
        summary="tell what became of one event and why",
        example="prbench explain Mug_2/pick --data tables/adt --draw story.png",
        execute=_explain,
    )
    parser.add_argument("event", help="event id, or any part of it that fits one event only")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="built dataset folder")
    parser.add_argument("--draw", type=Path, metavar="FILE", help="draw the story as PNG")
    add_permission(parser)


def _explain(arguments: argparse.Namespace) -> int:
    from prbench.workflows.explain import explain_event

    story = explain_event(arguments.data, arguments.event, permitted=arguments.permission)
    if arguments.draw is not None:
        from prbench.viewing.event_story import draw_event_story

        draw_event_story(story, arguments.draw)
    print(story.text())
    if arguments.draw is not None:
        print(f"drawing: {arguments.draw}")
    return 0
