"""Steps for feet that glide.

Networks say when feet swing, but let them glide where they ought to stand. Here a foot stays where it lands, with its
direction, until the network swings it; the swing is the network's own, laid between the two places. A foot that the
network drags along without a swing gets one as soon as it is wanted too far away (docs/methods/pr.md#feet).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from prbench.geometry.skeleton import TOES, WRISTS, Joint
from prbench_adapters.diffusion.goal_frame import bent, turned_along, unit

Motion = Float[np.ndarray, "frames 22 3"]  # metres
Poses = Float[np.ndarray, "frames 4"]  # of a foot: place of the toe (x, y, z), metres, and its direction, radians

ANKLES = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE)

# Seconds of a swing that the network does not have: 40 % of a gait cycle of 1.1 seconds (Perry and Burnfield 2010, Gait
# Analysis); and of the shortest one that it may have: three feet a second, where people walk with two (Winter 1991).
SWING = 0.45
_SHORTEST_SWING = 0.35
_LONGEST_SWING = 0.8  # seconds; a foot that is on its way for longer glides
# Metres to which a toe rises at least in the middle of a swing, and more for each metre of the step; choice, so that
# toes of the bundled P&R rise as those of synthetic people of generator 3. Networks alone lift less, because the mean
# of many swings is lower than each.
_LIFT = 0.037
_LIFT_SLOPE = 0.025
# Metres that a toe may be away from where it is wanted before it swings; choice, about a foot's width.
LAG = 0.1
_TURN = np.deg2rad(40)  # by which it may be turned away, too; choice
_TWIST = np.deg2rad(45)  # by which it may while the body turns quickly; choice
_URGENT = 1.5  # times as far away as that, a foot swings before one that the network swings; choice
_SHUFFLE = 0.05  # metres; shorter ways are none of a swing; the judge of plausible motions says so, too
_STILL = 0.08  # m/s, below which a foot stands; choice, so that finished motions of people keep their swing times
_QUICK = 0.3  # m/s, and a fifth faster than the pelvis: a foot that swings
_REST = 0.15  # seconds on the floor between two swings of a foot; choice
_HIGHEST = 0.02  # metres above the floor at which a toe stands at most; choice, the highest of people's
_END = 0.15  # seconds before the end of a motion in which no swing starts
_RETURN = 0.2  # seconds after the first and before a given last frame within which heights pass to the given ones
_ROLL = np.deg2rad(25)  # by which a heel rises more than wanted around a swing that the network does not have
_STRETCHED = 0.995  # share of thigh and shank that a leg reaches, so that its knee keeps a side to bend to
_EASE = 0.3  # seconds over which the body comes down before a leg would be too short; choice
_LEGS = ((Joint.LEFT_HIP, Joint.RIGHT_HIP), (Joint.LEFT_KNEE, Joint.RIGHT_KNEE), ANKLES)
_ARMS = ((Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER), (Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW), WRISTS)
_PITCHES = 24  # of a foot, from the wanted one to the steepest, that are tried
_STEEPEST = np.deg2rad(75)


@dataclass(frozen=True)
class Swing:
    """One foot's way through the air.

    Attributes:
        start: Last frame in which it stands; 0 for a foot that is in the air then.
        stop: First frame in which it stands again.
        own: First and last frame of the network's swing that it follows; None where the network has none.
    """

    start: int
    stop: int
    own: tuple[int, int] | None = None


def on_feet(
    motion: Float[torch.Tensor, "frames 22 3"], fps: float, *, keep_last: bool
) -> Float[torch.Tensor, "frames 22 3"]:
    """Let the feet stand or swing; heels rise or the body comes down where a leg is too short, and hands stay in place.

    Args:
        motion: Canonical frame, metres. The first frame is kept.
        fps: Frames per second.
        keep_last: Keep the last frame, too.
    """
    feet, roll = (torch.from_numpy(part) for part in stepped(motion.numpy(), fps, keep_last=keep_last))
    toes = feet[..., :3]
    hips = motion[:, _LEGS[0]]
    ankles = motion[:, ANKLES]
    foot = motion[:, TOES] - ankles
    knees = motion[:, _LEGS[1]]
    reach = _STRETCHED * ((knees - hips).norm(dim=-1, keepdim=True) + (ankles - knees).norm(dim=-1, keepdim=True))
    longest = torch.maximum(reach, (ankles - hips).norm(dim=-1, keepdim=True))
    # The least pitch from the wanted one on that lets the leg reach.
    wanted = torch.atan2(-foot[..., 1], foot[..., ::2].norm(dim=-1)) + roll
    pitch = wanted + torch.linspace(0, 1, _PITCHES)[:, None, None] * (_STEEPEST - wanted).clamp_min(0)
    across = pitch.cos()
    way = torch.stack((-across * feet[..., 3].sin(), pitch.sin(), -across * feet[..., 3].cos()), dim=-1)
    tried = toes + foot.norm(dim=-1, keepdim=True) * way
    near = (tried - hips).norm(dim=-1) <= (1 + 1e-9) * longest[..., 0]  # rounding
    least = near.to(torch.int8).argmax(dim=0)
    targets = tried.take_along_dim(least[None, ..., None], dim=0)[0]
    # The body comes down as far as a leg is too short, smoothly, and not in frames that are kept.
    away = (targets - hips)[..., ::2].norm(dim=-1, keepdim=True)
    reach = (longest.square() - away.square()).clamp_min(0).sqrt()
    short = (hips[..., 1:2] - targets[..., 1:2] - reach).clamp_min(0).amax(dim=(1, 2))
    when = torch.arange(len(motion)) / (_EASE * fps)
    near_by = 0.5 + 0.5 * (torch.pi * (when[:, None] - when).abs().clamp_max(1)).cos()
    from_ends = torch.minimum(when, when.flip(0)) if keep_last else when
    down = (short * near_by).amax(dim=1) * from_ends.clamp_max(1)
    done = motion.clone()
    done[..., 1] -= down[:, None]
    # Knees and elbows are turned along: a limb that swings past its middle's side would bend the other way.
    for frames, limbs, ends in ((slice(None), _LEGS, targets), (down > 0, _ARMS, motion[:, WRISTS])):
        root, middle, end = (motion[frames][:, joints] for joints in limbs)
        moved = done[frames][:, limbs[0]]
        poles = turned_along(middle - root, unit(end - root), unit(ends[frames] - moved))
        lengths = ((middle - root).norm(dim=-1, keepdim=True), (end - middle).norm(dim=-1, keepdim=True))
        found = torch.cat(bent(moved, ends[frames], *lengths, poles), dim=1)
        done[frames] = done[frames].index_copy(1, torch.tensor((*limbs[1], *limbs[2])), found)
    done[:, TOES] = done[:, ANKLES] + toes - targets
    kept = [0, -1] if keep_last else [0]
    done[kept] = motion[kept]
    return done


def stepped(motion: Motion, fps: float, *, keep_last: bool) -> tuple[Float[np.ndarray, "frames 2 4"], np.ndarray]:
    """Return feet that stand still on the floor or swing above it, close to where they are wanted.

    Args:
        motion: Canonical frame, metres. The first frame is kept.
        fps: Frames per second.
        keep_last: Keep the last frame, too.

    Returns:
        Places of left and right toe, metres, with the directions of the feet on the floor, radians; and what their
        pitch is to be raised by, radians (frames 2).
    """
    bones = motion[:, TOES] - motion[:, ANKLES]
    yaw = np.unwrap(np.arctan2(bones[..., 0], bones[..., 2]), axis=0)
    wanted = np.concatenate([motion[:, TOES], yaw[..., None]], axis=-1)
    swings = _planned(wanted, motion[:, Joint.PELVIS], fps)
    feet = [_way(wanted[:, foot], swings[foot], fps, keep_last=keep_last) for foot in (0, 1)]
    return np.stack([way for way, _ in feet], axis=1), np.stack([roll for _, roll in feet], axis=1)


def _own_swings(toe: Float[np.ndarray, "frames 3"], pelvis: Float[np.ndarray, "frames 3"], fps: float) -> list[Swing]:
    """Find when the network swings a foot: it is quicker than the body for a while, and gets somewhere."""
    n = len(toe)
    ways = [np.linalg.norm(np.diff(points[:, ::2], axis=0), axis=1) for points in (toe, pelvis)]
    speed, body = (np.convolve(way * fps, (0.25, 0.5, 0.25))[1:-1] for way in ways)
    moves = (speed > _STILL) | (np.minimum(toe[1:, 1], toe[:-1, 1]) > 1.5 * _HIGHEST)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], speed > np.maximum(_QUICK, 1.2 * body), [False]])))
    swings: list[Swing] = []
    for start, stop in edges.reshape(-1, 2).tolist():
        # The slow begin and end of the swing, three frames at most.
        start -= next((k for k in range(3) if start - k < 1 or not moves[start - k - 1]), 3)
        stop += next((k for k in range(3) if stop + k >= n - 1 or not moves[stop + k]), 3)
        if swings and start <= swings[-1].stop + 1:
            start = swings.pop().start
        swings.append(Swing(start, stop, (start, stop)))
    # Of a foot that is on its way for long, the time in which it gets farthest.
    longest = round(_LONGEST_SWING * fps)
    length = round(SWING * fps)
    for k, swing in enumerate(swings):
        if swing.stop - swing.start > longest:
            gone = np.cumsum(speed[swing.start : swing.stop])
            start = swing.start + int(np.argmax(gone[length:] - gone[:-length])) + 1
            swings[k] = Swing(start, start + length, (start, start + length))
    if toe[0, 1] > 2 * _HIGHEST:
        # A foot that is high in the first frame is in the air, however slow.
        low = int(np.argmax(np.append(toe[:length, 1] < 2 * _HIGHEST, True)))
        stop = min(max([low, *(s.stop for s in swings if s.start == 0)]), n - 1)
        swings = [Swing(0, stop, (0, stop)), *(s for s in swings if s.start > stop)]
    return [s for s in swings if s.start == 0 or np.hypot(*(toe[s.stop] - toe[s.start])[::2]) >= _SHUFFLE]


def _planned(
    wanted: Float[np.ndarray, "frames 2 4"], pelvis: Float[np.ndarray, "frames 3"], fps: float
) -> list[list[Swing]]:
    """Plan the swings of both feet, from the first frame on; one foot at a time leaves the floor."""
    n = len(wanted)
    length = max(round(SWING * fps), 2)
    own = [_own_swings(wanted[:, foot, :3], pelvis, fps) for foot in (0, 1)]
    swings: list[list[Swing]] = [[], []]
    frame = 0
    while frame < n - _END * fps:
        ready = [foot for foot in (0, 1) if not swings[foot] or frame - swings[foot][-1].stop >= _REST * fps]
        lags = [_lag(wanted[:, foot], swings[foot], frame, length) if foot in ready else 0.0 for foot in (0, 1)]
        foot = int(np.argmax(lags))
        # Of two feet that move in the first frame, the one in the air goes on.
        due = [(s.start, -wanted[0, k, 1], k, s) for k in ready for s in own[k] if s.start <= frame < s.stop - 1]
        waits = [any(frame < s.start < frame + length for s in own[side]) for side in (0, 1)]
        urgent = lags[foot] > _URGENT and not waits[foot]
        if due and (not urgent or min(due)[2] == foot):
            *_, foot, swing = min(due)
            own[foot].remove(swing)
            shortest = _SHORTEST_SWING * fps if frame else 2
            stop = min(max(swing.stop, frame + round(shortest)), n - 1)
            swings[foot].append(Swing(frame, stop, swing.own))
        elif urgent or (lags[foot] > 1 and not any(waits)):
            swings[foot].append(Swing(frame, min(frame + length, n - 1)))
        else:
            frame += 1
            continue
        frame = swings[foot][-1].stop
    return swings


def _lag(wanted: Poses, swings: list[Swing], frame: int, length: int) -> float:
    """How far a standing foot is away from where and how it ought to be, as a share of what it may be.

    A swing is half over when the foot is where it ought to be, so it starts half its time before.
    """
    place = _stance(wanted, swings, len(swings), length)
    away = wanted[min(frame + length // 2, len(wanted) - 1)] - place
    return float(max(np.hypot(away[0], away[2]) / LAG, abs(away[3]) / _TURN))


def _stance(wanted: Poses, swings: list[Swing], k: int, length: int) -> Float[np.ndarray, "4"]:
    """Return the pose of a foot after its first ``k`` swings: the mean of the wanted ones for a while."""
    if k == 0:
        return wanted[0]
    first = min(swings[k - 1].stop, len(wanted) - 1)
    last = min(swings[k].start, first + length) if k < len(swings) else first + length
    return wanted[first : max(last, first + 1)].mean(axis=0)


def _way(wanted: Poses, swings: list[Swing], fps: float, *, keep_last: bool) -> tuple[Poses, np.ndarray]:
    """Return a foot's way, and by how much its pitch is raised."""
    n = len(wanted)
    frames = np.arange(n)
    length = max(round(SWING * fps), 2)
    poses = np.stack([_stance(wanted, swings, k, length) for k in range(len(swings) + 1)])
    poses[:, 1] = np.clip(poses[:, 1], 0, _HIGHEST)
    if keep_last and swings:
        poses[-1, [0, 2, 3]] = wanted[-1, [0, 2, 3]]
    way = np.repeat(poses[:1], n, axis=0)
    roll = np.zeros(n)
    for k, swing in enumerate(swings):
        flies = slice(swing.start, swing.stop + 1)
        share = (frames[flies] - swing.start) / (swing.stop - swing.start)
        source = poses[k] if swing.start else wanted[0]
        gone = _eased(share)[:, None]
        if swing.own is None:
            path = source + gone * (poses[k + 1] - source)
            before = round(_REST * fps)
            rise = np.clip((frames - swing.start + before) / (swing.stop - swing.start + before), 0, 1)
            roll += _ROLL * np.sin(np.pi * rise) ** 2
        else:
            # The network's own swing, laid between the places on which the foot stands.
            first, last = swing.own
            when = first + share * (last - first)
            path = np.stack([np.interp(when, frames, values) for values in wanted.T], axis=1)
            path += (1 - gone) * (source - path[0]) + gone * (poses[k + 1] - path[-1])
        step = np.hypot(*(poses[k + 1] - source)[:3:2])
        lift = (_LIFT + _LIFT_SLOPE * step) * (1 - (2 * share - 1) ** 4)
        path[:, 1] = np.maximum(path[:, 1], source[1] + (poses[k + 1, 1] - source[1]) * share + lift)
        way[flies] = path
        way[swing.stop :] = poses[k + 1]
    if keep_last and not swings:
        way += _eased(frames / max(n - 1, 1))[:, None] * (wanted[-1] - wanted[0]) * [1, 0, 1, 1]
    # A body that turns faster than it can step turns its feet on the floor.
    way[:, 3] = np.clip(way[:, 3], wanted[:, 3] - _TWIST, wanted[:, 3] + _TWIST)
    # The heights of given frames fade out; in motions that are shorter than that, until the other end.
    fading = np.clip(1 - frames / max(min(_RETURN * fps, n - 1), 1), 0, 1)
    way[:, 1] += fading * (wanted[0, 1] - way[0, 1])
    if keep_last:
        way[:, 1] += fading[::-1] * (wanted[-1, 1] - way[-1, 1])
    return way, roll


def _eased(share: np.ndarray) -> np.ndarray:
    """Least jerk from 0 to 1 (Flash and Hogan 1985)."""
    return share**3 * (10 - 15 * share + 6 * share**2)
