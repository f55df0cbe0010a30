"""From HOT3D's native readings to streams: clocks, pairs of rows, gaps, masks, hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable, StreamsDoNotOverlap
from prbench.geometry.timelines import interpolate
from prbench.protocol.manifests import load_manifest
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.synthetic import clock_start, native_object_id, sense
from prbench.readers.hot3d.to_recording import (
    ClockMatch,
    match_clocks,
    object_track,
    recording_from_hot3d,
    umetrack_points,
)
from prbench.recording import Recording
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Switches
from tests.readers.hot3d_trees import first_seconds

MANIFEST = load_manifest("hot3d")
FRAME = 33_333_333


@pytest.fixture(scope="module")
def performance() -> Performance:
    return perform("hot3d", seed=11, index=0, n_events=2, provocations={})


@pytest.fixture(scope="module")
def readings(performance) -> hot3d.Hot3dReadings:
    """Of ideal sensors."""
    return first_seconds(sense(performance, noise=0.0, switches=Switches.ideal()), 4.0)


def _recording(readings: hot3d.Hot3dReadings) -> Recording:
    return recording_from_hot3d(readings, MANIFEST, dataset="hot3d")


def _rows(time_ns: np.ndarray) -> hot3d.Hot3dObject:
    n = len(time_ns)
    position = np.column_stack([np.arange(n) * 0.01, np.zeros(n), np.ones(n)])
    return hot3d.Hot3dObject("7", "mug", hot3d.PoseRows(time_ns, position, np.tile([1.0, 0, 0, 0], (n, 1))), None)


def _track(time_ns: np.ndarray, good: np.ndarray | None = None):
    return object_track(_rows(time_ns), np.ones(len(time_ns), dtype=bool) if good is None else good, 0.2)


def test_one_row_of_each_pair_is_kept() -> None:
    rgb = np.arange(10) * FRAME
    track = _track(np.column_stack([rgb, rgb + 90_785]).ravel())
    assert np.array_equal(track.times, rgb / 1e9)
    assert track.position[:, 0] == pytest.approx(np.arange(10) * 0.02), "the first of both"
    alone = _track(np.delete(np.column_stack([rgb, rgb + 90_785]).ravel(), 6))
    assert len(alone.times) == 10, "a SLAM row whose RGB row is missing stands in for it"


def test_the_world_is_turned_to_y_up() -> None:
    track = _track(np.arange(3) * FRAME)
    assert track.position[2] == pytest.approx([0.02, 1.0, 0.0])
    low, high = replace(track, box_max=np.array([0.1, 0.2, 0.3])).world_box(track.position[:1], track.rotation[:1])
    assert (high - low)[0] == pytest.approx([0.1, 0.3, 0.2]), "the object's z axis points up, where the world's did"


def test_short_gaps_stay_open_and_long_ones_are_marked() -> None:
    rgb = np.arange(60) * FRAME
    short, long = np.delete(rgb, slice(10, 15)), np.delete(rgb, slice(10, 17))
    assert _track(short).valid.all(), "0.2 s may be interpolated"
    track = _track(long)
    assert track.valid.tolist().count(False) == 1
    assert (rgb[9] + rgb[17]) / 2e9 == pytest.approx(track.times[~track.valid][0])
    position, _ = track.pose_at(np.array([rgb[9] / 1e9]))
    assert position[0, 0] == pytest.approx(0.09), "the mark changes no pose"


def test_an_object_without_a_model_is_a_point() -> None:
    track = _track(np.arange(3) * FRAME)
    assert np.array_equal(track.box_min, np.zeros(3))
    assert np.array_equal(track.box_max, np.zeros(3))


def test_ideal_readings_come_back_as_the_truth(performance, readings) -> None:
    recording = _recording(readings)
    start = clock_start(performance) - performance.times[0]
    eye = interpolate(performance.times, performance.eye, recording.head.times - start)
    # Clocks are known to half a millisecond, in which a head moves less than that.
    assert np.abs(recording.head.position - eye).max() < 5e-4
    joint = interpolate(performance.times, performance.joints[:, 20], recording.hand_streams("wrist")[0].times - start)
    assert recording.hand_streams("wrist")[0].points[:, 0] == pytest.approx(joint, abs=2e-6)
    for motion in performance.objects:
        track = recording.object(native_object_id(motion.object_id))
        low, high = track.world_box(track.position[:1], track.rotation[:1])
        assert ((low + high) / 2)[0] == pytest.approx(motion.position[0], abs=3e-6)
    assert recording.span == pytest.approx((start + performance.times[0], start + performance.times[0] + 4.0), abs=0.04)


def test_a_body_is_moved_to_the_clock_of_the_ground_truth(performance) -> None:
    recording = _recording(sense(performance, noise=0.0, switches=Switches.ideal()))
    assert recording.body is not None
    assert recording.pose_source == "egoallo"
    times = recording.body.times - clock_start(performance) + performance.times[0]
    inside = (times > times[0] + 0.1) & recording.body.valid
    joints = interpolate(performance.times, performance.joints, times)
    assert np.abs(recording.body.joints[inside][:, 0] - joints[inside][:, 0]).max() < 2e-3


def test_the_first_frames_are_not_used_where_no_mask_says_that_they_are_right(readings) -> None:
    without = {name: rows for name, rows in readings.masks.items() if name != "qa_pass"}
    recording = _recording(replace(readings, masks=without))
    for stream in (*recording.hands, *recording.objects):
        started = stream.times - recording.span[0] >= 0.7 - 1e-6
        assert np.array_equal(stream.valid, started)
    assert recording.gaze.valid[recording.gaze.times < recording.span[0] + 0.7].all(), "gaze is none of the hands'"
    assert any("first 0.7 s" in message for message in recording.messages)
    assert _recording(readings).objects[0].valid.all(), "with the mask all frames are right"


def test_frames_that_fail_the_quality_check_are_invalid_in_objects_and_hands(readings) -> None:
    good = np.ones(len(readings.masks["qa_pass"][1]), dtype=bool)
    good[20:30] = False
    recording = _recording(replace(readings, masks={**readings.masks, "qa_pass": _mask(readings, good)}))
    for stream in (*recording.hands, *recording.objects):
        assert np.array_equal(np.flatnonzero(~stream.valid), np.arange(20, 30))
    assert any(message.startswith("10 of 121 frames fail") for message in recording.messages)


def _mask(readings: hot3d.Hot3dReadings, good: np.ndarray) -> hot3d.MaskRows:
    return readings.masks["qa_pass"][0], good


MASKED = {
    "headset_pose_available": lambda recording: (recording.head, recording.camera, recording.gaze),
    "object_pose_available": lambda recording: recording.objects,
    "hand_pose_available": lambda recording: recording.hands,
}


@pytest.mark.parametrize("name", MASKED)
def test_a_mask_makes_its_own_stream_invalid_and_no_other(readings, name) -> None:
    good = np.ones(len(readings.masks["qa_pass"][1]), dtype=bool)
    good[40:50] = False
    before = _recording(readings)
    after = _recording(replace(readings, masks={**readings.masks, name: _mask(readings, good)}))
    lost = {
        kind: sum(int(one.valid.sum() - other.valid.sum()) for one, other in zip(of(before), of(after), strict=True))
        for kind, of in MASKED.items()
    }
    assert lost.pop(name) > 0
    assert set(lost.values()) == {0}


def test_without_a_profile_hands_are_wrists(readings) -> None:
    recording = _recording(replace(readings, hand_model=None))
    assert {hand.contact for hand in recording.hands} == {"wrist"}
    assert any("wrists only" in message for message in recording.messages)


def test_vertices_belong_to_the_row_that_is_kept(readings) -> None:
    rows = readings.hands[0]
    time_ns, wrist, vertices = umetrack_points(rows, readings.hand_model)
    assert np.array_equal(time_ns, rows.time_ns[::2])
    assert np.array_equal(wrist, rows.position[::2])
    assert np.linalg.norm(vertices - wrist[:, None], axis=2).max() < 0.25


def test_quality_masks_and_rows_need_not_share_their_times(readings) -> None:
    """Where the RGB row is missing the SLAM row 91 us later has its flag."""
    good = np.ones(len(readings.masks["qa_pass"][1]), dtype=bool)
    good[5] = False
    entry = readings.objects[0]
    slam = hot3d.PoseRows(*(column[1::2] for column in (entry.rows.time_ns, entry.rows.position, entry.rows.rotation)))
    objects = (replace(entry, rows=slam), *readings.objects[1:])
    recording = _recording(replace(readings, objects=objects, masks={"qa_pass": _mask(readings, good)}))
    assert np.flatnonzero(~recording.objects[0].valid).tolist() == [5]


def test_a_headset_of_another_world_is_refused(readings) -> None:
    moved = replace(readings.headset, position=readings.headset.position + 1.0)
    with pytest.raises(RecordingUnusable, match="not one world"):
        _recording(replace(readings, headset=moved))


def test_objects_of_another_recording_are_refused(readings) -> None:
    later = tuple(
        replace(entry, rows=replace(entry.rows, time_ns=entry.rows.time_ns + 10**12)) for entry in readings.objects
    )
    with pytest.raises(StreamsDoNotOverlap, match="objects"):
        _recording(replace(readings, objects=later))


def test_gaps_in_an_object_are_told(readings) -> None:
    entry = readings.objects[0]
    half = entry.rows.time_ns > entry.rows.time_ns[0] + 2_000_000_000
    rows = hot3d.PoseRows(entry.rows.time_ns[half], entry.rows.position[half], entry.rows.rotation[half])
    recording = _recording(replace(readings, objects=(replace(entry, rows=rows), *readings.objects[1:])))
    assert any(f"{entry.name} lacks 50% of its poses" in message for message in recording.messages)


OFFSET = 56_833_060_899_305  # ns
START = 56_752_108_188_860


def _device(seconds: float, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A head that never rests, every millisecond."""
    rng = np.random.default_rng(seed)
    time_ns = START + OFFSET + np.arange(int(seconds * 1000)) * 1_000_000
    position = np.cumsum(rng.normal(0.0, 1e-4, (len(time_ns), 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 1e-3, (len(time_ns), 3)), axis=0))
    return time_ns, position, turns.as_quat(scalar_first=True)


def _headset(
    device: tuple[np.ndarray, np.ndarray, np.ndarray], *, drift: float = 0.0, step: float = 1 / 30
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the device at the nearest millisecond, stamped by a clock that runs ``drift`` too fast."""
    since = np.arange(0.0, (len(device[0]) - 2) * 1e-3, step)
    row = np.rint(since * 1000).astype(int)
    return START + np.rint(since * (1 + drift) * 1e9).astype(np.int64), device[1][row], device[2][row]


def _match(headset: tuple, device: tuple) -> ClockMatch:
    return match_clocks(hot3d.PoseRows(*headset), hot3d.PoseRows(*device), recording="P0003")


def test_the_offset_is_known_to_a_fraction_of_a_millisecond() -> None:
    device = _device(20.0)
    match = _match(_headset(device), device)
    assert match.matched == match.rows == 600
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns <= 0.2e6
    assert match.drift == 0.0


def test_a_row_says_no_more_than_half_a_step_to_either_side() -> None:
    """Rows exactly on the millisecond all allow the same half millisecond to either side."""
    device = _device(2.0)
    match = _match(_headset(device, step=0.05), device)
    assert match.offset_ns == pytest.approx(OFFSET, abs=1.0)
    assert match.half_width_ns == pytest.approx(0.5e6, abs=1.0)


def test_times_move_from_one_clock_to_the_other_and_stay_integers() -> None:
    device = _device(2.0)
    match = _match(_headset(device), device)
    moved = match.truth_ns(device[0])
    assert moved.dtype == np.int64
    assert np.abs(moved - (device[0] - OFFSET)).max() <= match.half_width_ns + 1


@pytest.mark.parametrize("drift", [20e-6, -20e-6])
def test_a_drift_is_fitted_where_one_offset_does_not_fit(drift: float) -> None:
    device = _device(120.0)
    match = _match(_headset(device, drift=drift), device)
    # The truth runs faster, so that the device falls behind it.
    assert match.drift == pytest.approx(-drift, rel=0.05)
    truth = START + (device[0] - device[0][0]) * (1 + drift)
    assert np.abs(match.truth_ns(device[0]) - truth).max() < 0.5e6
    assert (np.diff(match.truth_ns(device[0])) > 0).all()


def test_rows_at_a_place_that_comes_twice_are_dropped() -> None:
    device = _device(10.0)
    position, rotation = device[1].copy(), device[2].copy()
    position[5000:6000], rotation[5000:6000] = position[4999], rotation[4999]  # the head rests to the last digit
    still = device[0], position, rotation
    match = _match(_headset(still), still)
    assert 265 <= match.matched <= 275, "30 of 300 rows were taken at rest"
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_rows_of_a_short_rest_are_dropped_and_not_guessed() -> None:
    """Three milliseconds at rest: each of the rows would be near enough, and two of them wrong."""
    device = _device(10.0)
    time_ns, position, rotation = _headset(device)
    row = np.rint((time_ns - START) / 1e6).astype(int)[10::10]
    resting = device[1].copy(), device[2].copy()
    for column in resting:
        column[row - 1] = column[row + 1] = column[row]
    match = _match((time_ns, position, rotation), (device[0], *resting))
    assert match.matched == len(time_ns) - len(row)
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


def test_a_head_that_hardly_moves_is_found_to_the_last_digit() -> None:
    """Neighbouring rows are closer than a micrometre, but only one is bit-identical."""
    time_ns, position, rotation = _device(10.0)
    slow = time_ns, position * 1e-3, np.tile(rotation[:1], (len(rotation), 1))
    assert _match(_headset(slow), slow).matched == 300


@pytest.mark.parametrize("kind", ["rounded rows", "a stray match at another time"])
def test_rounding_and_strays_do_not_spoil_the_offset(kind) -> None:
    device = _device(10.0)
    time_ns, position, rotation = _headset(device)
    if kind == "rounded rows":
        position, rotation = np.round(position, 7), np.round(rotation, 6)
        fewest, most = 251, len(time_ns)
    else:
        position[7], rotation[7] = device[1][9000], device[2][9000]
        fewest = most = len(time_ns) - 1
    match = _match((time_ns, position, rotation), device)
    assert fewest <= match.matched <= most
    assert abs(match.offset_ns - OFFSET) <= match.half_width_ns


JUMP = np.where(np.arange(600) < 400, 0, 3_000_000)
SHUFFLED = np.random.default_rng(1).permutation(600)
# Changes of headset rows, and the reason why they cannot be matched; a smoothed trajectory is near, and no row of it.
UNMATCHED = {
    "another world": (lambda t, p, r: (t, p + 0.1, r), r"P0003: .* mm apart \(median\): not one world"),
    "a smoothed trajectory": (lambda t, p, r: (t, p + 2e-5, r), "0 of 600 headset rows are found"),
    "a clock that jumps": (lambda t, p, r: (t + JUMP, p, r), "no offset and no drift"),
    "times without relation": (lambda t, p, r: (t, p[SHUFFLED], r[SHUFFLED]), "agree about the offset"),
}


@pytest.mark.parametrize("name", UNMATCHED)
def test_clocks_that_cannot_be_matched_are_refused(name) -> None:
    change, says = UNMATCHED[name]
    device = _device(20.0)
    with pytest.raises(RecordingUnusable, match=says):
        _match(change(*_headset(device)), device)


def test_a_trajectory_too_coarse_to_tell_is_refused() -> None:
    """One row every 5 ms, and headset rows exactly on them: each allows 2.5 ms to either side."""
    time_ns, position, rotation = _device(20.0)
    coarse = time_ns[::5], position[::5], rotation[::5]
    headset = START + (time_ns[::50] - time_ns[0]), position[::50], rotation[::50]
    with pytest.raises(RecordingUnusable, match=r"uncertain by 5\.00 ms, 1 ms is needed"):
        _match(headset, coarse)
