"""Numbers that pass every check of shapes and are no person: exchanged sides, wrong units, wrong order."""

from __future__ import annotations

import re

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.representation.converters import check_limbs, check_sides, front_of_legs, to_canonical
from prbench.representation.encoding import MIRRORED_JOINTS
from tests.fakes import STANDING
from tests.representation.converters.bodies import person
from tests.representation.motions import golden, turned


def standing() -> np.ndarray:
    """The person at a place of work, whose feet, knees, hips and shoulders face one way."""
    return person(start=600)


def test_a_person_in_order_points_to_the_front_and_is_let_through() -> None:
    # Feet and shoulders of who walks do not turn into the way at the same time.
    for joints, least in ((standing(), 0.95), (person(), 0.8)):
        for feet in (True, False):
            front = front_of_legs(joints, feet=feet)
            assert front is not None
            assert front > least
        check_sides(joints)
        check_limbs(joints)


@pytest.mark.parametrize("feet", [True, False])
def test_exchanged_sides_are_named(feet) -> None:
    with pytest.raises(InputFileError, match=r"left and right.*mean cosine of -0\.9.*left_handed=True"):
        check_sides(standing()[:, MIRRORED_JOINTS], feet=feet)


def test_a_left_handed_world_is_named_and_left_handed_repairs_it() -> None:
    unity = person() * np.array([1, 1, -1], dtype=np.float32)
    with pytest.raises(InputFileError, match="left and right"):
        to_canonical(unity, 20.0)
    assert np.allclose(to_canonical(unity, 20.0, left_handed=True), person(), atol=1e-5)


def test_the_front_does_not_depend_on_the_heading() -> None:
    for yaw in (0.5, 2.0, -2.9):
        assert front_of_legs(turned(person(), yaw)) == pytest.approx(front_of_legs(person()), abs=1e-6)


def test_straight_legs_without_feet_say_nothing() -> None:
    straight = STANDING.copy()
    for knee, hip, ankle in ((4, 1, 7), (5, 2, 8)):
        straight[knee] = (straight[hip] + straight[ankle]) / 2
    assert front_of_legs(straight[None], feet=False) is None
    check_sides(straight[None], feet=False)


@pytest.mark.parametrize(("factor", "unit"), [(100.0, "cm"), (1000.0, "mm"), (1 / 0.0254, "inch")])
def test_another_unit_is_named(factor, unit) -> None:
    with pytest.raises(InputFileError, match=f"This looks like {unit}: say unit='{unit}'"):
        to_canonical(person() * np.float32(factor), 20.0)


def test_normalised_bodies_are_told_the_factor() -> None:
    normalised = person() / np.float32(10.0)
    with pytest.raises(InputFileError, match=r"unit=[\d.]+ \(metres a unit\) makes them adults") as refusal:
        check_limbs(normalised)
    told = re.search(r"unit=([\d.]+)", str(refusal.value))
    assert told is not None
    adult = normalised * float(told[1])
    check_limbs(adult)
    # People differ in size; thighs, shins and arms of the median adult are 33 cm long.
    ends = [Joint[f"{side}_{end}"] for side in ("LEFT", "RIGHT") for end in ("KNEE", "ANKLE", "ELBOW", "WRIST")]
    lengths = [np.linalg.norm(adult[:, end] - adult[:, PARENTS[end]], axis=-1).mean() for end in ends]
    assert np.median(lengths) == pytest.approx(0.33, rel=0.01)


def test_another_order_of_joints_is_named() -> None:
    chains = [0, 2, 5, 8, 11, 1, 4, 7, 10, 3, 6, 9, 12, 15, 14, 17, 19, 21, 13, 16, 18, 20]
    with pytest.raises(InputFileError, match="The order of the joints is another one"):
        check_limbs(person()[:, chains])


def test_a_missing_position_is_named_and_not_taken_for_another_unit() -> None:
    holed = person().copy()
    holed[3, 20] = np.nan
    with pytest.raises(InputFileError, match="frame 3, left_wrist: expected a finite position"):
        to_canonical(holed, 20.0)
    with pytest.raises(InputFileError, match="one frame or more"):
        to_canonical(person()[:0], 20.0)


def test_joints_that_lie_on_one_another_are_no_body() -> None:
    with pytest.raises(InputFileError, match="joints that lie on one another"):
        to_canonical(np.zeros((5, 22, 3), dtype=np.float32), 20.0)


def test_a_child_is_a_person(samples) -> None:
    check_limbs(golden(samples, "child")["joints_in"])
