"""``prbench export-motion``: motions in files that other tools open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress

_EXAMPLE = "prbench export-motion runs/static --data tables/adt --sequence Mug_2/pick --format bvh --out mug.bvh"
_FORMAT = "The format (docs/exporting.md)."


@command("export-motion", example=_EXAMPLE, report="prbench.viewing.exporting.export:ExportReport")
@click.argument("source", type=opt.PATH, metavar="RUN|TABLE")
@opt.choice_option("--format", ["bvh", "glb", "npz", "smpl", "rrd", "mp4"], _FORMAT, required=True)
@opt.out_file_option("The file; a folder where there are several.", required=True, metavar="FILE|DIR")
@opt.data_option(required=False, help="The table(s) of the run; not needed for the embedded synthetic datasets.")
@opt.sequence_option("Export this sequence")
@opt.limit_option("4")
@click.option("--sample", type=int, default=0, metavar="K", help="Sample of runs with several (default 0, the first).")
@opt.flag("--recorded", "The recorded motion of a run's sequences, too: beside it in rrd and mp4, else in a file each.")
@opt.choice_option("--unit", ["m", "cm"], "Unit of BVH (default m).", default="m")
@opt.path_option("--body-model", "Your own SMPL, SMPL-H or SMPL-X (.npz), for smpl.")
@opt.root_option("The recordings, whose streams rrd holds, too.", required=False)
@opt.path_option("--video", "Draw gaze and goal onto this egocentric video, for mp4; needs --root, --calibration.")
@opt.path_option("--calibration", "The video's camera: device_calibration.json, as HD-EPIC has it.")
@opt.permission_option
def export_motion(
    *, source: Path, data: tuple[Path, ...], root: Path | None, permission: tuple[str, ...], **given: Any
) -> Answer:
    """Write motions into files that other tools open, one file a motion.

    Of RUN the generated motions are written, of TABLE the recorded ones.
    """
    from prbench.sequences.dataset_info import FILE_NAME
    from prbench.viewing.exporting.export import ExportRequest
    from prbench.viewing.exporting.export import export_motion as export

    is_table = (source / FILE_NAME).is_file()
    runs, data = ((), (source, *data)) if is_table else ((source,), data)
    given |= {"form": given.pop("format"), "recordings": root, "permitted": permission}
    request = ExportRequest(runs=runs, data=data, **given)
    with progress(f"writing {given['out'].name}") as show:
        report = export(request, show)

    def show_files() -> None:
        for motion in report.motions:
            error = f", joints within {motion.largest_error_mm:.1f} mm" if motion.error_mm else ""
            print(f"{motion.file}: {motion.sequence_id}, {motion.motion}, {motion.n_frames} frames{error}")
        for notice in dict.fromkeys(motion.notice for motion in report.motions if motion.notice):
            print(f"notice: {notice}")
        for dataset in report.left_out:
            print(f"left out: recorded motion and goals of {dataset} (--permission {dataset} adds them)")
        print(f"exported: {report.out}")

    return Answer(report, show_files)
