"""DART in NumPy and float64, written from docs/specification/dart.md alone: what the tests compare our networks with.

Axes are (batch, token or frame, number); parameters come by the names of our modules, everything else is written out.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.nn import Module

from prbench_adapters.dart.model import DartModel

HISTORY, FUTURE = 2, 8
PARTS = (3, 132, 3, 6, 66, 66)
"""transl, poses_6d, transl_delta, global_orient_delta_6d, joints, joints_delta."""
LEFT_HIP, RIGHT_HIP = 1, 2

Parameters = dict[str, np.ndarray]


def parameters(network: Module) -> Parameters:
    """All parameters of a network, float64."""
    return {name: parameter.detach().double().numpy() for name, parameter in network.named_parameters()}


def linear(x, p, name):
    return x @ p[f"{name}.weight"].T + p[f"{name}.bias"]


def norm(x, p, name):
    centred = x - x.mean(-1, keepdims=True)
    return centred / np.sqrt(centred.var(-1, keepdims=True) + 1e-5) * p[f"{name}.weight"] + p[f"{name}.bias"]


def gelu(x):
    return 0.5 * x * (1.0 + torch.erf(torch.as_tensor(x / math.sqrt(2.0))).numpy())


def attention(x, p, name, heads):
    batch, n, width = x.shape
    query, key, value = (
        part.reshape(batch, n, heads, -1).swapaxes(1, 2)
        for part in np.split(linear(x, p, f"{name}.query_key_value"), 3, axis=-1)
    )
    scores = query @ key.swapaxes(2, 3) / math.sqrt(width // heads)
    weights = np.exp(scores - scores.max(-1, keepdims=True))
    looked = (weights / weights.sum(-1, keepdims=True)) @ value
    return linear(looked.swapaxes(1, 2).reshape(batch, n, width), p, f"{name}.output")


def layer(x, p, name, heads):
    """Post-norm."""
    x = norm(x + attention(x, p, f"{name}.self_attention", heads), p, f"{name}.self_attention_norm")
    forward = linear(gelu(linear(x, p, f"{name}.feed_forward.expand")), p, f"{name}.feed_forward.contract")
    return norm(x + forward, p, f"{name}.feed_forward_norm")


def skip_transformer(x, p, name, heads, layers):
    """As many layers in front of the middle one as behind; each of these sees its counterpart's output, last first."""
    seen = []
    for i in range(layers // 2):
        x = layer(x, p, f"{name}.input_layers.{i}", heads)
        seen.append(x)
    x = layer(x, p, f"{name}.middle_layer", heads)
    for i in range(layers // 2):
        joined = linear(np.concatenate([x, seen[-1 - i]], axis=-1), p, f"{name}.joins.{i}")
        x = layer(joined, p, f"{name}.output_layers.{i}", heads)
    return norm(x, p, f"{name}.norm")


def encode(p, history, future, *, heads, layers):
    """Two learned distribution tokens, then the frames: mean and log-variance within ±10."""
    frames = linear(np.concatenate([history, future], axis=1), p, "frame_embedding")
    tokens = np.broadcast_to(p["distribution_tokens"], (len(frames), *p["distribution_tokens"].shape))
    stream = np.concatenate([tokens, frames], axis=1) + p["encoder_positions"]
    found = linear(skip_transformer(stream, p, "encoder", heads, layers)[:, :2], p, "encoder_head")
    return found[:, :1], np.clip(found[:, 1:], -10, 10)


def decode(p, latent, history, *, heads, layers):
    """Latent, history, F zero queries; the last F outputs."""
    latent, history = linear(latent, p, "latent_embedding"), linear(history, p, "frame_embedding")
    queries = np.zeros((len(latent), FUTURE, latent.shape[-1]))
    stream = np.concatenate([latent, history, queries], axis=1) + p["decoder_positions"]
    return linear(skip_transformer(stream, p, "decoder", heads, layers)[:, -FUTURE:], p, "decoder_head")


def sinusoid(position, width):
    angle = position / 10000.0 ** (np.arange(0, width, 2) / width)
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1).reshape(width)


def denoiser(p, noisy, step, text, history, *, heads, layers):
    """Tokens: time, text, two frames of history, noisy latent; the last one's output."""
    width = len(p["head.weight"][0])
    hidden = linear(sinusoid(step, width), p, "time_embedding.0")
    time = linear(hidden / (1.0 + np.exp(-hidden)), p, "time_embedding.2")
    tokens = [
        np.broadcast_to(time, (len(noisy), 1, width)),
        linear(text, p, "text_embedding")[:, None],
        linear(history, p, "history_embedding"),
        linear(noisy, p, "latent_embedding"),
    ]
    x = np.concatenate(tokens, axis=1) + np.stack([sinusoid(place, width) for place in range(3 + HISTORY)])
    for i in range(layers):
        x = layer(x, p, f"layers.{i}", heads)
    return linear(x[:, -1:], p, "head")


def guided(p, noisy, step, text, history, scale, **sizes):
    told = denoiser(p, noisy, step, text, history, **sizes)
    untold = denoiser(p, noisy, step, np.zeros_like(text), history, **sizes)
    return untold + scale * (told - untold)


def kept(steps):
    """ᾱ after each step of the cosine schedule; β at most 0.999."""
    level = np.cos((np.arange(steps + 1) / steps + 0.008) / 1.008 * math.pi / 2) ** 2
    return np.cumprod(1.0 - np.minimum(1.0 - level[1:] / level[:-1], 0.999))


def ddim(clean_of, noise, steps):
    """η = 0 with all steps."""
    levels, x = kept(steps), noise
    for t in reversed(range(steps)):
        clean = clean_of(x, t)
        epsilon = (x - math.sqrt(levels[t]) * clean) / math.sqrt(1.0 - levels[t])
        cleaner = levels[t - 1] if t else 1.0
        x = math.sqrt(cleaner) * clean + math.sqrt(1.0 - cleaner) * epsilon
    return x


def ddpm(clean_of, noises, steps):
    """Ancestral sampling with the small variance; ``noises``: start, then one a step but the last."""
    levels, x = kept(steps), noises[0]
    for place, t in enumerate(reversed(range(steps)), start=1):
        clean, cleaner = clean_of(x, t), levels[t - 1] if t else 1.0
        beta = 1.0 - levels[t] / cleaner
        mean = beta * math.sqrt(cleaner) * clean + (1.0 - cleaner) * math.sqrt(1.0 - beta) * x
        x = mean / (1.0 - levels[t])
        if t:
            x = x + math.sqrt(beta * (1.0 - cleaner) / (1.0 - levels[t])) * noises[place]
    return x


def rows6(matrix):
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def matrix(six):
    """Gram-Schmidt of the two rows."""
    first = six[..., :3] / np.linalg.norm(six[..., :3], axis=-1, keepdims=True)
    second = six[..., 3:] - (first * six[..., 3:]).sum(-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-2)


def canonical(features):
    """Features (metres) seen from their first frame, and where that stands: x to the right, z up, y to the front."""
    transl, poses, step, turn, joints, moves = np.split(features, np.cumsum(PARTS)[:-1], axis=-1)
    batch, frames = features.shape[:2]
    joints, moves = joints.reshape(batch, frames, 22, 3), moves.reshape(batch, frames, 22, 3)
    right = (joints[:, 0, RIGHT_HIP] - joints[:, 0, LEFT_HIP]) * [1, 1, 0]
    right = right / np.linalg.norm(right, axis=-1, keepdims=True)
    up = np.broadcast_to([0.0, 0.0, 1.0], right.shape)
    rotation = np.stack([right, np.cross(up, right), up], axis=-1)  # columns: world directions of its axes
    origin = joints[:, 0, 0]
    back = rotation.swapaxes(1, 2)[:, None]

    def turned(vectors):
        return np.einsum("bij,bf...j->bf...i", rotation.swapaxes(1, 2), vectors)

    orientation = back @ matrix(poses[..., :6])
    turn = back @ matrix(turn) @ rotation[:, None]
    parts = (
        turned(transl - origin[:, None]),
        rows6(orientation),
        poses[..., 6:],
        turned(step),
        rows6(turn),
        turned(joints - origin[:, None, None]).reshape(batch, frames, 66),
        turned(moves).reshape(batch, frames, 66),
    )
    return np.concatenate(parts, axis=-1), rotation, origin


class Model:
    """The two networks of a model with its statistics."""

    def __init__(self, model: DartModel) -> None:
        c = model.configuration
        self.vae, self.denoiser = parameters(model.vae), parameters(model.denoiser)
        self.mean, self.std = (each.double().numpy() for each in (model.scaling.mean, model.scaling.std))
        self.latent_std, self.steps = model.latent_std, c.diffusion_steps
        self.vae_sizes = {"heads": c.vae_heads, "layers": c.vae_layers}
        self.sizes = {"heads": c.heads, "layers": c.layers}

    def roll_out(self, noise, history, rotation, origin, text, scale):
        """World joints (batch, P·F, 22, 3) of noise (P, batch, 1, latent) from a history in metres and its place."""
        history, done = (history - self.mean) / self.std, []
        for of_primitive in noise:
            given = history

            def clean_of(x, t, given=given):
                return guided(self.denoiser, x, t, text, given, scale, **self.sizes)

            latent = ddim(clean_of, of_primitive, self.steps) * self.latent_std
            future = decode(self.vae, latent, history, **self.vae_sizes) * self.std + self.mean
            joints = future[..., 144:210].reshape(len(future), FUTURE, 22, 3)
            done.append(np.einsum("bij,bfkj->bfki", rotation, joints) + origin[:, None, None])
            history, inner, place = canonical(future[:, -HISTORY:])
            origin = origin + np.einsum("bij,bj->bi", rotation, place)
            rotation = rotation @ inner
            history = (history - self.mean) / self.std
        return np.concatenate(done, axis=1)


def huber(error):
    """δ = 1, mean over all but the first axis."""
    size = np.abs(error)
    return np.where(size <= 1.0, 0.5 * size**2, size - 0.5).reshape(len(error), -1).mean(1)


def adam(gradient_of, start, *, iterations, rate=0.05):
    """Adam with its usual numbers and a rate that falls linearly; the gradient of each primitive has length 1."""
    x, first, second = start.copy(), np.zeros_like(start), np.zeros_like(start)
    for i in range(iterations):
        g = gradient_of(x)
        g = g / np.maximum(np.sqrt((g**2).sum((2, 3), keepdims=True)), 1e-6)
        first, second = 0.9 * first + 0.1 * g, 0.999 * second + 0.001 * g**2
        corrected = np.sqrt(second / (1.0 - 0.999 ** (i + 1))) + 1e-8
        x = x - rate * (1.0 - i / iterations) * first / (1.0 - 0.9 ** (i + 1)) / corrected
    return x
