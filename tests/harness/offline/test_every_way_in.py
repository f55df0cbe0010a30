"""One method by every way in: in process, isolated, as a program, and offline. Its scores are the same bytes."""

from __future__ import annotations

import importlib.util
import shlex
import sys
from pathlib import Path

import numpy as np

from prbench.contract import Condition
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.score_predictions import score_predictions
from prbench.harness.score_request import ScoreRequest
from tests.harness.offline import method

GLIDE = Path(__file__).parents[3] / "docs/examples/glide.py"


def run(table, out, name, **changes) -> bytes:
    asked = {"condition": Condition.GOAL_LOCATION, "seed": 3, "samples": 2, "batch_size": 4, **changes}
    run_method(RunRequest(method=name, data=(table.folder,), out=out, **asked))
    return (out / "synthetic-adt/scores.parquet").read_bytes()


def offline(table, folder, make) -> bytes:
    """Export, let ``make`` generate the motions of all rows, and score them."""
    path = folder / "conditions.npz"
    request = ExportRequest(data=(table.folder,), condition=Condition.GOAL_LOCATION, out=path, seed=3, samples=2)
    export_conditions(request)
    conditions = read_conditions_file(path)
    made = method.write_ragged(folder / "made.npz", conditions, make(conditions))
    score_predictions(
        ScoreRequest(predictions=made, data=(table.folder,), conditions=path, out=folder / "offline", name="x")
    )
    return (folder / "offline/synthetic-adt/scores.parquet").read_bytes()


def test_in_process_isolated_and_offline(table, tmp_path, install):
    install("drift", method.SOURCE)
    inside = run(table, tmp_path / "inside", "drift")
    assert run(table, tmp_path / "isolated", "drift", isolate=True) == inside
    assert offline(table, tmp_path, method.generated) == inside


def test_the_program_of_the_wire_protocols_page_scores_alike_offline(table, tmp_path):
    spec = importlib.util.spec_from_file_location("glide", GLIDE)
    assert spec is not None
    assert spec.loader is not None
    glide = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(glide)

    def made(conditions) -> list[np.ndarray]:
        motions = []
        for row in range(len(conditions)):
            given = {
                "noise_seed": int(conditions.noise_seed[row]),
                "initial_joints": conditions.initial_joints[row].astype(np.float64),
                "goal_location": conditions.goal_location[row],
            }
            frames, fps = int(conditions.n_frames[row]), float(conditions.fps[row])
            motions.append(glide.motion(given, frames, fps, {"stop_before": 0.4}))
        return motions

    as_program = run(table, tmp_path / "program", f"cmd:{shlex.join([sys.executable, str(GLIDE)])}")
    assert offline(table, tmp_path, made) == as_program
