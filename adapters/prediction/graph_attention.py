"""Attention over the steps and over the nodes of a graph, whose scores are sums: e_ij = LeakyReLU(p_i + q_j).

Source: docs/specification/gazemodiff.md#network.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

_SLOPE = 0.2


class GraphAttention(nn.Module):
    """Attention over steps, a change of channels, attention over nodes, and a bias for each step.

    A score is a dot product of weights with two tokens behind one another, which is the sum of a dot product with
    each: pairs of tokens are never made.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
        nodes: Of the graph.
        steps: Of each node's sequence.
        heads: Sets of attention weights, which are averaged.
    """

    def __init__(self, inputs: int, outputs: int, nodes: int, steps: int, heads: int) -> None:
        super().__init__()
        self.over_steps = nn.Parameter(torch.empty(heads, 2, inputs * nodes))
        """For the token that looks and the token that is looked at."""
        self.channels = nn.Parameter(torch.empty(inputs, outputs))
        self.over_nodes = nn.Parameter(torch.empty(heads, 2, outputs * steps))
        self.bias = nn.Parameter(torch.empty(steps))
        bound = 1.0 / math.sqrt(outputs)
        for parameter in self.parameters():
            nn.init.uniform_(parameter, -bound, bound)

    def forward(self, stream: Float[Tensor, "batch inputs nodes steps"]) -> Float[Tensor, "batch outputs nodes steps"]:
        """Apply to every graph by itself."""
        # Features of a step are ordered by node, those of a node by step; channels change fastest in both.
        weights = _attention(stream.permute(0, 3, 2, 1).flatten(2), self.over_steps)
        stream = torch.einsum("bij,bcnj->bcni", weights, stream)
        stream = torch.einsum("bcns,cd->bdns", stream, self.channels)
        weights = _attention(stream.permute(0, 2, 3, 1).flatten(2), self.over_nodes)
        stream = torch.einsum("bij,bcjs->bcis", weights, stream)
        return stream + self.bias


def _attention(
    tokens: Float[Tensor, "batch tokens size"], weights: Float[Tensor, "heads 2 size"]
) -> Float[Tensor, "batch tokens tokens"]:
    """Row i: how much token i takes of each token, averaged over the heads; no value projection makes that enough."""
    looking, looked_at = torch.einsum("bts,hps->pbht", tokens, weights)
    scores = functional.leaky_relu(looking[..., :, None] + looked_at[..., None, :], _SLOPE)
    return scores.softmax(dim=-1).mean(dim=1)


class GraphEncoder(nn.Module):
    """Graph attention layers with residual blocks on two copies of the sequence, from 3 channels to 3.

    Args:
        nodes: Of the graph.
        steps: Coefficients of each node.
        width: Channels between the first and the last layer.
        heads: Of each layer.
        blocks: Residual blocks.
        dropout: In the blocks.
    """

    def __init__(self, nodes: int, steps: int, width: int, heads: int, blocks: int, dropout: float) -> None:
        super().__init__()
        self.steps = steps
        self.start = GraphAttention(3, width, nodes, steps, heads)
        self.blocks = nn.ModuleList(_Block(width, nodes, 2 * steps, heads, dropout) for _ in range(blocks))
        self.end = GraphAttention(width, 3, nodes, steps, heads)

    def forward(self, nodes: Float[Tensor, "batch 3 nodes steps"]) -> Float[Tensor, "batch 3 nodes steps"]:
        """Encode; the result is the input and what the layers add to it."""
        stream = self.start(nodes)
        stream = torch.cat([stream, stream], dim=-1)
        for block in self.blocks:
            stream = block(stream)
        return self.end(stream[..., : self.steps]) + nodes


class _Block(nn.Module):
    def __init__(self, width: int, nodes: int, steps: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.attention = GraphAttention(width, width, nodes, steps, heads)
        self.norm = nn.LayerNorm([width, nodes, steps])
        self.dropout = nn.Dropout(dropout)

    def forward(self, stream: Float[Tensor, "batch width nodes steps"]) -> Float[Tensor, "batch width nodes steps"]:
        return stream + self.dropout(torch.tanh(self.norm(self.attention(stream))))
