"""Diffusion of windows as coefficients of a discrete cosine transform over their frames: GazeMoDiff and HumanMAC.

Source: docs/specification/prediction-networks.md. The transform, whitening, the encoder of what was observed with its
graph attention, the denoiser, and the sampling.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench.randomness import sequence_generator
from prbench_adapters.diffusion.denoiser import from_zero, sinusoid_table
from prbench_adapters.diffusion.generation import SequenceNoise
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.prediction.configuration import DiffusionConfiguration

Motion = Float[Tensor, "windows frames nodes 3"]  # Joints in metres, and perhaps a direction as the last node.
# DCT coefficients of each value; value = 3 · node + coordinate.
Coefficients = Float[Tensor, "windows coefficients values"]
Samples = Float[Tensor, "windows samples coefficients values"]
Stream = Float[Tensor, "windows samples coefficients width"]
Graph = Float[Tensor, "batch channels nodes steps"]
GraphLayer = Callable[[int, int, int, int], nn.Module]
Kept = Bool[Tensor, "windows samples"]
KeptWindows = Bool[Tensor, " windows"]
# What a stream is multiplied with for the scores of all heads, (windows, width, heads · coefficients), and the values,
# (windows, heads, coefficients, width / heads).
_Memory = tuple[Tensor, Tensor]
_SMALLEST = 1e-3  # metres; nothing below it matters, and half precision still holds it
_SLOPE = 0.2
_GAZE_CHANNELS = 32
_KERNEL = 3


class Whitening(nn.Module):
    """The principal directions of the values, and the spread along each of them in each coefficient.

    Args:
        coefficients: DCT coefficients of a window.
        values: Numbers of one coefficient.
    """

    def __init__(self, coefficients: int, values: int) -> None:
        super().__init__()
        self.register_buffer("directions", torch.eye(values))
        self.register_buffer("spread", torch.ones(coefficients, values))
        self.directions: Tensor  # column j is direction j
        self.spread: Tensor  # root mean square along each direction, metres

    @torch.no_grad()
    def take(self, coefficients: Coefficients) -> None:
        """Measure directions and spread on coefficients of training windows."""
        flat = coefficients.flatten(0, 1).double()
        directions = torch.linalg.eigh(flat.T @ flat / len(flat)).eigenvectors.flip(1)
        self.directions.copy_(directions)
        self.spread.copy_((coefficients.double() @ directions).square().mean(dim=0).sqrt().clamp_min(_SMALLEST))

    def forward(self, coefficients: Float[Tensor, "*batch coefficients values"]) -> Tensor:
        """Whiten coefficients."""
        # The inverse of what :meth:`inverse` uses: directions that were kept in half precision are not orthogonal.
        back = torch.linalg.inv(self.directions.double()).to(coefficients.dtype)
        return coefficients @ back.T / self.spread.to(coefficients.dtype)

    def inverse(self, whitened: Float[Tensor, "*batch coefficients values"]) -> Tensor:
        """Turn whitened coefficients back into metres."""
        return (whitened * self.spread.to(whitened.dtype)) @ self.directions.T.to(whitened.dtype)


def dct_rows(coefficients: int, frames: int) -> Float[Tensor, "coefficients frames"]:
    """Return the first rows of the orthonormal DCT-II, float64: w_k cos(π(i + ½)k / frames)."""
    row = torch.arange(coefficients, dtype=torch.float64)[:, None]
    place = torch.arange(frames, dtype=torch.float64)[None] + 0.5
    rows = math.sqrt(2.0 / frames) * torch.cos(math.pi * place * row / frames)
    rows[0] = math.sqrt(1.0 / frames)
    return rows


def padded(observed: Motion, frames: int) -> Tensor:
    """Return the observation, followed by copies of its last frame.

    Raises:
        ValueError: if it is longer than ``frames``.
    """
    n = observed.shape[1]
    if n > frames:
        raise ValueError(f"an observation of {n} frames does not fit into a window of {frames}")
    return torch.cat([observed, observed[:, -1:].expand(-1, frames - n, -1, -1)], dim=1)


def held(observed: Motion, valid: Bool[Tensor, "windows frames"]) -> Motion:
    """Replace the last node where it was not measured by the last measured one before it, at the start by the first.

    Raises:
        ValueError: if a window has no measured direction.
    """
    if not bool(valid.any(dim=1).all()):
        window = int((~valid.any(dim=1)).nonzero()[0])
        raise ValueError(f"window {window} of the batch has no valid gaze in any observed frame")
    last = torch.where(valid, torch.arange(valid.shape[1], device=valid.device), -1).cummax(dim=1).values
    source = torch.where(last < 0, valid.to(torch.int8).argmax(dim=1, keepdim=True), last)
    gaze = observed[torch.arange(len(valid), device=valid.device)[:, None], source, -1]
    return torch.cat([observed[:, :, :-1], gaze[:, :, None]], dim=2)


class WindowDCT(nn.Module):
    """The transform of windows of one length, and the completion of a window by what was observed of it.

    Args:
        coefficients: How many are kept, L.
        observed: Frames that are known.
        frames: Number of frames of the whole window.
    """

    def __init__(self, coefficients: int, observed: int, frames: int) -> None:
        super().__init__()
        rows = dct_rows(coefficients, frames)
        self.register_buffer("rows", rows, persistent=False)
        # Back to frames, the observed ones only, and forth again: L by L numbers.
        self.register_buffer("observed_share", rows[:, :observed] @ rows[:, :observed].T, persistent=False)
        self.rows: Tensor
        self.observed_share: Tensor

    def forward(self, motion: Float[Tensor, "*batch frames nodes 3"]) -> Tensor:
        """Return the first coefficients of each value."""
        return self.rows.to(motion.dtype) @ motion.flatten(-2)

    def inverse(self, coefficients: Float[Tensor, "*batch coefficients values"]) -> Tensor:
        """Return the motion that these coefficients describe; not the original one, whose faster parts are lost."""
        return (self.rows.T.to(coefficients.dtype) @ coefficients).unflatten(-1, (-1, 3))

    def completed(self, coefficients: Tensor, known: Tensor) -> Tensor:
        """Coefficients of the motion whose observed frames are those of ``known``, and the others its own.

        The published programs go back to frames, exchange the observed ones, and transform again. All three are
        linear: x + (D_H D_Hᵀ)(known - x) with the columns D_H of the observed frames.
        """
        return coefficients + self.observed_share.to(coefficients.dtype) @ (known - coefficients)


class GraphAttention(nn.Module):
    """Attention over steps, a change of channels, attention over nodes, and a bias for each step.

    A score is a dot product of weights with two tokens behind one another, which is the sum of a dot product with
    each: pairs of tokens are never made.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
        nodes: Number of nodes of the graph.
        steps: Length of each node's sequence.
        heads: Sets of attention weights, which are averaged.
        leaky: LeakyReLU on what is aggregated over steps, and over nodes.
    """

    def __init__(self, inputs: int, outputs: int, nodes: int, steps: int, heads: int, leaky: bool = False) -> None:
        super().__init__()
        self.activation = nn.LeakyReLU(_SLOPE) if leaky else nn.Identity()
        self.over_steps = nn.Parameter(torch.empty(heads, 2, inputs * nodes))
        """For the token that looks and the token that is looked at."""
        self.channels = nn.Parameter(torch.empty(inputs, outputs))
        self.over_nodes = nn.Parameter(torch.empty(heads, 2, outputs * steps))
        self.bias = nn.Parameter(torch.empty(steps))
        bound = 1.0 / math.sqrt(outputs)
        for parameter in self.parameters():
            nn.init.uniform_(parameter, -bound, bound)

    def forward(self, stream: Graph) -> Tensor:
        """Apply to every graph by itself."""
        # Features of a step are ordered by node, those of a node by step; channels change fastest in both.
        weights = _attention(stream.permute(0, 3, 2, 1).flatten(2), self.over_steps)
        stream = self.activation(torch.einsum("bij,bcnj->bcni", weights, stream))
        stream = torch.einsum("bcns,cd->bdns", stream, self.channels)
        weights = _attention(stream.permute(0, 2, 3, 1).flatten(2), self.over_nodes)
        stream = self.activation(torch.einsum("bij,bcjs->bcis", weights, stream))
        return stream + self.bias


def _attention(tokens: Float[Tensor, "batch tokens size"], weights: Float[Tensor, "heads 2 size"]) -> Tensor:
    """Row i: how much token i takes of each token, averaged over the heads; no value projection makes that enough."""
    looking, looked_at = torch.einsum("bts,hps->pbht", tokens, weights)
    return functional.leaky_relu(looking[..., :, None] + looked_at[..., None, :], _SLOPE).softmax(dim=-1).mean(dim=1)


class GraphEncoder(nn.Module):
    """Graph layers with residual blocks on two copies of the sequence, from 3 channels to 3.

    Args:
        nodes: Number of nodes of the graph.
        steps: Coefficients of each node.
        width: Channels between the first and the last layer.
        blocks: Residual blocks.
        dropout: Share of numbers that the blocks drop in training.
        layer: Makes a layer of a number of channels that come in, channels that go out, nodes, and steps.
    """

    def __init__(
        self,
        nodes: int,
        steps: int,
        width: int,
        blocks: int,
        dropout: float,
        layer: GraphLayer,
        *,
        residual: bool = True,
    ) -> None:
        super().__init__()
        self.steps = steps
        self.residual = residual
        self.start = layer(3, width, nodes, steps)
        doubled = [width, nodes, 2 * steps]
        self.blocks = nn.ModuleList(_GraphBlock(layer(width, *doubled), doubled, dropout) for _ in range(blocks))
        self.end: nn.Module = layer(width, 3, nodes, steps)
        if not residual:
            self.end = _GraphBlock(self.end, [3, nodes, steps], dropout, residual=False)

    def forward(self, nodes: Graph) -> Graph:
        """Encode; the result is what the layers make, with the input added where the end block is bare."""
        stream = self.start(nodes)
        stream = torch.cat([stream, stream], dim=-1)
        for block in self.blocks:
            stream = block(stream)
        encoded = self.end(stream[..., : self.steps])
        return encoded + nodes if self.residual else encoded


class _GraphBlock(nn.Module):
    def __init__(self, attention: nn.Module, shape: list[int], dropout: float, *, residual: bool = True) -> None:
        super().__init__()
        self.attention = attention  # or GazeMotion's convolution: weights files know this name
        self.norm = nn.LayerNorm(shape)
        self.dropout = nn.Dropout(dropout)
        self.residual = residual

    def forward(self, stream: Graph) -> Tensor:
        changed = self.dropout(torch.tanh(self.norm(self.attention(stream))))
        return stream + changed if self.residual else changed


def gaze_encoder(coefficients: int) -> nn.Sequential:
    """Convolutions over the coefficients of a direction: (batch, 3, L) to (batch, 3, L), within ±1."""
    layers: list[nn.Module] = []
    inputs = 3
    for outputs in (_GAZE_CHANNELS, _GAZE_CHANNELS, _GAZE_CHANNELS, 3):
        layers.append(nn.Conv1d(inputs, outputs, _KERNEL, padding=_KERNEL // 2, padding_mode="replicate"))
        if outputs != 3:
            layers.append(nn.LayerNorm([outputs, coefficients]))
        layers.append(nn.Tanh())
        inputs = outputs
    return nn.Sequential(*layers)


class ConditionEncoder(nn.Module):
    """Encodes the coefficients of a padded observation, once a window.

    Args:
        configuration: Which parts there are, and their sizes.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        joints, nodes = configuration.n_joints, configuration.nodes
        self.pose: nn.Module = nn.Identity()
        steps, width = configuration.coefficients, configuration.encoder_width
        heads, leaky = configuration.encoder_heads, configuration.leaky_features
        layer = partial(GraphAttention, heads=heads, leaky=leaky)
        bare = configuration.end_block == "residual"
        if configuration.pose_encoder:
            self.pose = GraphEncoder(joints, steps, width, 1, configuration.encoder_dropout, layer, residual=bare)
        self.gaze: nn.Module = nn.Identity()
        if configuration.gaze and configuration.gaze_encoder:
            self.gaze = gaze_encoder(steps)
        self.fusion: nn.Module = nn.Identity()
        if configuration.fusion == "graph-attention":
            blocks = configuration.fusion_blocks
            self.fusion = GraphEncoder(nodes, steps, width, blocks, configuration.fusion_dropout, layer, residual=bare)

    def forward(self, coefficients: Coefficients) -> Coefficients:
        """Encode the coefficients of padded observations, gaze being the last node."""
        nodes = self.nodes(coefficients)
        joints = self.configuration.n_joints
        features = self.pose(nodes[:, :, :joints])
        if self.configuration.gaze:
            features = torch.cat([features, self.gaze(nodes[:, :, joints])[:, :, None]], dim=2)
        return self.flat(self.fusion(features))

    def nodes(self, coefficients: Coefficients) -> Graph:
        """Coordinates, nodes and coefficients as axes.

        The legacy layout takes the same numbers in the order in which they lie in memory, so that axes are mixed.
        """
        shape = self.configuration
        if shape.legacy_layout:
            return coefficients.reshape(len(coefficients), 3, shape.nodes, shape.coefficients)
        return coefficients.unflatten(-1, (shape.nodes, 3)).permute(0, 3, 2, 1)

    def flat(self, nodes: Graph) -> Coefficients:
        """Return the way back from :meth:`nodes`."""
        if self.configuration.legacy_layout:
            return nodes.reshape(len(nodes), self.configuration.coefficients, self.configuration.values)
        return nodes.permute(0, 3, 2, 1).flatten(2)


@dataclass(frozen=True)
class PreparedCondition:
    """All that a pass takes from the condition: computed once a window, used in every step and for every sample.

    Attributes:
        vector: Is added to the embedding of the step; one for all samples, or one for each.
        memories: What each block's cross-attention makes of the condition.
    """

    vector: Float[Tensor, "windows #samples width"]
    memories: tuple[_Memory | None, ...]


class CoefficientDenoiser(nn.Module):
    """Predicts the noise in noisy DCT coefficients from the step and a condition of as many coefficients.

    Args:
        configuration: Sizes, and whether there is cross-attention.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width, values, rows = configuration.width, configuration.values, configuration.coefficients
        self.places = nn.Parameter(torch.randn(rows, width))
        self.input = nn.Linear(values, width)
        self.condition = nn.Linear(rows * values, width)
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(_Block(configuration) for _ in range(configuration.layers))
        self.output = from_zero(nn.Linear(width, values))
        table = sinusoid_table(configuration.diffusion_steps, width)
        # The published programs have all cosines in front of all sines.
        self.register_buffer("sinusoid", torch.cat([table[:, 1::2], table[:, ::2]], dim=1), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Samples, step: Int[Tensor, " steps"], prepared: PreparedCondition) -> Samples:
        """Predict the noise.

        Args:
            noisy: Noisy coefficients of each sample.
            step: Index in the training schedule: one for all windows, or one for each.
            prepared: What :meth:`prepare` has made of the condition.
        """
        time = nn.functional.silu(self.time(self.sinusoid[step])[:, None] + prepared.vector)
        stream = self.input(noisy) + self.places
        half = len(self.blocks) // 2
        skips = []
        for place, (block, memory) in enumerate(zip(self.blocks, prepared.memories, strict=True)):
            if place < half:
                skips.append(stream)
            stream = block(stream, time, memory)
            if place >= half:
                stream = stream + skips.pop()
        return self.output(stream)

    def prepare(self, condition: Coefficients, kept: Kept | None = None) -> PreparedCondition:
        """Compute what the condition contributes to every pass.

        Args:
            condition: Fused features, or the coefficients of the padded observation.
            kept: Which samples keep the condition vector; None if all do. Cross-attention sees the condition of
                all of them: it has no samples of its own.
        """
        vector = self.condition(condition.flatten(1))[:, None]
        if kept is not None:
            vector = vector * kept[..., None]
        crosses = [cast(_Block, block).cross for block in self.blocks]
        return PreparedCondition(vector, tuple(None if each is None else each.memory(condition) for each in crosses))


class _Block(nn.Module):
    """Self-attention, cross-attention if there is any, feed-forward; each stylised and residual."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        width, dropout, self.heads = configuration.width, configuration.dropout, configuration.heads
        self.dropout = dropout
        self.norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width, bias=False)
        self.attention_style = _Stylisation(width, dropout)
        self.cross = None
        if configuration.cross_attention:
            kinds = {"motion": _CrossAttention, "condition": _AskedByCondition}
            self.cross = kinds[configuration.queries](configuration)
        self.expand = nn.Linear(width, configuration.feed_forward)
        self.contract = from_zero(nn.Linear(configuration.feed_forward, width))
        self.feed_forward_dropout = nn.Dropout(dropout)
        self.feed_forward_style = _Stylisation(width, dropout)

    def forward(self, stream: Stream, time: Tensor, memory: _Memory | None) -> Stream:
        """Apply to every sample by itself; ``time`` is SiLU(step + condition)."""
        parts = self.query_key_value(self.norm(stream)).unflatten(-1, (3, self.heads, -1)).movedim(-3, 0)
        query, key, value = parts.transpose(-3, -2).flatten(1, 2)
        dropping = self.dropout if self.training else 0.0
        attended = functional.scaled_dot_product_attention(query, key, value, dropout_p=dropping)
        attended = attended.transpose(1, 2).flatten(2).view_as(stream)
        stream = stream + self.attention_style(attended, time)
        if self.cross is not None and memory is not None:
            stream = stream + self.cross(stream, time, memory)
        hidden = self.feed_forward_dropout(functional.gelu(self.expand(stream)))
        return stream + self.feed_forward_style(self.contract(hidden), time)


class _CrossAttention(nn.Module):
    """Queries from the motion; keys and values from the condition, a token each coefficient."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        width, values, self.heads = configuration.width, configuration.values, configuration.heads
        self.dropout = configuration.dropout
        self.norm = nn.LayerNorm(width)
        self.condition_norm = nn.LayerNorm(values)
        self.query = nn.Linear(width, width, bias=False)
        self.key_value = nn.Linear(values, 2 * width, bias=False)
        self.style = _Stylisation(width, configuration.dropout)

    def forward(self, stream: Stream, time: Tensor, memory: _Memory) -> Stream:
        """Look at the coefficients of the condition, from each coefficient of each sample.

        Args:
            stream: Tokens of the samples.
            time: Embedding of the diffusion step, a row for each sample or one for all.
            memory: See :meth:`memory`.
        """
        scored, values = memory
        scores = (self.norm(stream).flatten(1, 2) @ scored).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        shares = functional.dropout(scores.softmax(dim=-1), self.dropout, self.training)
        return self.style((shares @ values).transpose(1, 2).flatten(2).view_as(stream), time)

    def memory(self, condition: Coefficients) -> _Memory:
        both = self.key_value(self.condition_norm(condition)).unflatten(-1, (2, self.heads, -1))
        key, value = both.movedim(-3, 0).transpose(-3, -2)
        # A score is (W h) · k = h · (Wᵀ k): queries, which every sample and step would need, are never made.
        query = self.query.weight.unflatten(0, (self.heads, -1)) / math.sqrt(key.shape[-1])
        return torch.einsum("hdc,whld->wchl", query, key).flatten(2), value


class _AskedByCondition(_CrossAttention):
    """Queries and values from the condition, keys from the motion: softmax(Q) softmax(Kᵀ) norm(V), as in the paper."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__(configuration)
        self.condition_norm = nn.Identity()
        self.value_norm = nn.LayerNorm(configuration.width)

    def forward(self, stream: Stream, time: Tensor, memory: _Memory) -> Stream:
        """See the base class; keys are softmaxed over the coefficients of a sample, queries over their own numbers."""
        queries, values = memory
        keys = self.query(self.norm(stream)).unflatten(-1, (self.heads, -1)).transpose(-2, -3).softmax(dim=-2)
        weighed = (queries[:, None] @ keys.transpose(-1, -2)) @ values[:, None]
        weighed = functional.dropout(weighed, self.dropout, self.training)
        return self.style(weighed.transpose(-2, -3).flatten(-2), time)

    def memory(self, condition: Coefficients) -> _Memory:
        queries, values = self.key_value(condition).chunk(2, dim=-1)
        both = torch.stack([queries, self.value_norm(values)]).unflatten(-1, (self.heads, -1)).transpose(-2, -3)
        return both[0].softmax(dim=-1), both[1]


class _Stylisation(nn.Module):
    """Linear(Dropout(SiLU(norm(h) · (1 + s) + b))) with s and b from step and condition; the linear starts at zero."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.scale_shift = nn.Linear(width, 2 * width)
        self.norm = nn.LayerNorm(width)
        self.dropout = nn.Dropout(dropout)
        self.output = from_zero(nn.Linear(width, width))

    def forward(self, stream: Stream, time: Tensor) -> Stream:
        scale, shift = self.scale_shift(time)[:, :, None].chunk(2, dim=-1)
        return self.output(self.dropout(functional.silu(torch.addcmul(shift, self.norm(stream), 1 + scale))))


class CoefficientDiffusion(nn.Module):
    """Diffusion of the DCT coefficients of whole windows, under the condition of their observed frames.

    Args:
        configuration: Sizes and parts; :func:`~prbench_adapters.prediction.configuration.preset` has the published.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.transform = WindowDCT(configuration.coefficients, configuration.observed, configuration.frames)
        self.encoder = ConditionEncoder(configuration) if configuration.encoder else None
        self.denoiser = CoefficientDenoiser(configuration)
        sizes = (configuration.coefficients, configuration.values)
        self.whitening = Whitening(*sizes) if configuration.whitened else None
        self.schedule = CosineSchedule(configuration.diffusion_steps)

    def condition(self, observed: Coefficients) -> Coefficients:
        """Encode the coefficients of padded observations for the denoiser; without an encoder they stay as they are."""
        return observed if self.encoder is None else self.encoder(observed)

    def loss(
        self, motion: Motion, step: Int[Tensor, " windows"], noise: Coefficients, kept: KeptWindows | None = None
    ) -> Float[Tensor, ""]:
        """Mean squared error of the predicted noise, or velocity.

        Args:
            motion: Whole windows, with the direction as the last node if the model has one.
            step: Index in the training schedule; from 1, as the published programs never draw 0.
            noise: Standard normal.
            kept: Which windows keep their condition; None if all do.
        """
        known = self.transform(padded(motion[:, : self.configuration.observed], motion.shape[1]))
        condition = self.condition(known)
        clean = self.transform(motion)
        if self.configuration.residual:
            clean = clean - known
        if self.whitening is not None:
            clean = self.whitening(clean)
        level = torch.from_numpy(self.schedule.alphas_cumprod).to(clean)[step][:, None, None]
        noisy = level.sqrt() * clean + (1.0 - level).sqrt() * noise
        wanted = noise
        if self.configuration.predicts == "velocity":
            wanted = level.sqrt() * noise - (1.0 - level).sqrt() * clean
        return (self.denoiser(noisy[:, None], step, self._prepared(condition, kept))[:, 0] - wanted).square().mean()

    @torch.no_grad()
    def predict(self, observed: Motion, seeds: Sequence[Sequence[int]]) -> Float[Tensor, "windows samples _ nodes 3"]:
        """Draw continuations of observations; the model must be in evaluation mode.

        Args:
            observed: Observed frames; the direction is the last node if the model has one.
            seeds: A seed for each sample of each window (``prbench.randomness.noise_seed``). Nothing else decides
                about its noise, so five samples are the first five of fifty.

        Returns:
            The frames after the observed ones, with the direction that was predicted too.

        Raises:
            ValueError: for observations of another shape, and without any sample.
        """
        configuration = self.configuration
        expected = (len(seeds), configuration.observed, configuration.nodes, 3)
        if tuple(observed.shape) != expected:
            raise ValueError(f"expected observations of shape {expected}, found {tuple(observed.shape)}")
        samples = len(seeds[0]) if seeds else 0
        if not samples or any(len(row) != samples for row in seeds):
            raise ValueError("each window needs a seed for each of at least one sample, and as many as the others")
        flat = [seed for row in seeds for seed in row]
        source = SequenceNoise(flat, np.full(len(flat), configuration.coefficients), observed.device)

        def noise() -> Tensor:
            return source.draw(configuration.values).to(observed.dtype).unflatten(0, (-1, samples))

        kept = None
        if configuration.condition_kept_sampling < 1.0:
            # A stream beside that of the sample's noise, which stays as it is whatever share keeps the condition.
            draws = [sequence_generator(seed).spawn(1)[0].random() for seed in flat]
            chosen = torch.tensor(draws, device=observed.device) < configuration.condition_kept_sampling
            kept = chosen.unflatten(0, (-1, samples))
        known = self.transform(padded(observed, configuration.frames))
        offset = known if configuration.residual else torch.zeros_like(known)
        *_, state = self.states(known - offset, self.condition(known), noise, kept)
        if self.whitening is not None:
            state = self.whitening.inverse(state)
        return self.transform.inverse(state + offset[:, None])[:, :, configuration.observed :]

    @torch.no_grad()
    def residuals(self, motion: Motion) -> Coefficients:
        """Coefficients of the difference of whole windows to their padded observation, metres."""
        known = padded(motion[:, : self.configuration.observed], motion.shape[1])
        return self.transform(motion) - self.transform(known)

    @torch.no_grad()
    def states(
        self, known: Coefficients, condition: Coefficients, noise: Callable[[], Samples], kept: Kept | None = None
    ) -> Iterator[Samples]:
        """Walk from noise to clean coefficients by DDIM (η = 0), completed by the observation after every step.

        Args:
            known: Coefficients of the padded observation, not whitened; zeros if residuals are diffused.
            condition: What :meth:`condition` has made of them.
            noise: Called once for the start and once a step, the noisiest first.
            kept: Which samples keep the condition vector; None if all do.

        Yields:
            The state after each step.
        """
        prepared = self.denoiser.prepare(condition, kept)
        guidance = self.configuration.guidance
        without = None
        if guidance != 1.0:
            without = self._prepared(condition, torch.zeros(len(condition), dtype=torch.bool, device=condition.device))
        state = noise()
        for step, level, cleaner in self.moves():
            index = torch.full((1,), step, device=state.device)
            predicted = self.denoiser(state, index, prepared)
            if without is not None:
                predicted = torch.lerp(self.denoiser(state, index, without), predicted, guidance)
            if self.configuration.predicts == "velocity":
                predicted = math.sqrt(level) * predicted + math.sqrt(1.0 - level) * state
            # √ᾱ' x0 + √(1 - ᾱ') ε with x0 = (x - √(1 - ᾱ) ε) / √ᾱ, collected by x and ε in float64.
            of_state = math.sqrt(cleaner / level)
            of_noise = math.sqrt(1.0 - cleaner) - of_state * math.sqrt(1.0 - level)
            state = of_state * state + of_noise * predicted
            # The observed frames are put back, as noisy as the state is. Which are known is a matter of metres.
            fresh = math.sqrt(1.0 - cleaner) * noise()
            noisy_known = math.sqrt(cleaner) * known[:, None]
            if self.whitening is None:
                state = self.transform.completed(state, noisy_known + fresh)
            else:
                noisy_known = noisy_known + self.whitening.inverse(fresh)
                state = self.whitening(self.transform.completed(self.whitening.inverse(state), noisy_known))
            yield state

    def moves(self) -> Iterator[tuple[int, float, float]]:
        """Each step, the noisiest first: its index, ᾱ there, and ᾱ of the index that it leads to.

        Steps are 1, 1 + stride, …; the last one leads to index 0, which is not quite free of noise.
        """
        levels = self.schedule.alphas_cumprod
        steps = list(range(1, len(levels), len(levels) // self.configuration.sampling_steps))
        for step, previous in zip(reversed(steps), [*reversed(steps[:-1]), 0], strict=True):
            yield step, float(levels[step]), float(levels[previous])

    def _prepared(self, condition: Tensor, kept: KeptWindows | None) -> PreparedCondition:
        """Return the condition, and for windows that do not keep it what is left of it."""
        if kept is not None and self.configuration.dropped == "both":
            condition = condition * kept[:, None, None]
        return self.denoiser.prepare(condition, None if kept is None else kept[:, None])
