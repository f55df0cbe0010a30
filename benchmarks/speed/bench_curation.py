"""Time curation of one recording against naive per-frame Python.

Run from the repository's root: ``python -m benchmarks.speed.bench_curation``. The recording is synthetic: about two
minutes, some 400 objects. The naive loops run on a part of the frames and are scaled up.
"""

from __future__ import annotations

import math
import time

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.speed.bench_reading import BYSTANDER_OBJECTS, EVENTS
from benchmarks.speed.timing import Row, print_rows, timed
from prbench.curation import curate_recording
from prbench.curation.in_hand import find_holdings
from prbench.curation.priming import gaze_rays
from prbench.geometry.shapes import near_miss, slab_test
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.recording import ObjectTrack, Recording
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform

NAIVE_RAYS, NAIVE_FRAMES = 20, 20


def main() -> None:
    """Print three tables."""
    recording = synthetic_recording(
        perform("adt", seed=0, index=0, n_events=EVENTS, bystander_objects=BYSTANDER_OBJECTS)
    )
    bench_slab_test(recording)
    bench_in_hand(recording)
    bench_whole(recording)


def bench_slab_test(recording: Recording) -> None:
    """All rays of a recording against the boxes of all its objects."""
    _, origins, directions = gaze_rays(recording, "eye")
    boxes = [track.world_box(track.position[:1], track.rotation[:1]) for track in recording.objects]
    low, high = (np.concatenate([box[side] for box in boxes]) for side in (0, 1))

    def ours() -> None:
        slab_test(origins, directions, low, high)

    def naive() -> float:
        start = time.perf_counter()
        for origin, direction in zip(origins[:NAIVE_RAYS], directions[:NAIVE_RAYS], strict=True):
            for box_low, box_high in zip(low, high, strict=True):
                naive_slab_test(origin, direction, box_low, box_high)
        return (time.perf_counter() - start) * len(origins) / NAIVE_RAYS

    rows = [
        Row("prbench: slab test", timed(ours, 5)),
        Row("prbench: near misses", timed(lambda: near_miss(origins, directions, low, high), 3)),
        Row(f"naive Python, scaled up from {NAIVE_RAYS} rays", naive()),
    ]
    print_rows(f"{len(origins)} rays against {len(low)} boxes", rows)


def naive_slab_test(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """One ray, one box, axis by axis."""
    near, far = -math.inf, math.inf
    for axis in range(3):
        if direction[axis] == 0:
            if not low[axis] <= origin[axis] <= high[axis]:
                return False
            continue
        one, other = (low[axis] - origin[axis]) / direction[axis], (high[axis] - origin[axis]) / direction[axis]
        near, far = max(near, min(one, other)), min(far, max(one, other))
    return near < far and far >= 0


def bench_in_hand(recording: Recording) -> None:
    """Time in-hand segmentation over all objects."""
    rule = load_manifest("adt").in_hand
    tracks = [track for track in recording.objects if track.movable]
    frames = len(tracks[0].times)

    def naive() -> float:
        start = time.perf_counter()
        for track in tracks:
            for frame in range(3, 3 + NAIVE_FRAMES):
                naive_held(recording, track, frame, rule.distance, rule.moving_speed)
        return (time.perf_counter() - start) * frames / NAIVE_FRAMES

    rows = [
        Row("prbench: holdings of all objects", timed(lambda: find_holdings(recording, rule), 5)),
        Row(f"naive Python, scaled up from {NAIVE_FRAMES} frames", naive()),
    ]
    print_rows(f"in-hand segmentation, {len(tracks)} movable objects, {frames} frames", rows)


def naive_held(recording: Recording, track: ObjectTrack, frame: int, distance: float, speed: float) -> bool:
    """One object in one frame: is a finger base near, and does the object move over 0.2 s?"""
    before, after = max(frame - 3, 0), min(frame + 3, len(track.times) - 1)
    moved = np.linalg.norm(track.position[after] - track.position[before])
    moving = moved / (track.times[after] - track.times[before]) > speed
    object_from_world = Rotation.from_quat(track.rotation[frame], scalar_first=True).inv()
    close = False
    for hand in recording.hand_streams("middle_finger_base"):
        sample = int(np.argmin(np.abs(hand.times - track.times[frame])))
        local = object_from_world.apply(hand.points[sample, 0] - track.position[frame])
        outside = np.maximum(np.maximum(track.box_min - local, local - track.box_max), 0.0)
        close = close or float(np.linalg.norm(outside)) < distance
    return close and moving


def bench_whole(recording: Recording) -> None:
    """Everything from the recording to its sequences."""
    manifest, protocol = load_manifest("adt"), load_protocol()
    curated = curate_recording(recording, manifest, protocol)
    seconds = recording.span[1] - recording.span[0]
    rows = [
        Row("prbench: recording to sequences", timed(lambda: curate_recording(recording, manifest, protocol), 5)),
        Row("the recording itself, played", seconds),
    ]
    title = f"curation of {seconds:.0f} s: {len(curated.events)} events, {len(curated.sequences)} sequences"
    print_rows(title, rows)


if __name__ == "__main__":
    main()
