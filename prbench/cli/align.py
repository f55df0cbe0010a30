"""``prbench align``: one clock and one world for glasses and body, with residuals and findings."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.alignment.report import AlignedRecording, TrackSource

_EXAMPLE = "prbench align nymeria --root /data/Nymeria --out aligned"
_HEADER = ("recording", "offset s", "drift ms", "° p50 / p95", "mm p50 / p95", "distance cm, sd")


@command("align", example=_EXAMPLE, report=["prbench.alignment.report:AlignedRecording"])
@click.argument("dataset", metavar="DATASET")
@opt.root_option()
@opt.recordings_options
@opt.reader_options()
@opt.path_option("--out", "Write RECORDING.json and RECORDING.png of each into this folder.", metavar="DIR")
@opt.workers_option()
def align(*, dataset: str, root: Path, out: Path | None, workers: int, **chosen: Any) -> Answer:
    """Find how the glasses sit on the head: the clocks' offset and drift, the transform, residuals, slips, wristbands.

    DATASET is nymeria, or any dataset whose reader gives poses of glasses and a body. Recordings that cannot be aligned
    are refused with the reason; the exit code is then 3.
    """
    from prbench.alignment.report import chosen_tracks
    from prbench.engine import engine_for

    sources = chosen_tracks(dataset, root, chosen["recordings"], chosen["max_recordings"], chosen["options"])
    reports: list[AlignedRecording] = []
    with progress("aligning") as tell:
        for report in engine_for(workers).map(partial(aligned, out), sources):
            reports.append(report)
            tell(len(reports), len(sources), report.recording_id)

    def show() -> None:
        rows = []
        for each in reports:
            found = each.alignment
            numbers = ["refused", *["–"] * 3]
            if found.clock is not None and not found.refused:
                joint = [f"{row.p50:.2f} / {row.p95:.2f}" for row in found.residuals[2:]]
                numbers = [f"{found.clock.offset:.4f}", f"{1e3 * found.clock.drift:.1f}", *joint]
            away = [it.refused or f"{it.mean_cm:.1f}, {it.deviation_cm:.1f}" for it in each.distances]
            said = [f"{it.of} {text}" for it, text in zip(each.distances, away, strict=True)]
            rows.append((each.recording_id, *numbers, "; ".join(said) or "–"))
            for sentence in filter(None, (found.refused, *found.findings)):
                note(f"{each.recording_id}: {sentence}")
        print_table(f"{dataset}: {reports[0].compared}", _HEADER, rows, numbers=(1, 2))

    return Answer(reports, show, NOT_EVERYTHING if any(each.alignment.refused for each in reports) else 0)


def aligned(out: Path | None, source: TrackSource) -> AlignedRecording:
    """Align one recording, and write its record and picture."""
    from prbench.alignment.report import compare
    from prbench.files.storage import write_json
    from prbench.viewing.alignment import draw_alignment

    report, evidence = compare(source)
    if out is not None:
        name = report.recording_id.replace("/", "_")
        write_json(out / f"{name}.json", msgspec.to_builtins(report))
        draw_alignment(report, evidence, out / f"{name}.png")
    return report
