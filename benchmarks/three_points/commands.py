"""``prbench build-tracks``: Nymeria, or synthetic people in its layout, into tracks of head and wrists."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli import builds
from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress
from prbench.entry_points import CORPORA, load_built_in

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice


@command(
    "build-tracks",
    section="data",
    example="prbench build-tracks nymeria --root /data/Nymeria --devices synthetic --out tracks/nymeria",
    report="prbench_benchmarks.three_points.table:TracksInfo",
)
@click.argument("dataset", type=click.Choice(["nymeria"]))
@opt.root_option()
@opt.out_folder_option("Folder of the tracks; earlier ones are replaced once the new ones are ready.", required=True)
@click.option(
    "--devices",
    type=click.Choice(["real", "synthetic"]),
    default="real",
    help="Measured poses of glasses and wristbands (default), or the suit's own head and hands.",
)
@opt.option("--fps", "Frames a second, 30 or 60 (default 60).", type=float, default=60.0, metavar="N")
@opt.recordings_options
@opt.on_error_option()
@opt.engine_options()
def build_tracks(
    *, dataset: str, root: Path, out: Path, on_error: str, engine: EngineChoice, max_recordings: int | None, **given
) -> Answer:
    """Cut recordings into tracks of three points: the poses of head and wrists, beside the body that they belong to."""
    where = opt.opened(engine, reads=(root,), writes=(out,))
    given |= {"limit": max_recordings, "stop_on_error": on_error == "fail"}
    with progress(f"cutting {dataset}") as tell:
        info = load_built_in(CORPORA, "tracks")(root, out, engine=where, progress=tell, **given)
    rows = [(name, str(number)) for name, number in msgspec.to_builtins(info.counts).items()]
    title = f"{info.title}: {info.devices} devices, {info.fps:g} frames a second"
    return builds.answer_of_table(info, info, title, rows, f"tracks: {out}")
