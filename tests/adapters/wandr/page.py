"""WANDR in NumPy and float64, written from docs/specification/wandr.md alone: what the tests compare our network with.

One body at a time, joint by joint; only the order of the joints is taken from elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from torch.nn import Module

from prbench.geometry.skeleton import PARENTS

PELVIS, RIGHT_WRIST = 0, 21

Parameters = dict[str, np.ndarray]


@dataclass(frozen=True)
class Body:
    """State s: translation, and rotation matrices of root and joints relative to their parents."""

    translation: np.ndarray
    rotations: np.ndarray


def values_of(network: Module) -> Parameters:
    """All parameters and statistics of a network, float64."""
    return {name: value.detach().double().numpy() for name, value in network.state_dict().items()}


def stack(x: np.ndarray, values: Parameters, name: str, layers: int) -> np.ndarray:
    """Layers of Dropout (none at inference), LayerNorm, Linear, ReLU; the last without ReLU."""
    for layer in range(layers):
        normed, linear = f"{name}.{4 * layer + 1}", f"{name}.{4 * layer + 2}"
        x = (x - x.mean()) / np.sqrt(x.var() + 1e-5) * values[f"{normed}.weight"] + values[f"{normed}.bias"]
        x = values[f"{linear}.weight"] @ x + values[f"{linear}.bias"]
        if layer < layers - 1:
            x = np.maximum(x, 0.0)
    return x


def standardised(x: np.ndarray, values: Parameters, name: str) -> np.ndarray:
    return (x - values[f"{name}.mean"]) / (values[f"{name}.std"] + 1e-5)


def undone(x: np.ndarray, values: Parameters, name: str) -> np.ndarray:
    return x * (values[f"{name}.std"] + 1e-5) + values[f"{name}.mean"]


def six(rotation: np.ndarray) -> np.ndarray:
    """First two rows."""
    return rotation[:2].reshape(6)


def rotation_of(numbers: np.ndarray) -> np.ndarray:
    """Gram-Schmidt."""
    first = numbers[:3] / np.linalg.norm(numbers[:3])
    second = numbers[3:] - (numbers[3:] @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)))


def yaw_of(root: np.ndarray) -> np.ndarray:
    """R_z of the first of the intrinsic ZYX Euler angles."""
    return Rotation.from_euler("Z", Rotation.from_matrix(root).as_euler("ZYX")[0]).as_matrix()


def joints_of(body: Body, offsets: np.ndarray) -> np.ndarray:
    world, joints = [body.rotations[0]], [body.translation]
    for joint in range(1, 22):
        parent = PARENTS[joint]
        world.append(world[parent] @ body.rotations[joint])
        joints.append(joints[parent] + world[joint] @ offsets[joint])
    return np.stack(joints)


def seen(body: Body) -> np.ndarray:
    """x(s)."""
    without_yaw = yaw_of(body.rotations[0]).T @ body.rotations[0]
    return np.concatenate([body.translation[2:], six(without_yaw), *(six(turn) for turn in body.rotations[1:])])


def intention(
    body: Body,
    joints: np.ndarray,
    goal: np.ndarray,
    frames_left: int,
    fps: float,
    goal_heading: np.ndarray | None = None,
) -> np.ndarray:
    yaw = yaw_of(body.rotations[0])
    wrist = yaw.T @ (goal - joints[RIGHT_WRIST]) / (frames_left / fps + 1e-5)
    away = yaw.T @ (goal - joints[PELVIS])
    length = np.linalg.norm(away)
    pelvis = 2.0 * (1.0 - np.exp(-length)) * away / length
    pelvis[2] = 0.0
    if goal_heading is None:
        across = (goal - joints[PELVIS]) * (1.0, 1.0, 0.0)
        goal_heading = across / np.linalg.norm(across)
    return np.concatenate([wrist, pelvis, yaw.T @ (goal_heading + yaw[:, 1])])


def changed(body: Body, delta: np.ndarray) -> Body:
    turns = [rotation_of(numbers) for numbers in delta[3:].reshape(22, 6)]
    rotations = np.stack([rotation_of(six(old @ turn)) for old, turn in zip(body.rotations, turns, strict=True)])
    return Body(body.translation + yaw_of(body.rotations[0]) @ delta[:3], rotations)


def condition(body: Body, delta: np.ndarray, intended: np.ndarray, values: Parameters) -> np.ndarray:
    return np.concatenate([standardised(seen(body), values, "seen"), standardised(delta, values, "delta"), intended])


def roll_out(
    body: Body,
    delta: np.ndarray,
    offsets: np.ndarray,
    goal: np.ndarray,
    noise: np.ndarray,
    values: Parameters,
    *,
    layers: int,
    fps: float,
) -> np.ndarray:
    """Joints of the first frame and of as many as there is noise for; the goal is in the last."""
    joints = [joints_of(body, offsets)]
    for step, latent in enumerate(noise):
        intended = intention(body, joints[-1], goal, len(noise) - step, fps)
        known = condition(body, delta, intended, values)
        delta = undone(stack(np.concatenate([latent, known]), values, "decoder", layers), values, "delta")
        body = changed(body, delta)
        joints.append(joints_of(body, offsets))
        delta = np.concatenate([delta[:3], *(six(rotation_of(numbers)) for numbers in delta[3:].reshape(22, 6))])
    return np.stack(joints)
