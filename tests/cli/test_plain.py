"""``prbench prime`` on files of one's own."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import prbench
from prbench.cli import main
from tests.cli.reports import refused, reported

TIMES = np.arange(0, 12, 1 / 30)
EYE = np.array([0.0, 1.6, 0.0])
CUP = np.array([0.3, 0.9, 1.0])
TRAY = np.array([-0.5, 0.9, 1.2])
BOX = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")


def box(centre: np.ndarray) -> dict[str, float]:
    return dict(zip(BOX, [*(centre - 0.05), *(centre + 0.05)], strict=True))


@pytest.fixture
def files(tmp_path):
    direction = np.tile([0.0, 0.0, -1.0], (len(TIMES), 1))
    for place, start in ((CUP, 4.0), (TRAY, 7.0)):
        rows = (start - 1e-9 <= TIMES) & (start + 0.5 > TIMES)
        direction[rows] = (place - EYE) / np.linalg.norm(place - EYE)
    gaze = {"time": TIMES, **dict(zip(("dx", "dy", "dz"), direction.T)), "ox": 0.0, "oy": 1.6, "oz": 0.0}
    pd.DataFrame(gaze).to_csv(tmp_path / "gaze.csv", index=False)
    objects = [{"object_id": "1", "name": "cup", **box(CUP)}, {"object_id": "2", "name": "tray", **box(TRAY)}]
    pd.DataFrame(objects).to_csv(tmp_path / "objects.csv", index=False)
    events = {"time": [6.0, 9.0, 3.0], "action": ["pick", "put", "pick"], "object": ["cup", "tray", "cup"]}
    pd.DataFrame(events).to_csv(tmp_path / "events.csv", index=False)
    return tmp_path


def words(folder, *names: str) -> list[str]:
    return ["prime", *(word for name in names for word in (f"--{name}", str(folder / f"{name}.csv")))]


def test_events_are_primed_by_the_boxes_of_their_objects(files, capsys) -> None:
    out = files / "looks.png"
    report = reported([*words(files, "gaze", "objects", "events"), "--picture", str(out)], capsys)
    told = [(event.object_name, event.outcome, event.prime_time, event.prime_kind) for event in report]
    primed = [("cup", "primed", pytest.approx(4.0), "hit"), ("tray", "primed", pytest.approx(7.0), "hit")]
    assert told == [*primed, ("cup", "not_primed", None, None)]  # in the order of the file
    assert out.read_bytes().startswith(b"\x89PNG")
    gaze = pd.read_csv(files / "gaze.csv")
    rays = (gaze.time, gaze[["ox", "oy", "oz"]], gaze[["dx", "dy", "dz"]])
    same = prbench.prime(*rays, [[event.box_min, event.box_max] for event in report], [6.0, 9.0, 3.0])
    assert [event.prime_time for event in same] == [event.prime_time for event in report]
    assert main(words(files, "gaze", "objects", "events")) == 0
    assert "not_primed" in capsys.readouterr().out


def test_a_moving_object_is_where_it_rests_at_the_event(files, capsys) -> None:
    places = np.where(TIMES[:, None] < 6.3, CUP, TRAY)
    moved = {"time": TIMES, "object_id": 1, **dict(zip("xyz", places.T))}
    pd.DataFrame(moved).to_csv(files / "object-poses.csv", index=False)
    pd.DataFrame([{"object_id": "1", "name": "cup", **box(np.zeros(3))}]).to_csv(files / "objects.csv", index=False)
    events = {"time": [6.0, 9.0], "action": ["pick", "put"], "object": ["cup", "cup"]}
    pd.DataFrame(events).to_csv(files / "events.csv", index=False)
    report = reported(words(files, "gaze", "objects", "events", "object-poses"), capsys)
    assert [event.prime_time for event in report] == [pytest.approx(4.0), pytest.approx(7.0)]


def test_one_file_of_events_with_boxes_is_enough(files, capsys) -> None:
    rows = [{"time": 6000.0, "action": "pick", "object": "cup", **{key: 100 * v for key, v in box(CUP).items()}}]
    pd.DataFrame(rows).to_csv(files / "objects.csv", index=False)
    gaze = pd.read_csv(files / "gaze.csv")
    gaze["time"] *= 1000
    gaze[["ox", "oy", "oz"]] *= 100
    gaze.to_csv(files / "gaze.csv", index=False)
    units = ["--unit", "cm", "--time-unit", "ms"]
    (event,) = reported([*words(files, "gaze", "objects"), *units], capsys)
    assert (event.prime_time, event.prime_gap) == (pytest.approx(4.0), pytest.approx(2.0))
    (event,) = reported([*words(files, "gaze", "objects"), *units, "--window", "1"], capsys)
    assert event.outcome == "not_primed"


@pytest.mark.parametrize(
    ("file", "column", "value", "message"),
    [
        ("gaze", "dx", 3.0, "gaze.csv, line 4"),
        ("gaze", "time", -1.0, "gaze.csv, line 4"),
        ("objects", "min_y", "high", "objects.csv"),
        ("events", "object", "cupp", "events.csv, line 4"),
        ("events", "action", "smash", "events.csv, line 4"),
        ("events", "time", 900.0, "events.csv, line 4"),
    ],
)
def test_what_is_wrong_is_named_by_file_and_line(files, capsys, file, column, value, message) -> None:
    table = pd.read_csv(files / f"{file}.csv").astype({column: object})
    table.loc[min(2, len(table) - 1), column] = value
    table.to_csv(files / f"{file}.csv", index=False)
    refused(words(files, "gaze", "objects", "events"), capsys, code=3, message=message)


def test_missing_files_and_places_are_asked_for(files, capsys) -> None:
    refused(words(files, "gaze"), capsys, code=2, message="--events FILE is needed")
    refused(words(files, "gaze", "events"), capsys, code=3, message="a place: a point, a box, or an object with a box")
