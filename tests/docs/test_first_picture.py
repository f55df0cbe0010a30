"""The program that draws the picture of the first page still draws sequences."""

from __future__ import annotations

import runpy

from PIL import Image

from prbench.curation import build_from_sources
from prbench.sequences import SequenceTable
from prbench.viewing.explain import explain_event
from tests.curation.sources import SceneSource
from tests.docs.test_citations import ROOT


def test_the_program_of_the_first_picture_draws_any_sequence(tmp_path):
    build_from_sources([SceneSource("room_a")], tmp_path / "adt")
    events = SequenceTable.open(tmp_path / "adt").events().to_pylist()
    became = next(event["event_id"] for event in events if event["outcome"] == "sequence")
    story = explain_event(tmp_path / "adt", became)
    program = runpy.run_path(str(ROOT / "docs" / "first_picture.py"))
    program["draw"](story.motion, tmp_path / "picture.png")
    drawn, shipped = Image.open(tmp_path / "picture.png"), Image.open(ROOT / "docs" / "prime_and_reach.png")
    assert drawn.size == shipped.size
    assert len(drawn.convert("RGB").getcolors(maxcolors=1 << 24)) > 100
