"""The worked example of the documentation runs as it is printed."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from prbench_adapters.training import MotionBatch
from tests.adapters.training.tables import sequence_table

PAGE = Path(__file__).parents[3] / "docs" / "training-data.md"


def test_the_worked_example_learns(tmp_path):
    (example,) = re.findall(r"```python\n(from itertools.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict = {}
    exec(example, names)
    table = sequence_table(tmp_path / "t")
    _, before = names["train"](table.folder, steps=1, cache=tmp_path / "cache")
    _, after = names["train"](table.folder, steps=60, cache=tmp_path / "cache")
    assert after < before / 2


def test_the_page_names_every_field_of_a_batch():
    named = set(re.findall(r"`(?:batch\.)?(\w+)`", PAGE.read_text(encoding="utf-8")))
    assert {field.name for field in fields(MotionBatch)} <= named
