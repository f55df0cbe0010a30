from __future__ import annotations

import pytest

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.charts import ChartPanel, ChartPoint, draw_chart

PANEL = ChartPanel("error", "s", "m", {"a": [ChartPoint(0.5, 1.0, 0.5, 1.5), ChartPoint(1.0, 2.0, None, None)]})


def test_equal_charts_are_equal_bytes(tmp_path):
    for name in ("one.svg", "two.svg"):
        draw_chart([PANEL], tmp_path / name, note="a note")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    assert "a note" in (tmp_path / "one.svg").read_text()


def test_nothing_to_draw_is_refused(tmp_path):
    with pytest.raises(UsageError, match="nothing to draw"):
        draw_chart([ChartPanel("error", "s", "m", {})], tmp_path / "one.svg")
