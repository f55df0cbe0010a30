"""Hands of a HOT3D recording: wrists and mesh vertices in the world (docs/specification/hot3d.md#files)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Int

from prbench.axes import y_up
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import umetrack
from prbench.recording.streams import HandStream


def hand_streams(
    readings: hot3d.Hot3dReadings, good: Callable[[Int[np.ndarray, " n"]], Bool[np.ndarray, " n"]]
) -> tuple[tuple[HandStream, ...], tuple[str, ...]]:
    """Wrists and vertices of both hands at the instants where they are tracked, and remarks.

    Vertices are kept as float32 (a tenth of a micrometre within the room): they are the bulk of a recording.

    Args:
        readings: The recording.
        good: Tells which times can be used.
    """
    if readings.mano_hands is not None:
        posed = [_instants(hand) for hand in readings.mano_hands]
    else:
        posed = [umetrack_points(rows, readings.hand_model) for rows in readings.hands]
    streams = []
    for hand in posed:
        if len(hand.time_ns) == 0:
            continue
        times, valid = hand.time_ns / 1e9, good(hand.time_ns)
        streams.append(HandStream(hand.side, "wrist", times, y_up(hand.wrist)[:, None], valid))
        if hand.vertices.shape[1]:
            points = y_up(hand.vertices).astype(np.float32)
            streams.append(HandStream(hand.side, "hand_vertex", times, points, valid))
    return tuple(streams), _remarks(posed)


def umetrack_points(rows: hot3d.HandRows, model: umetrack.HandModel | None) -> hot3d.HandPoints:
    """One hand, one row an instant; without a model no vertices. Source world, metres."""
    kept = hot3d.first_of_pairs(rows.time_ns)
    position, rotation = rows.position[kept], rows.rotation[kept]
    if model is None or not kept.any():
        vertices = np.empty((int(kept.sum()), 0, 3))
    else:
        bones = umetrack.bone_transforms(model, rows.angles[kept])
        vertices = umetrack.pose_points(
            model.vertices, model.weights, bones, position, rotation, mirrored=rows.side == "right"
        )
    return hot3d.HandPoints(rows.side, rows.time_ns[kept], position, vertices)


def _instants(hand: hot3d.HandPoints) -> hot3d.HandPoints:
    kept = hot3d.first_of_pairs(hand.time_ns)
    return hot3d.HandPoints(hand.side, hand.time_ns[kept], hand.wrist[kept], hand.vertices[kept])


def _remarks(posed: Sequence[hot3d.HandPoints]) -> tuple[str, ...]:
    remarks = [f"the {hand.side} hand is never tracked" for hand in posed if len(hand.time_ns) == 0]
    if any(len(hand.time_ns) and hand.vertices.shape[1] == 0 for hand in posed):
        remarks.append(f"no {hot3d.PROFILE_FILE}: hands are wrists only; the in-hand rule `wrist` needs no more")
    return tuple(remarks)
