"""The U-Net of docs/specification/gmd.md#networks in NumPy and float64, for one motion: arrays (channels, frames)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
