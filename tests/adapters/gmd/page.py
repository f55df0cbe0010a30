"""docs/specification/gmd.md in NumPy and float64, read sentence by sentence: what the tests compare the method with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

A_THOUSAND = 1000
GUIDED_FROM, LINE_FROM = 20, 100


def alphas_cumprod(steps: int) -> np.ndarray:
    """ᾱ of the cosine schedule, with a 1 in front: ᾱ of t stands at t + 1."""
    level = np.cos((np.arange(steps + 1) / steps + 0.008) / 1.008 * np.pi / 2) ** 2
    return np.concatenate([[1.0], np.cumprod(1 - np.minimum(1 - level[1:] / level[:-1], 0.999))])


@dataclass(frozen=True)
class Posterior:
    """Of x_{t-1}, given x_t and the clean signal."""

    clean: float
    noisy: float
    variance: float

    @classmethod
    def at(cls, t: int, steps: int) -> Posterior:
        """β̃ = β (1 - ᾱ') / (1 - ᾱ) with ᾱ' of the step before, and the factors of the mean."""
        before, now = alphas_cumprod(steps)[t : t + 2]
        beta = 1 - now / before
        return cls(
            beta * np.sqrt(before) / (1 - now),
            (1 - before) * np.sqrt(1 - beta) / (1 - now),
            beta * (1 - before) / (1 - now),
        )


@dataclass(frozen=True)
class Keyframes:
    """Pelvis (x, z) in metres, by frame."""

    at: dict[int, tuple[float, float]]

    def line(self, frames: int) -> dict[int, np.ndarray]:
        """From the origin at frame 0 straight to each keyframe in turn, up to the last."""
        known = {0: (0.0, 0.0), **self.at}
        places = sorted(known)
        x, z = (np.interp(np.arange(frames), places, [known[n][axis] for n in places]) for axis in (0, 1))
        return {n: np.array([x[n], z[n]]) for n in range(max(self.at) + 1)}

    def gradient(self, root: np.ndarray) -> np.ndarray:
        """Of the mean absolute error over both coordinates of all keyframes."""
        found = np.zeros_like(root)
        for n, wanted in self.at.items():
            found[n] = np.sign(root[n] - wanted) / (2 * len(self.at))
        return found


@dataclass(frozen=True)
class Stage:
    """What both stages share: T, the linear network, statistics, weight and clamp of the goal."""

    steps: int
    over_frames: np.ndarray
    over_columns: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    scale: float = 100.0
    most: float = 6.0

    def reached(self, t: int, limit: int) -> bool:
        """Whether t is at or above a limit that is given for 1000 steps."""
        return t * A_THOUSAND >= limit * self.steps

    def network(self, x: np.ndarray) -> np.ndarray:
        """M x K."""
        return self.over_frames @ x @ self.over_columns

    def back(self, gradient: np.ndarray) -> np.ndarray:
        """What a gradient at the network's output is at its input."""
        return self.over_frames.T @ gradient @ self.over_columns.T

    def standardised(self, xz: np.ndarray) -> np.ndarray:
        """Columns 1 and 2."""
        return (xz - self.mean[1:3]) / self.std[1:3]

    def goal_gradient(self, clean: np.ndarray, keyframes: Keyframes) -> np.ndarray:
        """Of the goal with respect to standardised clean features."""
        found = np.zeros_like(clean)
        found[:, 1:3] = keyframes.gradient(clean[:, 1:3] * self.std[1:3] + self.mean[1:3]) * self.std[1:3]
        return found


def trajectory(stage: Stage, keyframes: Keyframes, draws: list[np.ndarray]) -> np.ndarray:
    """Stage 1; ``draws`` in the order in which they are needed: start, then noise and imputation of every step."""
    remaining = iter(draws)
    x = next(remaining)
    levels, line = alphas_cumprod(stage.steps), keyframes.line(len(x))
    for t in reversed(range(stage.steps)):
        before, now, posterior = levels[t], levels[t + 1], Posterior.at(t, stage.steps)
        estimate = (x - np.sqrt(1 - now) * stage.network(x)) / np.sqrt(now)
        clean = np.clip(estimate, -stage.most, stage.most)
        mean = posterior.clean * clean + posterior.noisy * x
        if stage.reached(t, GUIDED_FROM):
            inner = np.where(np.abs(estimate) < stage.most, stage.goal_gradient(clean, keyframes), 0.0)
            gradient = (inner - np.sqrt(1 - now) * stage.back(inner)) / np.sqrt(now)
            mean = mean - posterior.variance * stage.scale * gradient
        x = mean + np.sqrt(posterior.variance) * next(remaining) if t else mean
        fresh = next(remaining)
        for n, xz in (line if stage.reached(t, LINE_FROM) else keyframes.at).items():
            target = stage.standardised(np.asarray(xz))
            x[n, 1:3] = np.sqrt(before) * target + np.sqrt(1 - before) * fresh[n, 1:3]
    return x * stage.std + stage.mean


def motion(stage: Stage, projection: np.ndarray, followed: np.ndarray, draws: list[np.ndarray]) -> np.ndarray:
    """Stage 2 on projected features: every frame of the trajectory (frames, 2) is a keyframe."""
    remaining, inverse = iter(draws), np.linalg.inv(projection)
    x = next(remaining)
    keyframes = Keyframes({n: tuple(xz) for n, xz in enumerate(followed)})
    for t in reversed(range(stage.steps)):
        posterior, clean = Posterior.at(t, stage.steps), stage.network(x)
        guided = posterior.clean * clean + posterior.noisy * x
        if stage.reached(t, GUIDED_FROM):
            gradient = stage.back(stage.goal_gradient(clean @ inverse, keyframes) @ inverse.T)
            guided = guided - posterior.variance * stage.scale * gradient
        overwritten = clean @ inverse
        overwritten[:, 1:3] = stage.standardised(followed)
        imputed = posterior.clean * (overwritten @ projection) + posterior.noisy * x
        combined = guided @ inverse
        combined[:, 1:3] = (imputed @ inverse)[:, 1:3]
        guided = combined @ projection
        x = guided + np.sqrt(posterior.variance) * next(remaining) if t else guided
    return x @ inverse * stage.std + stage.mean


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton's product of (…, 4), real part first."""
    real = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(-1, keepdims=True)
    return np.concatenate(
        [real, p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])], -1
    )


def back_turned(half_turn: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (frames, …, 3) turned by the conjugate of (cos a, 0, sin a, 0)."""
    a = half_turn.reshape(-1, *[1] * (vectors.ndim - 2))
    zero = np.zeros_like(a)
    turn = np.stack([np.cos(a), zero, np.sin(a), zero], -1)
    conjugate = turn * (1, -1, -1, -1)
    pure = np.concatenate([np.zeros_like(vectors[..., :1]), vectors], -1)
    return quaternion_product(quaternion_product(conjugate, pure), turn)[..., 1:]


def absolute_root(features: np.ndarray) -> np.ndarray:
    """Heading, x and z of each frame, from the steps of relative features (docs/specification/humanml3d.md#inverse)."""
    half_turn = np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    steps = np.stack([features[:-1, 1], np.zeros(len(features) - 1), features[:-1, 2]], -1)
    places = np.concatenate([np.zeros((1, 3)), np.cumsum(back_turned(half_turn[1:], steps), axis=0)])
    return np.column_stack([half_turn, places[:, 0], places[:, 2]])


def joints(absolute: np.ndarray) -> np.ndarray:
    """The conjugate of the heading turns the local positions; (x, z) is added; the pelvis is at (x, height, z)."""
    local = back_turned(absolute[:, 0], absolute[:, 4:67].reshape(-1, 21, 3))
    local[..., 0] += absolute[:, 1, None]
    local[..., 2] += absolute[:, 2, None]
    return np.concatenate([absolute[:, None, [1, 3, 2]], local], axis=1)


GROUPS = 8
Weights = Mapping[str, np.ndarray]


def predicted(
    weights: Weights, x: np.ndarray, t: int, text: np.ndarray, *, frames: int, levels: int, steps: int
) -> np.ndarray:
    """What the network says of (frames, channels): padded with zeros to ``frames``, the output cut back."""
    size = weights["time_embedding.0.weight"].shape[1]
    condition = linear(weights, "time_embedding.2", silu(linear(weights, "time_embedding.0", sinusoid(t, size))))
    condition = condition + linear(weights, "text_embedding", text)
    condition = linear(weights, "condition.2", mish(linear(weights, "condition.0", condition)))
    stream = np.pad(x.T, ((0, 0), (0, frames - len(x))))
    skips = []
    for level in range(levels):
        for block in range(2):
            stream = residual(weights, f"down.{level}.blocks.{block}", stream, condition)
        skips.append(stream)
        if level < levels - 1:
            stream = convolved(weights, f"down.{level}.resample", stream, padding=1, stride=2)
    for block in range(2):
        stream = residual(weights, f"middle.{block}", stream, condition)
    for level in range(levels - 1):
        stream = np.concatenate([stream, skips.pop()])
        for block in range(2):
            stream = residual(weights, f"up.{level}.blocks.{block}", stream, condition)
        stream = doubled(weights, f"up.{level}.resample", stream)
    stream = mish(normalised(weights, "head.0.norm", convolved(weights, "head.0.convolution", stream, padding=2)))
    return convolved(weights, "head.1", stream, padding=0)[:, : len(x)].T


def residual(weights: Weights, name: str, x: np.ndarray, condition: np.ndarray) -> np.ndarray:
    """conv5, group norm, scale and shift, Mish, conv5, group norm, Mish; a 1×1 skip where channels differ."""
    scale, shift = np.split(linear(weights, f"{name}.condition", mish(condition)), 2)
    inner = normalised(weights, f"{name}.first.norm", convolved(weights, f"{name}.first.convolution", x, padding=2))
    inner = mish(inner * (1 + scale[:, None]) + shift[:, None])
    inner = convolved(weights, f"{name}.second.convolution", inner, padding=2)
    inner = mish(normalised(weights, f"{name}.second.norm", inner))
    return inner + (convolved(weights, f"{name}.skip", x, padding=0) if f"{name}.skip.weight" in weights else x)


def convolved(weights: Weights, name: str, x: np.ndarray, *, padding: int, stride: int = 1) -> np.ndarray:
    """A convolution over time, zeros beyond both ends."""
    kernel = weights[f"{name}.weight"]
    padded = np.pad(x, ((0, 0), (padding, padding)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[2], axis=1)[:, ::stride]
    return np.einsum("oik,ifk->of", kernel, windows) + weights[f"{name}.bias"][:, None]


def doubled(weights: Weights, name: str, x: np.ndarray) -> np.ndarray:
    """The transposed convolution with kernel 4 and stride 2: frame n adds to the frames 2 n - 1 to 2 n + 2."""
    kernel = weights[f"{name}.weight"]
    out = np.zeros((kernel.shape[1], 2 * x.shape[1] + 2))
    for n in range(x.shape[1]):
        out[:, 2 * n : 2 * n + 4] += np.einsum("i,iok->ok", x[:, n], kernel)
    return out[:, 1:-1] + weights[f"{name}.bias"][:, None]


def normalised(weights: Weights, name: str, x: np.ndarray) -> np.ndarray:
    """Group normalisation: eight groups of channels, over all frames."""
    groups = x.reshape(GROUPS, -1)
    groups = (groups - groups.mean(1, keepdims=True)) / np.sqrt(groups.var(1, keepdims=True) + 1e-5)
    return groups.reshape(x.shape) * weights[f"{name}.weight"][:, None] + weights[f"{name}.bias"][:, None]


def linear(weights: Weights, name: str, x: np.ndarray) -> np.ndarray:
    """W x + b."""
    return weights[f"{name}.weight"] @ x + weights[f"{name}.bias"]


def sinusoid(t: int, size: int) -> np.ndarray:
    """Of the step: sine and cosine in turn."""
    angle = t * 10000.0 ** (-np.arange(0, size, 2) / size)
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1).ravel()


def mish(x: np.ndarray) -> np.ndarray:
    """x tanh(ln(1 + eˣ))."""
    return x * np.tanh(np.logaddexp(0, x))


def silu(x: np.ndarray) -> np.ndarray:
    """x / (1 + e⁻ˣ)."""
    return x / (1 + np.exp(-x))
