"""The minimum-movement filter (*Prime and Reach*, section B.1) and its alternatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from prbench.curation.clipping import Clip
from prbench.curation.events import Decision, PickPutEvent, Place
from prbench.sequences.table_one import body_movement
from prbench.skeleton import WRISTS


def wrist_to_goal(clip: Clip, _event: PickPutEvent, place: Place) -> float | None:
    """Distance of the nearer wrist of the first frame to the goal: the protocol's reading of the paper."""
    return float(np.linalg.norm(clip.joints[0, WRISTS] - place.location, axis=1).min())


def pelvis_displacement(clip: Clip, _event: PickPutEvent, _place: Place) -> float | None:
    """Largest distance of the pelvis from where it was in the first frame."""
    return body_movement(clip.joints)


def object_displacement(_clip: Clip, event: PickPutEvent, _place: Place) -> float | None:
    """Largest distance of the object from its rest; None for annotated events, which the filter then lets pass."""
    return event.displacement


MEASURES: dict[str, Callable[[Clip, PickPutEvent, Place], float | None]] = {
    "wrist_to_goal": wrist_to_goal,
    "pelvis_displacement": pelvis_displacement,
    "object_displacement": object_displacement,
}
"""What must be at least the protocol's minimum movement, by name of the option."""


def minimum_movement(clip: Clip, event: PickPutEvent, place: Place, *, measure: str, threshold: float) -> Decision:
    """Keep (``sequence``) or drop (``minimum_movement``) a clip; value and threshold in metres."""
    value = MEASURES[measure](clip, event, place)
    outcome = "minimum_movement" if value is not None and value < threshold else "sequence"
    return Decision(outcome, "filters", value, threshold)
