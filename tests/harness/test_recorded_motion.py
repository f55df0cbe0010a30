"""Recorded motion handed in as a method's own is noticed however it was disguised, and nothing else is taken for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace

from prbench.geometry.skeleton import BONES, Joint
from prbench.harness.controls import at_length
from prbench.harness.methods.motions import native_frames
from prbench.harness.planning import select
from prbench.harness.recorded_motion import is_recorded_motion, length_problem, likely_cause
from prbench.harness.run import run_method
from prbench.harness.run_folder import DatasetSummary, read_scores
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.metrics import MotionBatch
from prbench.randomness import named_generator
from prbench.representation.encoding import MIRRORED_JOINTS
from prbench.sequences import SequenceTable
from tests.fakes import STANDING, fake_sequence
from tests.harness.run_folder.test_record import SUMMARY
from tests.harness.test_run import request
from tests.harness.test_score_predictions import write


@pytest.fixture(scope="module")
def table_of_people(tmp_path_factory) -> SequenceTable:
    """A few synthetic people, who walk and reach as recorded ones do."""
    folder = tmp_path_factory.mktemp("people") / "table"
    build_synthetic_table("adt", recordings=4, seed=0, out=folder, n_events=4)
    return SequenceTable.open(folder)


@pytest.fixture(scope="module")
def people(table_of_people) -> list[np.ndarray]:
    (chunk,) = table_of_people.chunks(columns=["joints"])
    return [motion.astype(np.float64) for motion in np.split(chunk.joints, chunk.offsets[1:-1])]


def joined(motions: Sequence[np.ndarray]) -> MotionBatch:
    return MotionBatch.from_motions([motion.astype(np.float32) for motion in motions])


def marks(people: list[np.ndarray], change) -> np.ndarray:
    return is_recorded_motion(joined([change(motion) for motion in people]), joined(people))


def at_times(motion: np.ndarray, times: np.ndarray) -> np.ndarray:
    left = np.minimum(times.astype(int), len(motion) - 2)
    share = (times - left)[:, None, None]
    return motion[left] * (1 - share) + motion[left + 1] * share


def noisy(motion: np.ndarray, metres: float) -> np.ndarray:
    return motion + named_generator("noise").normal(size=motion.shape) * metres


def turned(motion: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(0.7), np.sin(0.7)
    return motion @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])


ARMS = [Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW, Joint.LEFT_WRIST, Joint.RIGHT_WRIST]
LEGS = [Joint.LEFT_KNEE, Joint.RIGHT_KNEE, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, Joint.LEFT_FOOT, Joint.RIGHT_FOOT]


def with_other(motion: np.ndarray, joints: list[Joint]) -> np.ndarray:
    """The motion with some joints led up to 30 cm elsewhere."""
    changed = motion.copy()
    changed[:, joints] += np.linspace(0, 1, len(motion))[:, None, None] * [0.1, 0.3, 0.0]
    return changed


def mirrored(motion: np.ndarray) -> np.ndarray:
    return motion[:, list(MIRRORED_JOINTS)] * np.array([-1.0, 1.0, 1.0])


def elsewhere(motion: np.ndarray) -> np.ndarray:
    """The postures of a motion, led along another way and turned ever further."""
    share = np.linspace(0, 1, len(motion))[:, None]
    x, y, z = np.moveaxis(motion - motion[:, :1], -1, 0)
    cosine, sine = np.cos(share), np.sin(share)
    return np.stack([x * cosine + z * sine + share, y + 0.9, z * cosine - x * sine - share], axis=-1)


def with_long_arms(motion: np.ndarray) -> np.ndarray:
    longer = motion.copy()
    for parent, child in BONES:
        length = 2.0 if child in ARMS else 1.0
        longer[:, child] = longer[:, parent] + length * (motion[:, child] - motion[:, parent])
    return longer


def swaying(motion: np.ndarray) -> np.ndarray:
    """The motion, leaning by 3 cm at 1.5 m of height, slowly."""
    time = np.arange(len(motion)) / 20
    sway = 0.02 * np.stack([np.sin(2.7 * time), 0 * time, np.cos(2.0 * time)], axis=1)
    return motion + sway[:, None] * motion[..., 1:2]


DISGUISES = {
    "same": lambda m: m,
    "noise": lambda m: noisy(m, 0.003),
    "offset": lambda m: m + np.array([0.3, 0.0, -0.1]),
    "turn": turned,
    "half rate": lambda m: at_times(at_times(m, np.linspace(0, len(m) - 1, 45)), np.linspace(0, 44, len(m))),
    "other length": lambda m: at_times(m, np.linspace(0, len(m) - 1, 60)),
    "time warp": lambda m: at_times(m, (len(m) - 1) * np.linspace(0, 1, len(m)) ** 1.3),
    "slow, then fast": lambda m: at_times(
        m, (len(m) - 1) * np.interp(np.linspace(0, 1, len(m)), [0, 0.6, 1], [0, 0.3, 1])
    ),
    "backwards": lambda m: m[::-1],
    "delay": lambda m: np.concatenate([m[:1], m[:1], m[:-2]]),
    "all together": lambda m: noisy(np.concatenate([m[:1], m[:-1]]), 0.003) + 0.05,
    "half the size": lambda m: 0.5 * m,
    "long arms": with_long_arms,
    "other arms": lambda m: with_other(m, ARMS),
    "other legs": lambda m: with_other(m, LEGS),
    "elsewhere": elsewhere,
    "mirrored": mirrored,
    "mirrored elsewhere, late": lambda m: elsewhere(mirrored(np.concatenate([m[:1], m[:-1]]))),
    "slow sway": swaying,
}


@pytest.mark.parametrize("disguise", DISGUISES.values(), ids=DISGUISES)
def test_the_recorded_motion_is_noticed_however_it_is_disguised(disguise, people):
    assert marks(people, disguise).all()


@pytest.mark.parametrize("disguise", [lambda m: m, mirrored, elsewhere, swaying])
@pytest.mark.parametrize(("metres", "share"), [(0.01, 0.75), (0.05, 0.2)])
def test_most_recorded_motions_are_noticed_under_noise_in_every_frame(metres, share, disguise, people):
    assert marks(people, lambda m: noisy(disguise(m), metres)).mean() > share


@pytest.mark.parametrize(
    "method",
    [
        lambda m: np.repeat(m[:1], len(m), axis=0),
        lambda m: m[:1] + np.linspace(0, 1, len(m))[:, None, None] * (m[-1:] - m[:1]),
        lambda m: m[:, :1] + (m[:1] - m[:1, :1]),
        lambda m: np.concatenate([m[:40], np.repeat(m[39:40], len(m) - 40, axis=0)]),
    ],
    ids=["initial pose", "straight to the last pose", "glides along the path", "cut short"],
)
@pytest.mark.parametrize("metres", [0, 0.05])
def test_what_conditions_tell_and_what_only_resembles_is_not_taken_for_it(method, metres, people):
    assert not marks(people, lambda m: noisy(method(m), metres)).any()


def test_other_recordings_are_not_taken_for_the_person(table_of_people, people):
    recordings = table_of_people.scalars(columns=["recording_id"])["recording_id"].to_numpy()
    for step in range(1, len(people)):
        others = np.roll(np.arange(len(people)), step)
        resized = [at_length(people[other], len(motion)) for other, motion in zip(others, people, strict=True)]
        # Tasks of one recording overlap: there, they are the recorded motion.
        assert not (is_recorded_motion(joined(resized), joined(people)) & (recordings != recordings[others])).any()


def test_where_hardly_anything_happens_nothing_is_claimed():
    still = MotionBatch.from_motions([noisy(np.repeat(STANDING[None], 60, axis=0), 1e-5).astype(np.float32)])
    assert not is_recorded_motion(still, still).any()


def hardly_moving(n_frames: int = 60) -> np.ndarray:
    """A person who settles by 5 cm in the first frames, stands, and leans to the side in the last ones."""
    motion = noisy(np.repeat(STANDING[None], n_frames, axis=0), 1e-4)
    motion[:3, 12:] += np.linspace(1, 0, 3)[:, None, None] * [0.0, 0.0, -0.05]
    motion[-3:, 12:] += np.linspace(0, 1, 3)[:, None, None] * [0.05, 0.0, 0.0]
    return motion


def test_a_body_that_stands_where_a_person_hardly_moves_is_not_taken_for_the_person():
    person = hardly_moving()
    recorded = MotionBatch.from_motions([person.astype(np.float32)] * 3)
    still = np.repeat(person[:1], len(person), axis=0)
    late = np.concatenate([still[:-3], person[-3:]])
    methods = MotionBatch.from_motions([motion.astype(np.float32) for motion in (still, noisy(still, 1e-4), late)])
    assert not is_recorded_motion(methods, recorded).any()
    assert is_recorded_motion(recorded, recorded).all()


@pytest.mark.parametrize(("found", "motions", "never_ranked"), [(1, 12, False), (2, 12, True), (2, 400, False)])
def test_one_motion_of_a_small_run_is_marked_and_does_not_keep_its_method_from_a_rank(found, motions, never_ranked):
    metric = replace(SUMMARY.metrics[0], flags={"recorded_motion": found})
    summary = replace(SUMMARY, sequences=motions, metrics=(metric,))
    assert summary.mark.startswith(f"†† equals the recorded motion in {found} of {motions} motions")
    assert summary.hands_in_recordings == never_ranked


def test_a_file_of_recorded_motions_is_marked_and_the_control_is_not(table, tmp_path):
    ids = select(table, split="test", limit=None).sequence_ids
    motions = {name: fake_sequence(int(name.split("/obj")[1].split("/")[0])).joints for name in ids}
    file = write(tmp_path / "mine.parquet", motions)
    (report,) = score_predictions(ScoreRequest(predictions=file, data=(table.folder,), out=tmp_path / "scores"))
    assert report.summary.recorded_motions == 15
    kept = DatasetSummary.read(tmp_path / "scores/synthetic-adt")
    assert kept.mark == "†† equals the recorded motion in 15 of 15 motions; never ranked"
    rows = read_scores(tmp_path / "scores/synthetic-adt/scores.parquet").to_pylist()
    flagged = {(row["metric"], row["flag"]) for row in rows if "recorded_motion" in (row["flag"] or "")}
    assert flagged == {("mpjpe", "recorded_motion")}
    for control in ("ground-truth", "ground-truth-resampled", "scripted", "static"):
        run = run_method(request(table, tmp_path / control, control))
        assert run.summaries[0].mark == ""


EXPECTED = np.array([81, 60, 120, 97])


def cause(found):
    return likely_cause(EXPECTED, np.asarray(found), fps=20.0)


@pytest.mark.parametrize("rate", [10.0, 12.5, 15.0, 24.0, 25.0, 30.0, 50.0, 60.0, 100.0, 120.0])
def test_lengths_of_another_usual_rate_are_recognised(rate):
    for round_off in (-1, 0):
        found = native_frames(EXPECTED, fps=20.0, native_fps=rate) + round_off
        assert f"motions at {rate:g} frames per second where 20 are asked for" in cause(found)
        assert f"--native-fps {rate:g}" in cause(found)


def test_motions_at_the_table_rate_where_another_was_asked_for_are_recognised():
    native = native_frames(EXPECTED, fps=20.0, native_fps=30.0)
    assert "motions at 20 frames per second where 30 are asked for" in likely_cause(native, EXPECTED, fps=30.0)


def test_one_frame_more_or_less_is_explained():
    assert "previous_joints" in cause(EXPECTED + 1)
    assert "initial one" in cause(EXPECTED - 1)
    assert "one frame too many" in cause(EXPECTED + np.array([0, 1, 0, 0]))


def test_what_fits_no_cause_is_not_explained():
    assert cause(EXPECTED + np.array([0, 7, 0, -3])) == ""
    assert likely_cause(np.array([100]), np.array([75]), fps=20.0) == "", "a single motion says nothing about a rate"


def test_the_first_motion_and_the_number_of_others_are_named():
    problem = length_problem("row {}".format, EXPECTED, EXPECTED + np.array([0, 5, 5, 0]), fps=20.0)
    assert problem == "row 1: expected 60 frames, found 65 (and 1 other motions of 4)."
    assert length_problem("row {}".format, EXPECTED, EXPECTED, fps=20.0) is None
