"""Import a release that was just written, and look at what came of it."""

from __future__ import annotations

import numpy as np

from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from prbench.release.report import ImportReport
from prbench.sequences import SequenceTable
from tests.release.releases import rows, write_release

ROWS = rows(6)


def imported(folder, sequences=ROWS, style=None, *, options=None, **kinds) -> ImportReport:
    write_release(folder / "release", sequences, style, **kinds)
    result = import_release(
        folder / "release", folder / "table", dataset="synthetic-adt", options=options or ImportOptions()
    )
    return result.tables[0]


def value(report: ImportReport, name: str) -> tuple[str, str]:
    found = next(each for each in report.inferred if each.name == name)
    return found.value, found.how_surely


def table_values(folder, name: str) -> list[np.ndarray]:
    chunks = list(SequenceTable.open(folder / "table").chunks())
    return [chunk.vectors(name)[row] for chunk in chunks for row in range(len(chunk))]


def motions(folder) -> list[np.ndarray]:
    chunks = list(SequenceTable.open(folder / "table").chunks())
    return [np.array(c.joints[a:b]) for c in chunks for a, b in zip(c.offsets[:-1], c.offsets[1:])]
