"""The table of docs/firewall.md, cell by cell: what a cheating method gets at, measured."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.methods.isolation import available_fence
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests.harness.firewall.cheater import ATTEMPTS
from tests.harness.firewall.conftest import BATCH_SIZE, COLUMNS, ROOT, WORKERS, digest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the cells about /proc are those of Linux")

PAGE = (ROOT / "docs" / "firewall.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `(\w+)` \|[^|]*\| ([^|]*) \| ([^|]*) \| ([^|]*) \|$", PAGE, re.MULTILINE)
CELLS = [(attempt, column, cell) for attempt, *cells in ROWS for column, cell in zip(COLUMNS, cells)]
BY_EFFECT = {"write_inputs", "longer", "patch_metrics", "outlive"}
"""Attempts that bring nothing home; the run itself shows whether they worked."""


@dataclass(frozen=True)
class Truth:
    """What only somebody can claim who knows what a method must not know."""

    ids: tuple[str, ...]
    opaque: dict[str, str]
    sinks: dict[str, float]
    """Metres by which the lowest joint of each sequence still comes down."""
    n_frames: dict[str, int]

    def claim(self, attempt: str, name: str) -> set[bytes]:
        """Digests of the right answers for one sequence."""
        fixed = {"memory_of_the_harness": "memory", "network": "the answer", "leave_thread": "thread"}
        if attempt in fixed:
            return {digest(fixed[attempt])}
        if attempt == "state":
            return {digest(opaque) for other, opaque in self.opaque.items() if other != name}
        if attempt == "floor":
            return {digest(f"{self.sinks[name] * 1000:.0f} mm")}
        return {digest(name), digest("\n".join(self.ids))}


@pytest.fixture(scope="session")
def truth(playground) -> Truth:
    (chunk,) = playground.table.chunks(split="test")
    ids = chunk.sequence_ids
    motions = np.split(chunk.joints, chunk.offsets[1:-1])
    salt = run_salt(0, playground.table.identity)
    return Truth(
        tuple(sorted(ids)),
        dict(zip(ids, opaque_ids(ids, salt))),
        {name: float(joints[0, :, 1].min() - joints[:, :, 1].min()) for name, joints in zip(ids, motions)},
        dict(zip(ids, chunk.n_frames.tolist())),
    )


@pytest.fixture
def outing(playground, request):
    """The run of one column, or the reason why there is none here."""
    if request.param == "bubblewrap" and available_fence().program is None:
        pytest.skip(available_fence().reason)
    return playground.outing(request.param)


every_column = pytest.mark.parametrize("outing", COLUMNS, indirect=True)


def test_the_page_has_a_row_for_every_attempt():
    assert {attempt for attempt, *_ in ROWS} == {*ATTEMPTS, "longer"}
    assert len(ROWS) == len(ATTEMPTS) + 1


@pytest.mark.parametrize(("attempt", "outing", "cell"), CELLS, indirect=["outing"])
def test_a_cell_says_what_was_measured(attempt, outing, cell, truth):
    if attempt in BY_EFFECT:
        assert _worked(attempt, outing, truth) == (cell == "yes")
        return
    claims = outing.claims[attempt]
    assert set(claims) == set(truth.ids)
    made = {name: claim for name, claim in claims.items() if claim is not None}
    right = sum(claim in truth.claim(attempt, name) for name, claim in made.items())
    assert right == len(made), "a claim that is not true was counted as one"
    counted = {"no": right == 0, "yes": right >= len(claims) - BATCH_SIZE}
    assert counted.get(cell, f"{right} of {len(claims)}" == cell), f"{right} of {len(claims)} claims were right"


@pytest.mark.slow
@pytest.mark.parametrize("attempt", [attempt for attempt in ATTEMPTS if attempt.endswith("_of_parents")])
def test_workers_of_a_pool_tell_no_more_than_the_harness(attempt, playground):
    assert set(playground.outing(WORKERS).claims[attempt].values()) == {None}


def _worked(attempt: str, outing, truth: Truth) -> bool:
    if attempt == "outlive":
        return outing.survivors > 0
    if attempt == "patch_metrics":
        return outing.reach_success == 1.0
    return outing.n_frames != truth.n_frames


@every_column
def test_forged_scores_do_not_survive_scoring_again_in_another_process(outing, playground):
    (again,) = score_predictions(ScoreRequest(predictions=outing.folder, data=(playground.table.folder,)))
    assert {item.metric: item.mean for item in again.summary.metrics}["reach_success"] == 0.0


@every_column
def test_the_run_says_how_the_method_was_kept(outing, request):
    column = request.node.callspec.params["outing"]
    kept = RunRecord.read(outing.folder).method.isolation
    assert kept == (None if column == "in process" else column)
    assert ("NOT WITHHELD" in outing.log) == (column == "process")
