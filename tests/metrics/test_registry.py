"""What a metric says about itself, and how the metrics of a package are found."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from prbench.harness.intervals import metric_interval
from prbench.metrics import METRICS, MetricInfo, exported_unit, printed_unit
from prbench.metrics.registry import find_families

COMPARED = {
    "goal_mpjpe",
    "mpjpe",
    "location_error",
    "location_error_horizontal",
    "reach_wrist",
    "first_frame_error",
}

FAMILY = """
from prbench.metrics.registry import MetricFamily, MetricInfo

def compute(pair, constants):
    raise NotImplementedError

INFO = MetricInfo(
    "{id}", "T", "m", higher_is_better=None, main=False, position={position}, compares_with_recorded=True
)
FAMILY = MetricFamily((INFO,), compute)
"""


def info(unit: str = "m", **said) -> MetricInfo:
    about = {"higher_is_better": None, "main": False, "position": 30, "compares_with_recorded": False} | said
    return MetricInfo("made_up", "Made up", unit, **about)


def test_metrics_that_compare_with_the_recorded_motion_say_so():
    assert {metric.id for metric in METRICS if metric.compares_with_recorded} == COMPARED
    assert [metric.id for metric in METRICS if metric.carries_copy_remark] == ["mpjpe"]
    assert [metric.id for metric in METRICS if metric.irrelevant_if_motionless] == ["foot_skating"]


def test_a_metric_cannot_forget_whether_it_compares_with_the_recorded_motion():
    with pytest.raises(TypeError, match="compares_with_recorded"):
        MetricInfo("x", "X", "m", higher_is_better=False, main=False, position=30)  # type: ignore[call-arg]


def test_rates_are_printed_in_percent_and_all_other_units_as_they_are():
    printed = {
        unit: (info(unit).scale, printed_unit(unit), exported_unit(unit)) for unit in ("rate", "ratio", "m", "°")
    }
    assert printed == {
        "rate": (100.0, " %", "%"),
        "ratio": (1.0, "", "ratio"),
        "m": (1.0, " m", "m"),
        "°": (1.0, " °", "°"),
    }
    assert [info(higher_is_better=better).arrow for better in (True, False, None)] == [" ↑", " ↓", ""]


def test_an_interval_reaches_below_zero_only_where_a_value_can():
    values = np.array([0.0, 0.0, 0.0, 1.0])
    recordings = ["a", "b", "c", "d"]
    assert metric_interval(info(), values, recordings).low == 0.0
    assert metric_interval(info(can_be_negative=True), values, recordings).low < 0.0


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))

    def made(**modules: str):
        folder = tmp_path / "made_up_metrics"
        folder.mkdir()
        (folder / "__init__.py").touch()
        for name, source in modules.items():
            (folder / f"{name}.py").write_text(source)
        return find_families("made_up_metrics", [str(folder)])

    yield made
    for name in [name for name in sys.modules if name.startswith("made_up_metrics")]:
        del sys.modules[name]


def test_families_are_found_in_their_files_and_sorted_by_position(package):
    found = package(a=FAMILY.format(id="late", position=2), b=FAMILY.format(id="early", position=1), c="")
    assert [family.metrics[0].id for family in found] == ["early", "late"]


def test_an_id_that_two_files_use_is_refused(package):
    source = FAMILY.format(id="mine", position=1)
    with pytest.raises(ValueError, match="an id of its own, found 'mine' twice"):
        package(a=source, b=source)
