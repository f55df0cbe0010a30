"""Every fault is named, alone; correct motions are left in peace."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from prbench.checking.doctor import Diagnosis, Expected, diagnose
from prbench.representation import canonicalise
from tests.checking.doctor.conftest import known
from tests.checking.doctor.faults import RATES, SPACE, TIME, WALKING, Fault, axes, scaled, swapped, turned
from tests.fakes import smooth_motion


def certain(motions: Sequence[np.ndarray], expected: Sequence[Expected] | None = None) -> list[str]:
    """Kinds of what is wrong for sure."""
    return [each.kind for each in diagnose(motions, expected, fps=20.0) if each.certain]


def changed(fault: Fault, motions: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.asarray(fault.change(motion), dtype=np.float64) for motion in motions]


def _still(motion: np.ndarray) -> np.ndarray:
    return np.repeat(motion[:1], len(motion), axis=0)


def _one_moves(motion: np.ndarray) -> np.ndarray:
    still = _still(motion)
    still[:, 20] = motion[:, 20]
    return still


ODD = {
    "one that stands still": _still,
    "one joint that moves": _one_moves,
    "the last frame that moves": lambda motion: np.concatenate([_still(motion)[1:], motion[-1:]]),
    "zeros": np.zeros_like,
    "a constant": lambda motion: np.full_like(motion, 3.0),
    "NaN": lambda motion: np.full_like(motion, np.nan),
    "one frame": lambda motion: motion[:1],
    "two frames": lambda motion: motion[:2],
    "no frames": lambda motion: motion[:0],
    "two still frames": lambda motion: _still(motion)[:2],
    "millimetres that stand still": lambda motion: _still(motion) * 1000,
    "the largest numbers": lambda motion: np.full_like(motion, 1.7e308),
    "numbers whose squares overflow": lambda motion: motion * 1e160,
    "numbers whose squares vanish": lambda motion: motion * 1e-200,
    "one number": lambda motion: motion[0, 0, 0],
    "a row": lambda motion: motion[:, 0, 0],
    "features of zeros": lambda motion: np.zeros((len(motion), 263)),
    "exchanged axes": lambda motion: motion.transpose(0, 2, 1),
    "23 joints": lambda motion: np.concatenate([motion, motion[:, :1]], axis=1),
    "whole numbers": lambda motion: motion.astype(int),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("odd", ODD.values(), ids=list(ODD))
def test_no_array_ends_in_a_traceback_or_a_warning(odd, everybody: list[np.ndarray]) -> None:
    motions = everybody[:3]
    given = [known(motion) for motion in motions]
    standing = [Expected(motion[0], motion[0], len(motion), 20.0) for motion in motions]
    changed = [np.array(odd(motion.copy())) for motion in motions]
    mixed = [changed[0], motions[1], changed[2]]
    for expected in (None, given, standing):
        for rows in (changed, mixed, changed[:1]):
            diagnose(rows, None if expected is None else expected[: len(rows)], fps=20.0)


def test_numbers_that_no_measure_holds_are_told() -> None:
    (found,) = diagnose([np.full((9, 22, 3), 1e300)], None, fps=20.0)
    assert found.certain
    assert "9 frames of the motion hold NaN, infinity or numbers beyond 1e+12" in found.evidence


# correct motions


def test_correct_motions_of_every_preset_have_no_fault(crowds: dict[str, list[np.ndarray]]) -> None:
    for motions in crowds.values():
        assert diagnose(motions, None, fps=20.0) == ()
        assert diagnose(motions, [known(motion) for motion in motions], fps=20.0) == ()


def test_no_single_correct_motion_has_a_certain_fault(everybody: list[np.ndarray]) -> None:
    assert len(everybody) >= 40
    assert [kinds for motion in everybody if (kinds := certain([motion]))] == []


def test_stick_figures_have_no_certain_fault() -> None:
    fakes = [canonicalise(smooth_motion(str(number), 60 + number)).astype(np.float64) for number in range(12)]
    assert certain(fakes) == []
    assert [kinds for motion in fakes if (kinds := certain([motion]))] == []


def test_recorded_motions_have_no_certain_fault(samples: Path) -> None:
    paths = sorted((samples / "humanml3d" / "golden").glob("*.npz"))
    for path in paths:
        with np.load(path) as golden:
            assert certain([golden["canonical"].astype(np.float64)]) == [], path.name


def test_a_pose_that_is_held_wherever_it_stands_is_only_suspicious(everybody: list[np.ndarray]) -> None:
    pose = turned(everybody[0][:1], 170) + np.array([0.9, 0, 0])
    found = diagnose([np.repeat(pose, 60, axis=0)] * 3, None, fps=20.0)
    assert {each.kind for each in found} == {"facing", "position"}
    assert not any(each.certain for each in found)


# single faults, each named and named alone


@pytest.mark.parametrize("fault", SPACE, ids=lambda fault: fault.name)
def test_a_fault_of_space_is_named_alone(fault: Fault, crowds: dict[str, list[np.ndarray]]) -> None:
    for motions in (crowds["adt"][:3], crowds["hot3d"][:3], crowds["gimo"][:1]):
        found = certain(changed(fault, motions))
        assert len(found) == 1
        assert found[0] in fault.kinds


@pytest.mark.parametrize("fault", WALKING, ids=lambda fault: fault.name)
def test_a_lost_root_is_named_where_people_walk(fault: Fault, walkers: list[np.ndarray]) -> None:
    assert len(walkers) >= 3
    assert tuple(certain(changed(fault, walkers))) == fault.kinds


@pytest.mark.parametrize("fault", TIME, ids=lambda fault: fault.name)
def test_a_stumbling_clock_is_named_alone(fault: Fault, crowds: dict[str, list[np.ndarray]]) -> None:
    for preset in ("adt", "gimo", "mogaze"):
        motions = crowds[preset]
        if fault.name.startswith("begins"):
            motions = [motion for motion in motions if _starts_in_full_speed(fault, motion)]
            assert len(motions) >= 3, preset
        if fault.name.startswith("end"):  # who stands when the motion freezes has no speed to lose
            motions = [motion for motion in motions if _largest_speed(motion[len(motion) // 2 : -6]) > 0.25]
            assert len(motions) >= 3, preset
        assert certain(changed(fault, motions)) == ["clock"], preset


def _largest_speed(motion: np.ndarray) -> float:
    """Return the largest speed of the joints' mean, m/s, at 20 frames a second."""
    return 20 * float(np.linalg.norm(np.diff(motion, axis=0), axis=-1).mean(axis=-1).max())


def _starts_in_full_speed(fault: Fault, motion: np.ndarray) -> bool:
    """Whether there is a speed to start at: who stands and moves a hand only never has it."""
    late = np.asarray(fault.change(motion), dtype=np.float64)
    return float(np.linalg.norm(np.diff(late[:12], axis=0), axis=-1).mean(axis=1).max() * 20) > 0.2  # m/s


@pytest.mark.parametrize("fault", RATES[:3], ids=lambda fault: fault.name)
def test_a_wrong_rate_is_certain_from_the_lengths(fault: Fault, crowds: dict[str, list[np.ndarray]]) -> None:
    motions = crowds["adt"][:4]
    assert certain(changed(fault, motions), [known(motion) for motion in motions]) == ["frame-rate"]


def test_a_wrong_rate_of_the_right_length_is_certain_from_the_initial_velocity(walkers: list[np.ndarray]) -> None:
    starting = [canonicalise(motion[_fastest(motion) :]) for motion in walkers]
    assert len(starting) >= 5
    expected = [known(motion) for motion in starting]
    assert certain(starting, expected) == []
    assert certain(changed(RATES[3], starting), expected) == ["frame-rate"]


def _fastest(motion: np.ndarray) -> int:
    return int(np.linalg.norm(np.diff(motion[:45], axis=0), axis=-1).mean(axis=1).argmax())


# faults together, and what tells similar faults apart


def test_millimetres_with_z_up_are_two_faults(crowds: dict[str, list[np.ndarray]]) -> None:
    z_up = axes((0, 2, 1), (1, -1, 1))
    for motions in crowds.values():
        assert certain([scaled(1000)(z_up(motion)) for motion in motions]) == ["unit", "up-axis"]


def test_five_faults_at_once_are_all_named_in_the_order_of_repair(crowds: dict[str, list[np.ndarray]]) -> None:
    z_up, feet = axes((0, 2, 1), (1, -1, 1)), swapped("ankle")

    def spoilt(motion: np.ndarray) -> np.ndarray:
        return scaled(100)(z_up(turned(feet(motion), 120) + np.array([2.0, 0.3, 0.0]))).reshape(len(motion), 66)

    found = certain([spoilt(motion) for motion in crowds["adt"]])
    assert found[:4] == ["shape", "unit", "joint-order", "up-axis"]
    assert found[-1] == "floor"


@pytest.mark.parametrize("preset", ["adt", "gimo", "hot3d"])
def test_a_mirror_and_exchanged_names_are_told_apart_by_the_initial_pose(
    preset: str, crowds: dict[str, list[np.ndarray]]
) -> None:
    motions = crowds[preset]
    expected = [known(motion) for motion in motions]
    mirror, names = (
        next(each for each in SPACE if each.name.startswith(start)) for start in ("x neg", "left and right exch")
    )
    assert certain(changed(mirror, motions), expected) == ["mirrored"]
    assert certain(changed(names, motions), expected) == ["left-right"]


def test_a_wrong_body_size_shows_against_the_initial_pose(everybody: list[np.ndarray]) -> None:
    motions, expected = everybody[:6], [known(motion) for motion in everybody[:6]]
    assert certain([motion * 0.8 for motion in motions], expected) == ["unit"]
    assert certain([motion * 0.8 for motion in motions]) == []  # a smaller person


def test_standardised_joints_are_no_positions(everybody: list[np.ndarray]) -> None:
    frames = np.concatenate(everybody)
    mean, spread = frames.mean(axis=0), frames.std(axis=0)
    assert certain([(motion - mean) / spread for motion in everybody[:8]]) == ["standardised"]
    assert certain([np.diff(motion, axis=0) for motion in everybody[:8]]) == ["standardised"]


def test_features_that_are_still_standardised_say_so(everybody: list[np.ndarray]) -> None:
    from prbench.representation import encode

    features = [encode(motion) for motion in everybody[:6]]
    rows = np.concatenate(features)
    (found,) = diagnose([(each - rows.mean(axis=0)) / rows.std(axis=0).clip(1e-3) for each in features], None, fps=20.0)
    assert found.kind == "features"
    assert "still standardised" in found.cause


@pytest.mark.parametrize("name", ["smplx-55", "coco-17", "openpose-25", "ntu-25", "h36m-17"])
def test_another_number_of_joints_is_never_called_right(name: str, everybody: list[np.ndarray]) -> None:
    from prbench.representation.converters import JOINT_MAPS

    joints = JOINT_MAPS[name].source_joints
    from_22 = {"nose": "head", "thorax": "spine3", "spine": "spine2", "hip": "pelvis", "mid_hip": "pelvis"}
    from_22 |= {"spine_base": "pelvis", "spine_mid": "spine2", "spine_shoulder": "spine3"}
    from prbench.geometry.skeleton import Joint

    def place(joint: str) -> int:
        known_as = from_22.get(joint, joint).upper()
        if known_as in Joint.__members__:
            return Joint[known_as]
        side = "LEFT" if "left" in joint else "RIGHT"
        if any(word in joint for word in ("hand", "thumb", "tip")):
            return Joint[f"{side}_WRIST"]
        return Joint[f"{side}_FOOT"] if any(word in joint for word in ("toe", "heel", "foot")) else Joint.HEAD

    index = [place(joint) for joint in joints]
    found = diagnose([motion[:, index] for motion in everybody[:3]], None, fps=20.0)
    assert found[0].kind == "joint-order"
    assert found[0].certain
    if name != "smplx-55":
        assert f"'{name}'" in found[0].cause


def test_lengths_one_short_point_at_the_features(everybody: list[np.ndarray]) -> None:
    motions = everybody[:4]
    (found,) = diagnose([motion[:-1] for motion in motions], [known(motion) for motion in motions], fps=20.0)
    assert (found.kind, found.certain) == ("length", True)
    assert "263 features" in found.cause


def test_a_fixed_window_is_a_wrong_length(everybody: list[np.ndarray]) -> None:
    motions = [motion[: 60 + 5 * row] for row, motion in enumerate(everybody[:5])]
    window = [motion[:60] for motion in motions]
    (found,) = diagnose(window[1:], [known(motion) for motion in motions[1:]], fps=20.0)
    assert found.kind == "length"
    assert "fixed window" in found.cause


# the answer


def test_every_diagnosis_has_numbers_a_cause_and_a_remedy(crowds: dict[str, list[np.ndarray]]) -> None:
    for fault in (*SPACE, *TIME):
        for found in diagnose(changed(fault, crowds["adt"][:1]), None, fps=20.0):
            assert isinstance(found, Diagnosis)
            assert isinstance(found.certain, bool)
            assert any(character.isdigit() for character in found.evidence)
            assert found.cause
            assert found.remedy.endswith((".", ")"))


def test_expectations_have_to_be_one_a_motion(everybody: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="2 motions, but expectations of 1"):
        diagnose(everybody[:2], [Expected()], fps=20.0)
    assert diagnose([], None, fps=20.0) == ()
