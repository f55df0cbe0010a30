"""``prbench analyse people``: figures of motions that are made by hand, and the command on acted people and tables."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prbench.cli import main
from prbench.geometry.skeleton import Joint
from prbench.synthetic.people.kinematics import minimum_jerk
from prbench_benchmarks.prime_and_reach.people import Observed, figures, measured
from tests.cli.reports import reported
from tests.fakes import STANDING, fake_dataset

FPS = 100.0
TIME = np.arange(300) / FPS
PAGE = Path(__file__).parents[3] / "docs" / "specification" / "people.md"


def towards(degrees: np.ndarray) -> np.ndarray:
    """Directions at angles about the vertical."""
    angle = np.deg2rad(degrees)
    return np.stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)], axis=-1)


def person(**changes: Any) -> Observed:
    still: dict[str, Any] = {"joints": np.repeat(STANDING[None], len(TIME), axis=0), "head": towards(0 * TIME)}
    return Observed(**({"fps": FPS, **still, "gaze": still["head"]} | changes))


def one(found: dict[str, list[float]], name: str) -> float:
    (value,) = found[name]
    return value


def test_a_gaze_shift_has_the_head_s_share_lag_and_peak_speed() -> None:
    gaze = towards(np.interp(TIME, [1.0, 1.1], [0, 40]))
    head = towards(30 * minimum_jerk((TIME - 1.05) / 0.4))
    found = measured([person(gaze=gaze, head=head)])
    assert one(found, "head_share_30") == pytest.approx(30 / 40, abs=0.02)
    assert one(found, "head_lag") == pytest.approx(0.08, abs=0.02)  # 20 deg/s come later than the first motion
    assert one(found, "head_speed_20") == pytest.approx(30 * 1.875 / 0.4, rel=0.02)
    assert not found["head_share_15"]


def test_lost_gaze_costs_its_own_shift_only() -> None:
    gaze = towards(np.interp(TIME, [0.5, 0.6, 1.5, 1.6], [0, 40, 40, 0]))
    gaze[55:130] = np.nan
    assert len(measured([person(gaze=gaze)])["head_share_30"]) == 1


def test_a_reach_has_peak_shape_bend_and_the_look_before_it() -> None:
    joints = person().joints.copy()
    joints[:, Joint.RIGHT_WRIST, 2] += 0.3 * minimum_jerk((TIME - 2.0) / 0.6)
    goal = joints[-1, Joint.RIGHT_WRIST]
    to_goal = goal - STANDING[Joint.HEAD]
    looks = np.where(TIME[:, None] < 1.5, [0.0, 1.0, 0.0], to_goal / np.linalg.norm(to_goal))
    found = measured([person(joints=joints, gaze=looks, reaches=((265, Joint.RIGHT_WRIST, goal),))])
    assert one(found, "wrist_speed_20") == pytest.approx(0.3 * 1.875 / 0.6, rel=0.02)
    assert one(found, "wrist_peak") == pytest.approx(0.5, abs=0.02)
    assert 1.6 < one(found, "wrist_ratio") < 1.875  # without the slow ends
    assert one(found, "wrist_slow") == pytest.approx(0.88, abs=0.02)
    assert one(found, "gaze_lead") == pytest.approx(0.55, abs=0.04)
    upright = STANDING[Joint.NECK] - STANDING[Joint.PELVIS]
    tilt = np.rad2deg(np.arctan2(np.hypot(upright[0], upright[2]), upright[1]))
    assert one(found, "bend_table") == pytest.approx(tilt)


def test_steps_have_length_cadence_swing_and_clearance() -> None:
    joints = person().joints.copy()
    for first, (ankle, toe) in enumerate(([Joint.LEFT_ANKLE, Joint.LEFT_FOOT], [Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT])):
        for start in np.arange(0.2 + 0.6 * first, 2.4, 1.2):  # a step of 0.6 m each 0.6 s, the foot 0.4 s in the air
            part = np.clip((TIME - start) / 0.4, 0, 1)
            joints[:, [ankle, toe], 2] += 1.2 * part[:, None]
            joints[:, toe, 1] += 0.02 * (np.abs(part - 0.5) < 0.5)
    joints[:, [Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT], 2] += 0.6
    joints[:, Joint.PELVIS, 2] += np.clip(TIME - 0.3, 0, 2)
    found = measured([person(joints=joints)])
    assert found["step_usual"] == pytest.approx([0.6] * len(found["step_usual"]), abs=0.02)
    assert len(found["step_usual"]) >= 2
    assert np.median(found["cadence_usual"]) == pytest.approx(100, abs=1)
    assert np.median(found["walk_ratio_usual"]) == pytest.approx(6, abs=0.1)
    assert np.median(found["swing_time"]) == pytest.approx(0.4, abs=0.02)
    assert np.median(found["clearance"]) == pytest.approx(2, abs=0.01)
    assert one(found, "walk_speed_2") == pytest.approx(1, abs=0.02)


def test_a_turn_of_the_body_has_its_peak_speed() -> None:
    angle = np.deg2rad(60 * minimum_jerk(TIME - 1))
    x, y, z = person().joints.transpose(2, 0, 1)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    joints = np.stack([x * cos + z * sin, y, z * cos - x * sin], axis=-1)
    assert one(measured([person(joints=joints)]), "body_speed") == pytest.approx(60 * 1.875, rel=0.02)


def test_acted_people_and_tables_stand_beside_published_figures(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (table,) = reported(["analyse", "people", "--seed", "3", "--count", "1"], capsys).tables
    rows = {row.text["figure"]: row for row in table.blocks[0].rows}
    assert list(rows) == [f"{figure.title} ({figure.unit})" for figure in figures().values()]
    assert {column.key for column in table.columns} >= {f"synthetic-{name}" for name in ("adt", "gimo", "hot3d")}
    walks = rows["Pelvis' peak speed, walks of 1 m and more (m/s)"]
    (speed,) = [cell for cell in walks.cells if cell.dataset == "synthetic-gimo"]
    assert 0.3 < speed.value < 1.46
    assert (speed.mark, "outside" in speed.note) == ("", False)
    for cell in itertools.chain.from_iterable(row.cells for row in rows.values()):
        assert (cell.mark == "!") == ("outside" in cell.note)
    fake_dataset(tmp_path / "table")
    assert main(["analyse", "people", str(tmp_path / "table")]) == 0
    assert "People beside published figures" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["causes"], "name one RUN"),
        (["causes", "x", "--count", "2"], "takes no --count"),
        (["people", "nowhere"], "expected a built dataset"),
    ],
)
def test_what_does_not_fit_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture) -> None:
    assert main(["analyse", *words]) in (2, 4)
    assert said in capsys.readouterr().err


def test_the_page_states_the_intervals_of_the_command() -> None:
    rows = re.findall(r"^\| ([^|]+ \([^|]+\)) \| ([^|]+) \|", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    known = {f"{figure.title} ({figure.unit})": figure for figure in figures().values()}
    assert len(rows) > 15
    for name, interval in rows:
        low, _, high = interval.rpartition("to ")
        assert (float(low or -np.inf), float(high)) == (known[name].low, known[name].high)
