"""What damaged copies of GIMO come to in a build, on two segments of 45 frames in the synthetic layout."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.curation import build_dataset
from prbench.synthetic.layouts import defects_of
from tests.readers import gimo_sample as sample

DEFECTS = {defect.name: defect for defect in defects_of("gimo")}
FIRST, SECOND = "2022-01-01-000000", "2022-01-02-000000"


@pytest.fixture
def root(tmp_path) -> Path:
    segments = (sample.readings(scene="one", sequence=FIRST), sample.readings(scene="two", sequence=SECOND))
    return sample.write_root(tmp_path / "gimo", *segments)


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_comes_to_what_it_should(root, name, tmp_path) -> None:
    defect = DEFECTS[name]
    defect.apply(root, FIRST)
    first, second = build_dataset("gimo", root, tmp_path / "table").records
    assert first.status == defect.outcome, first.message
    assert defect.says in first.message
    assert second.status == "read", "the others go on"
    assert str(tmp_path) not in first.message, "no folder of this machine in the table"


def test_the_sound_segment_shows_none_of_this(root, tmp_path) -> None:
    first, _ = build_dataset("gimo", root, tmp_path / "table").records
    assert first.status == "read"
    assert [defect.name for defect in DEFECTS.values() if defect.says in first.message] == []
