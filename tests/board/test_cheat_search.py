"""The search for cheats: the same for a seed and any engine, told by its parameters, and bad input refused."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.board import cheat_search
from prbench.board.cheat_search import BOTH, FoundMotion, Judged, judged_tables, search
from prbench.cli import main
from prbench.engine import InProcess, ProcessPool
from prbench.harness.scripted import Altered, Body
from tests.board.test_audit import people_in_every_split


@pytest.fixture(scope="module")
def judged() -> list[Judged]:
    return judged_tables([people_in_every_split()], split="test", limit=4)


def found(judged: list[Judged], column: str, engine: object = None, seed: int = 0, tries: int = 48) -> FoundMotion:
    steps: list[int] = []
    ((best, *_),) = search(
        judged,
        [column],
        evaluations=tries,
        seed=seed,
        engine=engine or InProcess(),
        progress=lambda done, _total, _column: steps.append(done),
    )
    assert steps == list(range(1, tries // 24 + 1))
    return best


def test_a_seed_finds_the_same_motion_with_any_engine_and_its_parameters_earn_the_same(judged):
    best = found(judged, BOTH)
    assert best == found(judged, BOTH, ProcessPool(2))
    assert judged[0].means(Body(**best.parameters)) == best.means


class Tried(InProcess):
    """Remembers what was tried."""

    def __init__(self) -> None:
        self.motions: list[np.ndarray] = []

    def map(self, function, items, **settings):
        self.motions += items
        return super().map(function, items, **settings)


def test_the_known_cheats_are_tried_first_and_another_seed_tries_others_around_them(judged):
    tried = {seed: Tried() for seed in (1, 2)}
    for seed, engine in tried.items():
        found(judged, "prime_success", engine, seed, tries=24)
    first = [np.array(engine.motions) for engine in tried.values()]
    known = len(cheat_search.scripted.BODIES)
    assert np.array_equal(first[0][:known], first[1][:known])
    assert not np.array_equal(first[0][known:], first[1][known:])


def test_recordings_that_were_changed_count_only_where_they_are_not_marked_as_copies(judged):
    assert judged[0].means(Altered())["plausible"] == 0.0 < judged[0].means(None)["plausible"]
    ((body, altered),) = search(judged, ["mpjpe"], evaluations=24, seed=0, engine=InProcess(), progress=lambda *_: None)
    assert body.name + ", altered recording" == altered.name


def test_the_command_prints_the_found_motion_among_the_controls_and_its_parameters(capsys):
    words = [
        "audit",
        "--data",
        str(people_in_every_split()),
        "--limit",
        "3",
        "--search",
        "reach_success",
        "--evaluations",
        "24",
    ]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "found for reach_success: turn_end=" in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--search", "reach"], "expected a column (arrival_and_reach, prime_success"),
        (["--search", "reach_sucess"], "Did you mean 'reach_success'?"),
        (["--seed", "3"], "--evaluations and --seed belong to --search"),
        (["--search", "--evaluations", "0"], "0 is not in the range"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(words, said, capsys):
    assert main(["audit", *words]) == 2
    assert said in capsys.readouterr().err
