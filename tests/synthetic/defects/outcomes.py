"""What every damaged copy of two recordings has to come to in a build."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from prbench.curation import BuildReport
from prbench.synthetic.layouts import Defect


def assert_outcome(
    defect: Defect, report: BuildReport, sound: BuildReport, folder: Path, harmless: Collection[str]
) -> None:
    """The damaged recording is judged as the defect says, and the other one as before.

    Args:
        defect: What was done to the first recording.
        report: Of the build of the damaged copy.
        sound: Of the build before.
        folder: In which all this happened; no message may name it.
        harmless: Names of defects that reading does not mind.
    """
    first, second = report.records
    assert first.status == defect.outcome, first.message
    assert defect.says in first.message
    assert str(folder) not in first.message, "no folder of this machine in the table"
    assert second == sound.records[1], "the other recording is as it was"
    if defect.name in harmless:
        assert first == sound.records[0]
        assert report.info.content_digest == sound.info.content_digest
