"""Pictures of gaze over objects in time."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.cli import main
from prbench.curation.own_priming import PrimedEvent
from prbench.curation.priming import gaze_rays
from prbench.geometry.shapes import ray_distances
from prbench.readers import reader_for
from prbench.readers.own import format as own
from prbench.readers.own.write import write_recording
from prbench.recording import Video
from prbench.sequences import SequenceTable
from prbench.viewing.explain import explain_event
from prbench.viewing.looks import _spells, looks_around
from tests.cli.reports import reported
from tests.curation.scenes import LOOK_A, PICK, PLACE_A, PROTOCOL, scene, track
from tests.viewing.test_review import made

CORNERS = (tuple(PLACE_A - 0.05), tuple(PLACE_A + 0.05))
EVENT = PrimedEvent("cup", "pick", PICK, "primed", LOOK_A, "hit", PICK - LOOK_A, 0.03, 0.05, 1.0, *CORNERS)


def test_the_place_of_the_event_comes_first_and_things_that_gaze_never_met_are_left_out() -> None:
    recording = scene()
    looks = looks_around(gaze_rays(recording, "eye"), EVENT, recording.objects[1:], PROTOCOL.curation)
    assert list(looks.distances) == ["cup"]  # nobody looks at the table
    on_it = looks.times[looks.distances["cup"] == 0]
    assert (on_it.min(), on_it.max()) == (pytest.approx(LOOK_A), pytest.approx(LOOK_A + 0.5, abs=0.04))
    assert (looks.times.min(), looks.times.max()) == (pytest.approx(PICK - 11), pytest.approx(PICK + 1, abs=0.04))


def test_gaze_follows_an_object_that_turns_and_moves() -> None:
    times = np.arange(0, 30, 0.1)
    turn = Rotation.from_rotvec(times[:, None] * [0.0, 0.3, 0.0])
    centre = PLACE_A + (times - LOOK_A)[:, None] * [0.02, 0.0, 0.0]
    moving = dataclasses.replace(
        track(times, centre, name="ball", object_id="9"), rotation=turn.as_quat(scalar_first=True)
    )
    recording = scene()
    looks = looks_around(gaze_rays(recording, "eye"), EVENT, [moving], PROTOCOL.curation)
    rays = gaze_rays(recording, "eye")
    row = int(np.searchsorted(rays[0], LOOK_A + 0.2))
    # The same by hand: the ray of one sample, in the object's own frame.
    back = Rotation.from_rotvec([0.0, 0.3 * rays[0][row], 0.0]).inv()
    local = back.apply(rays[1][row] - PLACE_A - [0.02 * (rays[0][row] - LOOK_A), 0.0, 0.0]), back.apply(rays[2][row])
    (expected,) = ray_distances(local[0][None], local[1][None], moving.box_min[None], moving.box_max[None])[0]
    assert looks.distances["ball"][np.searchsorted(looks.times, rays[0][row])] == pytest.approx(expected, abs=1e-9)


def test_an_object_is_not_looked_at_while_it_is_not_tracked() -> None:
    times = np.arange(0, 30, 0.1)
    unseen = track(times, np.tile(PLACE_A, (len(times), 1)), name="ball", object_id="9")
    unseen = dataclasses.replace(unseen, valid=(times < LOOK_A + 0.2) | (times > LOOK_A + 1))
    looks = looks_around(gaze_rays(scene(), "eye"), EVENT, [unseen], PROTOCOL.curation)
    assert looks.times[looks.distances["ball"] == 0].max() == pytest.approx(LOOK_A + 0.2, abs=0.11)


def test_spells_end_where_samples_are_missing() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1, 2.2])
    state = np.array([False, True, True, True, True, False, True])
    assert np.allclose(_spells(times, state), [(0.1, 0.3), (2.0, 0.1), (2.2, 0.1)])
    assert _spells(np.zeros(0), np.zeros(0, dtype=bool)) == []


@pytest.mark.parametrize("dataset", ["adt", "hd-epic"])
def test_explain_draws_gaze_over_objects(dataset, tmp_path, capsys) -> None:
    place = made(dataset)
    events = SequenceTable.open(place / "table").events().to_pandas()
    event = events[events.prime_time.notna()].event_id.iloc[0]
    out = tmp_path / "looks.png"
    words = ["explain", event, "--data", str(place / "table")]
    assert main([*words, "--root", str(place / "raw"), "--picture", str(out)]) == 0
    assert "caption: Gaze over objects" in capsys.readouterr().out
    assert out.read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--picture", str(out)]) == 2
    assert "--root DIR belong together" in capsys.readouterr().err
    unplaced = events[events.location.isna()].event_id
    if len(unplaced):
        words = ["explain", unplaced.iloc[0], "--data", str(place / "table"), "--root", str(place / "raw")]
        assert main([*words, "--picture", str(out)]) == 2


def test_explain_tells_the_moment_in_the_video(capsys) -> None:
    place = made("hd-epic")
    events = SequenceTable.open(place / "table").events().to_pandas()
    primed = events[events.prime_time.notna()].iloc[0]
    listed = json.loads(next((place / "raw").rglob("assoc_info.json")).read_text())[primed.recording_id]
    segments = [track["time_segment"] for track in listed[primed.object_id]["tracks"]]
    told = reported(["explain", primed.event_id, "--data", str(place / "table")], capsys).video
    # The annotations count in seconds of the video, the table on the clock of the glasses.
    assert min(abs(told["event_time"] - end) for segment in segments for end in segment) < 0.04
    assert told["event_frame"] == pytest.approx(30 * told["event_time"], abs=0.51)
    assert told["event_time"] - told["prime_time"] == pytest.approx(primed.event_time - primed.prime_time, abs=0.07)
    assert f"(frame {told['event_frame']:.0f})" in explain_event(place / "table", primed.event_id).text()
    gimo = SequenceTable.open(made("gimo") / "table").events().to_pandas()
    for event in gimo.itertuples():
        assert {each["key"]: each["value"] for each in event.video}["event_frame"] == f"{event.event_time * 30:.0f}"


def test_a_moment_that_the_video_does_not_show_is_not_told() -> None:
    video = Video(np.array([10.0, 10.1, 10.3]), np.array([0.0, 3.0, 9.0]), 30.0)
    assert video.told({"event": 10.2, "prime": 9.0}) == {"event_time": "0.200", "event_frame": "6"}
    assert video.told({"event": None, "prime": 10.4}) == {}


def test_a_plain_recording_tells_its_video(tmp_path) -> None:
    about = own.About(
        participant="p",
        units=own.Units(length="m", time="ms"),
        axes=own.Axes(up="y"),
        video=own.Video(start=500, fps=25),
    )
    gaze = {"time": [0.0, 4000.0], "dx": 0.0, "dy": 0.0, "dz": 1.0, "ox": 0.0, "oy": 0.0, "oz": 0.0}
    events = {"action": ["pick"], "object": ["cup"], "frame": [50], "x": [0.0], "y": [0.0], "z": [1.0]}
    write_recording(tmp_path / "walk", about, {"gaze": gaze, "events": events})
    reader = reader_for("own")
    recording = reader.read(reader.find(tmp_path / "walk")[0])
    (event,) = recording.annotated_events
    assert event.event_time == pytest.approx(2.5)
    assert recording.video is not None
    told = recording.video.told({"event": event.event_time, "prime": 0.0})
    assert told == {"event_time": "2.000", "event_frame": "50"}  # the video begins later than gaze
