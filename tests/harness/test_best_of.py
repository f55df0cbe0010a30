"""Best of k: which motion is kept, on what that depends, and on what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.board import collect_runs, export, make_leaderboard
from prbench.cli import main
from prbench.contract import Condition, ConditionBatch, Cost, Motions
from prbench.engine import ProcessPool
from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.best_of import ChoiceRules, best_motions, choice_cost, goal_of
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions
from prbench.harness.run_folder.cost import RunCost
from prbench.protocol.manifests import load_protocol
from prbench.randomness import noise_seed
from tests.fakes import STANDING, fake_dataset, fake_sequence
from tests.harness.test_run import reproducible_bytes
from tests.method_fixtures import adapter_source

FRAMES = 81  # 4 s: the prime time of the protocol is in the middle
TILT = float(np.rad2deg(np.arctan2(0.06, 0.09)))  # of the standing body's head, which then looks straight ahead
GOAL = np.array([0.0, 1.6, 2.0])  # before the body, at the height of its head


def request(table, out, **changes) -> RunRequest:
    wanted = {"method": "made", "condition": Condition.GOAL_LOCATION, "data": (table.folder,), "out": out}
    return RunRequest(**{**wanted, "batch_size": 4, **changes})


def condition(n: int = 1) -> ConditionBatch:
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        n_frames=np.full(n, FRAMES),
        fps=20.0,
        opaque_id=tuple(map(str, range(n))),
        noise_seed=(0,) * n,
        text=("",) * n,
        initial_joints=np.tile(STANDING, (n, 1, 1)),
        previous_joints=np.tile(STANDING, (n, 1, 1)),
        goal_location=np.tile(GOAL, (n, 1)),
    )


def rules(n: int = 1, best_of: int = 2) -> ChoiceRules:
    return ChoiceRules.of(load_protocol(), best_of=best_of, head_tilt_deg=np.full(n, TILT))


def turned(yaw: np.ndarray) -> np.ndarray:
    """The standing body, turned about the vertical by an angle a frame; radians, 0 faces the goal."""
    turn = np.zeros((len(yaw), 3, 3))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(yaw)
    turn[:, 0, 2] = np.sin(yaw)
    turn[:, 2, 0] = -np.sin(yaw)
    turn[:, 1, 1] = 1.0
    return np.einsum("tij,kj->tki", turn, STANDING).astype(np.float32)


def arriving(frame: int = 40) -> np.ndarray:
    """A body that turns from the side to the goal, ever slower until it faces it in a frame."""
    left = np.clip((frame - np.arange(FRAMES)) / 20, 0, 1)
    return turned(1.5 * left**2)


def reaching(motion: np.ndarray) -> np.ndarray:
    reached = motion.copy()
    reached[-1, Joint.RIGHT_WRIST] = GOAL
    return reached


def cost_of(motion: np.ndarray) -> float:
    return float(choice_cost(Motions(motion[None], np.array([FRAMES])), condition(), rules())[0])


def test_the_cost_falls_with_every_condition_that_a_motion_fulfils():
    away = turned(np.full(FRAMES, 2.5))
    assert 2.0 < cost_of(away) < 2.5
    assert 1.0 < cost_of(reaching(away)) < 1.5
    assert 1.0 < cost_of(arriving()) < 1.5
    assert 0.0 < cost_of(reaching(arriving())) < 0.15


def test_a_body_that_stares_from_the_start_is_half_as_good_at_priming_as_one_that_arrives():
    wobble = 0.02 * np.sin(np.arange(FRAMES))
    assert 0.5 < cost_of(reaching(turned(wobble))) < 1.0
    assert cost_of(reaching(arriving())) < 0.5


def test_an_arrival_counts_within_a_second_of_the_protocols_prime_time_only():
    assert cost_of(reaching(arriving(frame=55))) < 0.5
    assert cost_of(reaching(arriving(frame=75))) > 1.0


def test_the_fractions_follow_the_formula_by_hand():
    # Standing still, 40° off: nothing decelerates, nothing arrives, no wrist is near.
    away = turned(np.full(FRAMES, np.deg2rad(40.0)))
    wrists = away[-1, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]].astype(float)
    w = np.linalg.norm(wrists - GOAL, axis=1).min() / 0.10
    ray = np.array([np.sin(np.deg2rad(40.0)), 0.0, np.cos(np.deg2rad(40.0))])
    to_goal = GOAL - away[0, Joint.HEAD]
    h = np.linalg.norm(to_goal - (to_goal @ ray) * ray) / 0.25
    assert cost_of(away) == pytest.approx(2.0 + (h / (1 + h) + w / (1 + w)) / 4, abs=1e-6)


def test_the_best_of_each_row_is_kept_the_first_of_equal_ones_and_all_passes_count():
    good, bad = reaching(arriving()), turned(np.full(FRAMES, 2.5))
    n_frames = np.array([FRAMES, FRAMES])
    draws = [Motions(np.stack(rows), n_frames, Cost(7)) for rows in ((bad, good), (good, bad), (good, good))]
    kept, chosen = best_motions(draws, [condition(2)] * 3, rules(2, best_of=3))
    assert list(chosen) == [1, 0]
    assert np.array_equal(kept.joints, np.stack([good, good]))
    assert kept.cost == Cost(21)


def test_a_motion_too_short_to_prime_is_chosen_by_its_wrist():
    short = replace(condition(), n_frames=np.array([10]))
    still, near = turned(np.zeros(10)), turned(np.zeros(10))
    near[-1, Joint.LEFT_WRIST] = GOAL
    draws = [Motions(motion[None], np.array([10])) for motion in (still, near)]
    _, chosen = best_motions(draws, [short] * 2, rules())
    assert list(chosen) == [1]


def test_the_goal_of_a_goal_pose_is_the_wrist_of_the_arm_that_does_not_hang():
    pose = STANDING.copy()
    pose[Joint.LEFT_WRIST] = pose[Joint.LEFT_SHOULDER] + (0.0, -0.2, 0.3)  # bent, before the body
    pose[Joint.RIGHT_WRIST] = pose[Joint.RIGHT_SHOULDER] + (0.0, -0.53, 0.05)  # straight, and hanging
    given = ConditionBatch(
        condition=Condition.GOAL_POSE,
        n_frames=np.array([FRAMES]),
        fps=20.0,
        opaque_id=("0",),
        noise_seed=(0,),
        text=("",),
        initial_joints=STANDING[None],
        previous_joints=STANDING[None],
        goal_joints=pose[None],
    )
    assert goal_of(given)[0] == pytest.approx(pose[Joint.LEFT_WRIST])


def test_the_best_of_one_is_a_run_without_the_option(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "plain", samples=2))
    run_method(request(table, tmp_path / "one", samples=2, best_of=1))
    assert reproducible_bytes(tmp_path / "plain") == reproducible_bytes(tmp_path / "one")


def test_workers_isolation_and_batches_change_no_choice(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "one", best_of=3))
    run_method(request(table, tmp_path / "two", best_of=3), engine=ProcessPool(2))
    assert reproducible_bytes(tmp_path / "one") == reproducible_bytes(tmp_path / "two")
    run_method(request(table, tmp_path / "apart", best_of=3, isolate=True))
    run_method(request(table, tmp_path / "single", best_of=3, batch_size=1))
    scores = [(tmp_path / name / "scores.parquet").read_bytes() for name in ("one", "apart", "single")]
    assert scores[0] == scores[1] == scores[2]


def test_what_is_kept_is_one_of_the_samples_of_a_longer_run_with_its_seed_and_the_cost_of_all(table, tmp_path, install):
    install("made", adapter_source(body="return Motions(joints, n_frames, Cost(5))"))
    run_method(request(table, tmp_path / "all", samples=6))
    report = run_method(request(table, tmp_path / "best", samples=2, best_of=3))
    drawn = Predictions.open(tmp_path / "all/predictions")
    kept = Predictions.open(tmp_path / "best/predictions")
    rows = [row for path in kept.paths for row in pq.read_table(path).to_pylist()]
    chosen = []
    for row in rows:
        name = row["sequence_id"]
        seeds = [noise_seed(0, name, draw) for draw in range(6)]
        chosen.append(seeds.index(row["seed"]))
        assert chosen[-1] // 3 == row["sample"]
        motion = kept.motions([name], row["sample"]).values
        assert np.array_equal(motion, drawn.motions([name], chosen[-1]).values)
    assert len(set(chosen)) > 2
    cost = RunCost.read(tmp_path / "best/cost.json")
    assert cost.motions + cost.warm_up_motions == 2 * 15
    assert cost.network_passes_declared == 4 * 2 * 3 * 5  # batches, samples, draws, passes
    assert (report.folder.record.samples, report.folder.record.best_of) == (2, 3)


def test_the_recorded_motion_between_first_and_last_frame_cannot_influence_the_choice(
    tmp_path, install, monkeypatch: pytest.MonkeyPatch
):
    install("made", adapter_source())

    def other_recording(index: int, **settings):
        sequence = fake_sequence(index, **settings)
        joints = sequence.joints.copy()
        joints[1:-1] = joints[1:-1][::-1] * np.float32(0.7)
        return replace(
            sequence,
            joints=joints,
            prime_time=sequence.start_time + 0.5,
            next_joints=joints[0],
            gaze_direction=-sequence.gaze_direction,
            hand="left",
        )

    first = fake_dataset(tmp_path / "first", 60)
    monkeypatch.setattr("tests.fakes.fake_sequence", other_recording)
    second = fake_dataset(tmp_path / "second", 60)
    assert first.identity == second.identity
    assert first.content != second.content
    kept = []
    for name, table in (("one", first), ("two", second)):
        run_method(request(table, tmp_path / name, best_of=4))
        kept.append([part.read_bytes() for part in sorted((tmp_path / name / "predictions").iterdir())])
    assert kept[0] == kept[1]
    assert (tmp_path / "one/scores.parquet").read_bytes() != (tmp_path / "two/scores.parquet").read_bytes()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"condition": Condition.NONE, "best_of": 2}, "'none' gives none. Choose --condition goal-loc or goal-pose"),
        ({"condition": Condition.TEXT, "best_of": 2}, "'text' gives none"),
        ({"method": "scripted", "best_of": 2}, "draws nothing to choose from"),
        ({"best_of": 0}, "--best-of: expected 1 or more, found 0"),
    ],
)
def test_a_choice_without_a_goal_or_without_draws_is_refused(table, tmp_path, changes, reason):
    with pytest.raises(UsageError, match=reason):
        request(table, tmp_path, **changes)


def test_the_only_condition_of_a_method_is_refused_too_if_it_gives_no_goal(table, tmp_path, install):
    source = adapter_source().replace("{Condition.NONE, Condition.GOAL_LOCATION}", "{Condition.NONE}")
    install("made", source)
    with pytest.raises(UsageError, match="'none' gives none"):
        run_method(request(table, tmp_path / "out", condition=None, best_of=2))
    assert not (tmp_path / "out").exists()


def test_a_leaderboard_marks_the_row_and_ranks_it_nowhere(table, tmp_path, install):
    install("made", adapter_source())
    for best_of in (1, 3):
        run_method(request(table, tmp_path / f"runs/best-{best_of}", best_of=best_of))
    board = make_leaderboard(collect_runs([tmp_path / "runs"]))
    plain, best = board.tables[0].rows
    assert (plain.variant, best.variant) == ("", "best of 3")
    assert (plain.entry.mark, best.ranks) == ("", {})
    text = export(board, "md")
    assert "| made § | best of 3; unverified |" in text
    assert "- made § best of 3 motions, chosen by their own head ray and wrist; never ranked." in text
    assert "§ best of 3 motions" in export(board, "csv")
    assert '"best_of": 3' in export(board, "json")


def test_tables_of_the_study_and_comparisons_mark_it_in_every_format(table, tmp_path, install, capsys):
    install("made", adapter_source())
    runs = [str(tmp_path / f"runs/best-{best_of}") for best_of in (1, 3)]
    for best_of, run in zip((1, 3), runs, strict=True):
        run_method(request(table, run, best_of=best_of))
    files = [tmp_path / f"t.{kind}" for kind in ("tex", "csv", "md")]
    data = ["--data", str(table.folder)]
    assert main(["study", "table-2", *runs, *data, "--with-published", "--out", *map(str, files)]) == 0
    tex, numbers, text = (file.read_text(encoding="utf-8") for file in files)
    for shown in (tex, numbers, text):
        assert "best of 3 motions, chosen by their own head ray and wrist; never ranked" in shown
    assert r"made (best of 3) (\S{}) &" in tex
    assert "(best of 3) (§)" in text
    capsys.readouterr()
    assert main(["leaderboard", "compare", *runs, *data]) == 0
    assert "best-3, synthetic-adt: § best of 3 motions" in capsys.readouterr().out
