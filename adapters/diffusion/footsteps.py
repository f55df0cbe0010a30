"""Steps for feet that glide.

A network of few sampling steps answers with the mean over all moments at which a person may lift a foot, and the mean
of steps glides. Here each toe stays in its place until the place where the network wants it is too far away; then it
swings to where it is wanted for the rest of the time (docs/methods/pr.md#feet).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

Feet = Float[np.ndarray, "frames 2 3"]  # left and right, metres
Heights = Float[np.ndarray, "frames 2 2"]
Points = Float[np.ndarray, "frames 3"]  # metres

# Seconds of a swing: 40 % of a gait cycle of 1.1 seconds (Perry and Burnfield 2010, Gait Analysis).
SWING = 0.45
# Metres to which a toe joint rises in the middle of its swing; choice: recorded toes are at 6.8 cm on the average while
# they are quicker than half a metre a second (tables of synthetic people, training split).
LIFT = 0.08
# Metres that a toe may be away from where it is wanted before it swings; choice, about a foot's width.
LAG = 0.08
# Likewise, where the network says that the foot stands: half a short step.
SURE_LAG = 0.16
_REST = 0.15  # seconds on the floor between two swings of a foot; choice
_HIGH = 0.05  # metres above its lowest place from which on a toe of the first frame is in the air
_QUICK = 0.25  # m/s from which on it is, too; over the speed of planted toes of noisy body trackers
_RISING, _FALLING = 0.25, 0.6  # shares of its swing that such a toe has behind it; choice
_END = 0.15  # seconds before the end of a motion in which no swing starts
_RETURN = 0.2  # seconds after the first and before a given last frame within which heights pass to the given ones


@dataclass(frozen=True)
class _Swing:
    """One foot's way through the air.

    Attributes:
        stop: Frame in which it lands.
        behind: Share of the swing before the motion's first frame.
    """

    start: int
    stop: int
    source: Float[np.ndarray, "2"]
    target: Float[np.ndarray, "2"]
    behind: float = 0.0


def stepped(wanted: Feet, stands: Bool[np.ndarray, "frames 2"], fps: float, *, keeps_last: bool) -> Feet:
    """Toes that stand still on the floor or swing above it, close to where they are wanted.

    Args:
        wanted: Left and right toe, Y up, metres. The first frame is kept.
        stands: Whether the network says that the foot is planted.
        fps: Frames per second.
        keeps_last: Keep the last frame, too.
    """
    # For each foot the share of a swing that it has behind it in the first frame; 0 if it stands.
    shares = []
    for toe in np.moveaxis(wanted, 1, 0):
        step = toe[min(1, len(toe) - 1)] - toe[0]
        flies = toe[0, 1] > toe[:, 1].min() + _HIGH or np.hypot(step[0], step[2]) * fps > _QUICK
        shares.append((_RISING if step[1] > 0 else _FALLING) if flies else 0.0)
    swings = _swings(wanted[..., ::2], stands, shares, fps)
    if keeps_last:
        swings = _ending_as_wanted(swings, wanted[..., ::2], fps)
    return np.stack([_way(wanted[:, foot], swings[foot], fps, keeps_last=keeps_last) for foot in (0, 1)], axis=1)


def _swings(wanted: Heights, stands: np.ndarray, behind: list[float], fps: float) -> list[list[_Swing]]:
    """Plan the swings of both feet, from the first frame on; one foot at a time leaves the floor.

    Args:
        wanted: Places of the toes on the floor.
        stands: True where the network says that the foot is planted.
        behind: Share of a swing that each foot has behind it in the first frame.
        fps: Frames per second.
    """
    n = len(wanted)
    length = max(round(SWING * fps), 2)
    swings: list[list[_Swing]] = [[], []]
    for foot, share in enumerate(behind):
        if share:
            # A toe that flies in frame 0 may stand when it is slow, after the rest of a swing.
            quick = np.linalg.norm(np.diff(wanted[:, foot], axis=0), axis=1) * fps > _QUICK
            rest = max(round((1 - share) * SWING * fps), 1)
            slow = np.flatnonzero(~quick[rest : 2 * rest])
            stop = min(rest + (int(slow[0]) if len(slow) else rest), n - 1)
            swings[foot].append(_Swing(0, stop, wanted[0, foot], _landing(wanted[:, foot], stop, length), share))
    frame = 0
    while frame < n - _END * fps:
        landed = [own[-1].stop if own else -n for own in swings]
        if max(landed) > frame:
            frame = max(landed)
            continue
        lags = []
        for foot in (0, 1):
            place = swings[foot][-1].target if swings[foot] else wanted[0, foot]
            # A swing is half over when the foot is where it ought to be, so it starts half its time before.
            away = np.hypot(*(wanted[min(frame + length // 2, n - 1), foot] - place))
            limit = SURE_LAG if stands[frame : frame + length, foot].all() else LAG
            lags.append(away / limit if frame - landed[foot] >= _REST * fps else 0.0)
        foot = int(np.argmax(lags))
        if lags[foot] > 1:
            source = swings[foot][-1].target if swings[foot] else wanted[0, foot]
            stop = min(frame + length, n - 1)
            swings[foot].append(_Swing(frame, stop, source, _landing(wanted[:, foot], stop, length)))
        else:
            frame += 1
    return swings


def _landing(wanted: Float[np.ndarray, "frames 2"], stop: int, length: int) -> Float[np.ndarray, "2"]:
    """Return the mean place where a toe is wanted while the other foot may swing."""
    first = min(stop, len(wanted) - 1)
    return wanted[first : first + length].mean(axis=0)


def _ending_as_wanted(swings: list[list[_Swing]], wanted: Heights, fps: float) -> list[list[_Swing]]:
    """Swings of which the last one of each foot lands where the toe is wanted in the last frame.

    A foot that has stood all the time and ends no farther away than it may lag gets none: it turns on the floor.
    """
    n = len(wanted)
    length = max(round(SWING * fps), 2)
    ending = []
    for foot, own in enumerate(swings):
        place = wanted[-1, foot]
        if own:
            ending.append([*own[:-1], replace(own[-1], target=place)])
            continue
        if np.hypot(*(place - wanted[0, foot])) <= LAG:
            ending.append([])
            continue
        # A foot that has stood all the time goes as late as it can while the other one stands.
        other = ending[0] if ending else swings[1]
        stop = n - 1
        if other and other[-1].stop > n - 1 - length and other[-1].start >= length:
            stop = other[-1].start
        ending.append([_Swing(max(stop - length, 0), stop, wanted[0, foot], place)])
    return ending


def _way(wanted: Points, swings: list[_Swing], fps: float, *, keeps_last: bool) -> Points:
    """Return the toe's way: the lowest wanted heights above the floor while it stands, and between them the swings."""
    n = len(wanted)
    frames = np.arange(n)
    edges = [0, *(frame for swing in swings for frame in (swing.start, swing.stop)), n - 1]
    stood = [max(wanted[first : last + 1, 1].min(), 0) for first, last in zip(edges[::2], edges[1::2], strict=True)]
    way = np.repeat(wanted[:1], n, axis=0)
    way[:, 1] = np.interp(frames, edges, np.repeat(stood, 2))
    way[:, 1] += _fading(frames, fps) * (wanted[0, 1] - way[0, 1])
    for swing in swings:
        flies = slice(swing.start, swing.stop)
        share = (frames[flies] - swing.start) / (swing.stop - swing.start)
        if swing.behind:
            # A toe in the air in the first frame goes on as the network says, so that the first step has the speed of
            # the given pose; it is lifted where that is too low, and ends where it stands afterwards.
            flight = wanted[: len(share)].copy()
            flight[:, ::2] += share[:, None] * (swing.target - wanted[min(swing.stop, n - 1), ::2])
            rise = LIFT * np.sin(np.pi * (swing.behind + (1 - swing.behind) * share))
            flight[:, 1] += (1 - _fading(np.arange(len(share)), fps)) * np.maximum(rise - flight[:, 1], 0)
            way[flies] = flight
        else:
            way[flies, ::2] = swing.source + _eased(share)[:, None] * (swing.target - swing.source)
            way[flies, 1] += LIFT * np.sin(np.pi * share)
        way[swing.stop :, ::2] = swing.target
    if keeps_last and not swings:
        way[:, ::2] += _eased(frames / max(n - 1, 1))[:, None] * (wanted[-1, ::2] - wanted[0, ::2])
    if keeps_last:
        way[:, 1] += _fading(n - 1 - frames, fps, within=n - 1) * (wanted[-1, 1] - way[-1, 1])
    return way


def _fading(frames: np.ndarray, fps: float, *, within: int | None = None) -> Float[np.ndarray, "frames"]:
    """1 in frame 0, 0 after :data:`_RETURN`, or after fewer frames."""
    over = _RETURN * fps
    if within is not None:
        over = max(min(over, within), 1)
    return np.clip(1 - frames / over, 0, 1)


def _eased(share: np.ndarray) -> np.ndarray:
    """Least jerk from 0 to 1 (Flash and Hogan 1985)."""
    return share**3 * (10 - 15 * share + 6 * share**2)
