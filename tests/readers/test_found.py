"""An optional file that is there and cannot be read is never taken for one that is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.curation import build_dataset
from prbench.curation.job import native_sources
from prbench.curation.options import NO_OPTIONS
from prbench.errors import InputFileError
from prbench.readers.found import input_file, is_present
from prbench.readers.gimo import format as gimo
from tests.readers import gimo_sample
from tests.readers.hd_epic_copies import write_copy


def test_a_folder_in_place_of_the_published_primes_is_told_and_nothing_is_built_without_them(tmp_path: Path) -> None:
    root = write_copy(tmp_path / "copy")
    (priming,) = root.rglob("priming_info.json")
    priming.unlink()
    priming.mkdir()
    with pytest.raises(InputFileError, match=r"priming_info\.json: expected a file, found a folder"):
        native_sources("hd-epic", root, NO_OPTIONS)[0].input_digest()
    report = build_dataset("hd-epic", root, tmp_path / "table")
    assert {record.status for record in report.records} == {"failed"}
    assert all("priming_info.json" in record.message for record in report.records)


@pytest.mark.parametrize("name", [gimo.SKELETON_FILE, f"{gimo.POSE_FOLDER}/120.pkl", f"{gimo.GAZE_FOLDER}/120.ply"])
def test_a_folder_in_place_of_a_file_of_a_segment_is_told(tmp_path: Path, name: str) -> None:
    root = gimo_sample.write_root(tmp_path / "GIMO", gimo_sample.readings())
    (path,) = root.glob(f"room1/*/{name}")
    path.unlink()
    path.mkdir()
    with pytest.raises(InputFileError, match="expected a file, found a folder"):
        native_sources("gimo", root, NO_OPTIONS)[0].input_digest()


def test_a_link_that_leads_nowhere_is_listed(tmp_path: Path) -> None:
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "nowhere")
    assert is_present(link)
    assert input_file("optional", link).path == link
    assert not is_present(tmp_path / "other.json")
