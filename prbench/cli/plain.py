"""``prbench prime``: when gaze first met the place of each event, from files of gaze, objects and events.

``prbench plain-recording``: plain recordings out of what other programs write (docs/own-recordings.md).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

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


_SOURCES = {
    "aria": "SOURCE is a folder of Project Aria's Machine Perception Services: head, gaze and wrists.",
    "csv": "No SOURCE, but tables of any column names.",
    "rerun": "SOURCE is an .rrd (pip install 'prbench[rerun]'): head, gaze, wrists, body and boxes.",
}
_PLAIN = "prbench plain-recording csv --head head.csv --gaze gaze.csv --column time=ts --out own/P01"
_NAMES = "Name of a column in the files, such as time=ts or gaze.time=ts; of rerun the entity of head, gaze, left and"
_NAMES += " right (wrist) or body, and the timeline, such as gaze=world/eye (default: found by name); repeatable."


@command("plain-recording", example=_PLAIN, items=_SOURCES, report="prbench.readers.own.convert:Converted")
@click.argument("kind", type=click.Choice([*_SOURCES]))
@click.argument("source", type=opt.PATH, required=False)
@opt.out_folder_option("Folder of the recording.", required=True)
@opt.option("--participant", "Name of the person (default: that of the folder).", default="", metavar="NAME")
@opt.pairs_option("--column", "named", _NAMES, metavar="OURS=THEIRS")
@_file_options
def plain_recording(*, about: About, participant: str, **given: Any) -> Answer:
    """Write a plain recording, which `prbench build-dataset own` reads, out of what another program has written."""
    from prbench.readers.own.convert import convert

    done = convert(about=msgspec.structs.replace(about, participant=participant), **given)

    def show() -> None:
        for line in (*(f"{name}: {count} rows" for name, count in done.rows.items()), *done.remarks):
            print(line)
        print(f"plain recording: {done.out}; its recording.toml says units and axes")

    return Answer(done, show)
