"""Priming on arrays of one's own, in one call: the command ``prbench prime``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from prbench.api import arguments as args
from prbench.curation.own_priming import PrimedEvent, constants_of, prime_events
from prbench.errors import UsageError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def prime(
    times: ArrayLike,
    origins: ArrayLike,
    directions: ArrayLike,
    boxes: ArrayLike,
    event_times: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    objects: Sequence[str] | None = None,
    actions: Sequence[str] | None = None,
    window: float | None = None,
    near_miss: float | None = None,
) -> list[PrimedEvent]:
    """Say when gaze first met the place of each event: equations 1 to 7 of *Prime and Reach*.

    Gaze and boxes stand in one frame, whichever axis points up; ``pandas.DataFrame`` takes the result as it is.

    Args:
        times: Times of the gaze samples, (n,), seconds, increasing.
        origins: Points between the eyes, (n, 3), metres. A row with NaN was not measured.
        directions: Directions of gaze, (n, 3), of any length. A row with NaN was not measured.
        boxes: Box of each event along the axes, (m, 2, 3): lower and upper corner, metres; or points (m, 3). For a put
            it is the place where the object comes to rest.
        event_times: Time of each event, (m,), seconds on the clock of the gaze.
        valid: Samples that were measured, (n,); all by default.
        objects: Name of each event's object; its number by default.
        actions: Name of each event's action.
        window: Seconds before an event in which a look primes it; 10 by default.
        near_miss: Distance at which gaze may pass a box, metres; 0.05 by default.

    Raises:
        UsageError: naming the argument and row that does not fit.
        StreamsDoNotOverlap: if gaze and events share no instant, with the unit that would make them.

    Examples:
        Somebody looks up, from 3 s on at a cup that is taken at 5 s:

        >>> import numpy as np
        >>> import prbench
        >>> times = np.arange(0, 6, 0.1)
        >>> directions = np.where(times[:, None] < 3, [0, 1, 0], [0, 0, 1])
        >>> cup = [[-0.1, -0.1, 1.9], [0.1, 0.1, 2.1]]
        >>> (event,) = prbench.prime(times, np.zeros((60, 3)), directions, [cup], [5.0], objects=["cup"])
        >>> event.prime_kind, round(event.prime_time, 3), round(event.prime_gap, 3)
        ('hit', 3.0, 2.0)
    """
    named = {"times": times, "origins": origins, "directions": directions, "boxes": boxes, "event_times": event_times}
    given = {name: args.as_array(name, value) for name, value in named.items()}
    n = given["times"].size
    m = given["event_times"].size
    if given["boxes"].shape == (m, 3):
        given["boxes"] = np.stack([given["boxes"]] * 2, axis=1)
    given["valid"] = args.as_array("valid", np.ones(n) if valid is None else valid)
    names = np.arange(m).astype(str) if objects is None else np.asarray(objects)
    verbs = np.full(m, "") if actions is None else np.asarray(actions)
    shapes = {"times": (n,), "origins": (n, 3), "directions": (n, 3), "valid": (n,), "event_times": (m,)}
    shapes |= {"boxes": (m, 2, 3), "objects": (m,), "actions": (m,)}
    for name, array in {**given, "objects": names, "actions": verbs}.items():
        if array.shape != shapes[name]:
            raise UsageError(f"{name}: expected the shape {shapes[name]}, found {array.shape}.")

    clock, origin, direction, corners = (given[name] for name in ("times", "origins", "directions", "boxes"))
    known = (given["valid"] != 0) & np.isfinite(np.column_stack([clock, origin, direction])).all(axis=1)
    rows = np.flatnonzero(known)
    length = np.linalg.norm(direction, axis=1)
    later = np.diff(clock[rows], prepend=-np.inf) > 0
    checks = {
        "times": (rows[~later], "a time after the one before"),
        "directions": (np.flatnonzero(known & (length == 0)), "a direction"),
        "event_times": (np.flatnonzero(~np.isfinite(given["event_times"])), "a time"),
        "boxes": (np.flatnonzero(~(np.diff(corners, axis=1) >= 0).all(axis=(1, 2))), "a lower and an upper corner"),
    }
    for name, (bad, expected) in checks.items():
        if bad.size:
            raise UsageError(f"{name}[{bad[0]}]: expected {expected}, found {given[name][bad[0]].tolist()}.")
    constants = constants_of(priming_window=window, near_miss_distance=near_miss)
    rays = (clock[rows], origin[rows], direction[rows] / length[rows, None])
    return prime_events(rays, corners, given["event_times"], names.tolist(), verbs.tolist(), constants)
