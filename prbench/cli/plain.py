"""``prbench prime``: when gaze first met the place of each event, from files of gaze, objects and events."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command
from prbench.cli.terminal import print_table
from prbench.cli.view import LOOKS

if TYPE_CHECKING:
    from prbench.readers.own.format import About

_TABLES = ("gaze", "head", "objects", "object-poses", "events", "wrists", "body")
_CHOICES = {"up": ["y", "z", "x"], "time_unit": ["s", "ms", "us", "ns"], "unit": ["m", "cm", "mm"]}


def _file_options(function: Callable) -> Callable:
    """Add a file for each table, and how these are read; the command gets ``files`` and ``about``."""

    @functools.wraps(function)
    def with_files(**given: Any) -> Any:
        from prbench.readers.own import format as own

        files = {name: given.pop(name) for name in own.TABLES}
        up, time, length = (given.pop(name) for name in _CHOICES)
        about = own.About(participant="-", units=own.Units(length=length, time=time), axes=own.Axes(up=up))
        return function(files={name: path for name, path in files.items() if path}, about=about, **given)

    for name, choices in _CHOICES.items():
        help = f"The files' own (default {choices[0]})."
        with_files = opt.choice_option(f"--{name.replace('_', '-')}", choices, help, default=choices[0])(with_files)
    for name in reversed(_TABLES):
        with_files = opt.path_option(f"--{name}", f"Table of {name.replace('-', ' ')} (.csv, .parquet).")(with_files)
    return with_files


_PRIME = "prbench prime --gaze gaze.csv --objects boxes.csv --events events.csv --picture looks.png"


@command("prime", example=_PRIME, report=["prbench.curation.own_priming:PrimedEvent"])
@_file_options
@opt.option("--window", "Seconds before an event in which a look primes it (default 10).", type=float)
@opt.option("--near-miss", "Metres at which gaze may pass a box (default 0.05).", type=float)
@opt.option("--picture", f"{LOOKS}; the first eight.", type=opt.OUT_FILE, metavar="FILE")
def prime(*, files: dict[str, Path], about: About, picture: Path | None, window: float, near_miss: float) -> Answer:
    """Say when gaze first met the place of each event: no dataset, no body.

    The tables are those of docs/own-recordings.md. Objects without poses stand still. Without --events, --objects is
    the table of events, with the place of each.
    """
    from prbench.curation import own_priming

    constants = own_priming.constants_of(priming_window=window, near_miss_distance=near_miss)
    recording = own_priming.read_files(files, about)
    events = own_priming.prime_recording(recording, constants)
    caption = ""
    if picture is not None:
        from prbench.viewing.looks import draw_looks, looks_around

        rays = own_priming.gaze_rays(recording, "eye")
        looks = [looks_around(rays, event, recording.objects, constants) for event in events]
        caption = draw_looks(looks, picture, constants)

    def show() -> None:
        names = [field.name for field in dataclasses.fields(own_priming.PrimedEvent)][:-2]  # without the box
        rows = []
        for event in events:
            cells = (getattr(event, name) for name in names)
            rows.append([f"{cell:.3f}" if isinstance(cell, float) else cell or "–" for cell in cells])
        print_table("seconds, metres", names, rows)
        if picture is not None:
            print(f"caption: {caption}\npicture: {picture}")

    return Answer(events, show)
