"""Invented heads that look here and there, and what glasses and suit say of them: tracks with a known X and clocks."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from prbench.alignment.align import Alignment
from prbench.randomness import named_generator
from prbench.recording import PoseStream

RATE = 240.0
START = 5000.0  # s on the glasses' clock
OFFSET = 37.123  # s that the suit's clock is ahead of it at the start


def head(seconds: float, name: str, *, about=(35.0, 15.0, 5.0)) -> tuple[np.ndarray, Rotation, np.ndarray]:
    """Times, rotations and positions of a head; ``about`` spreads its looks in yaw, pitch and roll, degrees."""
    rng = named_generator("test-align", name)
    times = np.arange(int(seconds * RATE) + 1) / RATE
    angles = np.zeros((len(times), 3))
    begin = 0.0
    while begin < seconds:
        duration = rng.uniform(0.25, 0.9)
        look = rng.normal(0.0, about)
        share = np.clip((times - begin) / duration, 0.0, 1.0)[:, None]
        angles += (look - angles[-1]) * share**3 * (10 - 15 * share + 6 * share**2)
        begin += duration + 0.1 + rng.exponential(1.2)
    noise = gaussian_filter1d(rng.normal(size=(len(times), 3)), 0.3 * RATE, axis=0)
    turned = Rotation.from_euler("ZYX", angles + 2 * noise * np.array(about), degrees=True)
    walked = gaussian_filter1d(np.cumsum(rng.normal(size=(len(times), 3)), axis=0), RATE, axis=0) / RATE
    walked[:, 2] += 0.02 * np.sin(12 * times)
    return times, turned, walked + turned.apply([0.08, 0.0, 0.1])


def mounting(name: str) -> np.ndarray:
    """X (4 x 4): coordinates of the head to those of the glasses."""
    rng = named_generator("test-align-mounting", name)
    x = np.eye(4)
    x[:3, :3] = Rotation.random(rng=rng).as_matrix()
    x[:3, 3] = rng.uniform(-0.12, 0.12, 3)
    return x


def tracks(
    seconds: float = 90.0,
    name: str = "someone",
    *,
    noise: tuple[float, float] = (0.05, 0.01),
    rate: float = 0.0,
    slip: tuple[float, tuple[float, ...], tuple[float, ...]] | None = None,
    glasses_of: str | None = None,
    **looks,
) -> tuple[PoseStream, PoseStream]:
    """Glasses (1 kHz) and suit (240 Hz) on one head.

    Args:
        noise: Degrees on each pose of suit and glasses.
        rate: Seconds that the suit's clock gains each second.
        slip: Second, rotation vector (degrees) and translation (m) by which X changes.
        glasses_of: Name of another head that wears the glasses.
    """
    rng = named_generator("test-align-noise", name)
    times, turned, position = head(seconds, name, **looks)
    worn = (turned, position) if glasses_of is None else head(seconds, glasses_of, **looks)[1:]
    at = np.arange(0.0, times[-1], 1e-3)
    on_head = Slerp(times, worn[0])(at)
    x = np.tile(mounting(name), (len(at), 1, 1))
    if slip is not None:
        x[at >= slip[0], :3, :3] = Rotation.from_rotvec(slip[1], degrees=True).as_matrix() @ x[0, :3, :3]
        x[at >= slip[0], :3, 3] += slip[2]
    glasses = on_head * Rotation.from_matrix(x[:, :3, :3]).inv()
    where = np.stack([np.interp(at, times, axis) for axis in worn[1].T], axis=1) - glasses.apply(x[:, :3, 3])
    world = Rotation.from_euler("xz", [10, 140], degrees=True)
    shaken = [
        (each * Rotation.from_rotvec(size * rng.normal(size=(len(each), 3)), degrees=True)).as_quat(scalar_first=True)
        for each, size in ((world * glasses, noise[1]), (turned, noise[0]))
    ]
    on_suit = times + START + OFFSET + rate * times
    valid = np.ones(len(at), dtype=bool)
    device = PoseStream(at + START, world.apply(where) + np.array([3, -2, 0.4]), shaken[0], valid)
    return device, PoseStream(on_suit, position, shaken[1], np.ones(len(times), dtype=bool))


def errors(found: Alignment, x: np.ndarray) -> tuple[float, float]:
    """Degrees and metres between what was found and the truth."""
    assert found.device_from_segment is not None, found.refused
    apart = np.linalg.inv(x) @ np.array(found.device_from_segment)
    return float(np.rad2deg(Rotation.from_matrix(apart[:3, :3]).magnitude())), float(np.linalg.norm(apart[:3, 3]))
