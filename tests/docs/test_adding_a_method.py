"""The predictor of docs/adding-a-method.md, as its reader would install and run it."""

from __future__ import annotations

import re
from pathlib import Path

from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from tests.benchmarks.motion_prediction.windows import write
from tests.method_fixtures import install, own_cache

__all__ = ["install", "own_cache"]

PAGE = (Path(__file__).parents[2] / "docs" / "adding-a-method.md").read_text(encoding="utf-8")


def test_the_predictor_of_the_page_runs(tmp_path, install):
    source = re.search(r"```python\n# prbench_drift\.py\n(.*?)```", PAGE, re.DOTALL)
    assert source is not None
    install("drift", source.group(1))
    metadata = tmp_path / "site" / "prbench_drift-1.2.dist-info" / "entry_points.txt"
    metadata.write_text(metadata.read_text().replace("prbench.adapters", "prbench.predictors"))
    report = run_method(
        RunRequest(
            benchmark="motion-prediction",
            method="drift",
            condition="pose",
            data=(write(tmp_path / "windows"),),
            samples=5,
            out=tmp_path / "out",
        )
    )
    apd = report.summaries[0].metric("apd")
    assert apd is not None
    assert apd.mean > 0
