"""The picture of one alignment: speeds, residuals, X over time, distances of devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.alignment.report import AlignedRecording, Evidence
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, styled, write_figure

_SHOWN = 20.0  # s of angular speeds around the fastest turn
_POINTS = 3000  # of a line at most
_WINDOWS = ("rotation against the first window, °", "translation, cm")
_PANELS = (
    (f"a  angular speed (°/s), {_SHOWN:g} s around the fastest turn", ("device", "segment")),
    ("b  difference of relative motions", ("° a motion", "mm a motion")),
    ("c  X of windows of 120 s", _WINDOWS),
    ("d  wristbands to the suit's hands, glasses to the head joint (cm)", ("left", "right", "head")),
)


@styled
def draw_alignment(report: AlignedRecording, evidence: Evidence, path: Path) -> None:
    """Draw angular speeds after alignment, residuals, rolling X and the distances of devices over time.

    Args:
        report: What was found.
        evidence: The measurements behind it.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    found = report.alignment
    lines = dict(evidence)
    if found.rolling:
        rows = np.array(found.rolling)
        turned = 2 * np.rad2deg(np.arccos(np.minimum(np.abs(rows[:, 1:5] @ rows[0, 1:5]), 1.0)))
        moved = 100 * np.linalg.norm(rows[:, 5:] - rows[0, 5:], axis=1)
        lines |= {name: (rows[:, 0], each) for name, each in zip(_WINDOWS, (turned, moved), strict=True)}
    if "device" in lines:
        times, speed = lines["device"]
        fastest = times[speed.argmax()]
        for name in lines.keys() & {"device", "segment"}:
            shown = np.abs(lines[name][0] - fastest) <= _SHOWN / 2
            lines[name] = (lines[name][0][shown], lines[name][1][shown])
    start = min((float(times[0]) for times, _ in evidence.values() if len(times)), default=0.0)
    figure = new_figure(7.0, 5.6, layout="constrained")
    panels = figure.subplots(len(_PANELS), 1)
    for panel, (title, names) in zip(panels, _PANELS, strict=True):
        panel.set_title(title)
        for number, name in enumerate(name for name in names if name in lines):
            times, values = (each[:: max(1, len(each) // _POINTS)] for each in lines[name])
            style = {"marker": ".", "markersize": 1, "linestyle": ""} if "motion" in name else {"linewidth": 0.8}
            panel.plot(times - start, values, color=f"C{number}", label=name, **style)
        for slip in found.slips if panel.lines and names != _PANELS[0][1] else ():
            panel.axvline(slip.time - start, color="0.3", linestyle=":", linewidth=0.9)
        if panel.lines:
            panel.set_yscale("log" if "motion" in names[0] else "linear")
            panel.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, markerscale=6)
        else:
            panel.text(0.5, 0.5, "not measured", transform=panel.transAxes, ha="center", color="0.5")
    panels[-1].set_xlabel("seconds after the first measurement (dotted: the device slipped)")
    said = found.refused or "; ".join(found.findings) or "no finding"
    figure.suptitle(figure_text(f"{report.recording_id}: {report.compared}\n{said}"), wrap=True)
    write_figure(figure, path, f"Alignment of {report.recording_id}: {said}.")
