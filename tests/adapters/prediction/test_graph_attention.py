"""The layer by hand (docs/specification/gazemodiff.md#check-values), and without pairs of tokens."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from prbench_adapters.prediction.coefficient_diffusion import GraphAttention


@pytest.fixture
def layer():
    found = GraphAttention(1, 1, 2, 2, 1)
    with torch.no_grad():
        for parameter in found.parameters():
            parameter.zero_()
        found.channels.fill_(1.0)
    return found.requires_grad_(False)


GRAPH = torch.tensor([[[[1.0, 3.0], [5.0, 9.0]]]])


def test_without_scores_every_entry_is_the_mean(layer):
    assert torch.equal(layer(GRAPH), torch.full((1, 1, 2, 2), 4.5))


def test_scores_of_the_token_that_is_looked_at(layer):
    layer.over_steps[0, 1, 0] = 1.0
    layer.over_nodes[0, 1, 0] = 1.0
    torch.testing.assert_close(layer(GRAPH), torch.full((1, 1, 2, 2), 8.5051), rtol=0, atol=1e-4)


def test_sums_of_two_dot_products_equal_scores_of_pairs():
    torch.manual_seed(1)
    layer = GraphAttention(3, 4, 5, 6, 2)
    stream = torch.randn(2, 3, 5, 6)

    def of_pairs(tokens, weights):
        n = tokens.shape[1]
        pairs = torch.cat([tokens[:, :, None].expand(-1, -1, n, -1), tokens[:, None].expand(-1, n, -1, -1)], dim=-1)
        scores = functional.leaky_relu(torch.einsum("bijf,hf->bhij", pairs, weights.flatten(1)), 0.2)
        return scores.softmax(dim=-1).mean(dim=1)

    steps = stream.permute(0, 3, 2, 1)
    mixed = torch.einsum("bij,bjnc->binc", of_pairs(steps.flatten(2), layer.over_steps), steps) @ layer.channels
    nodes = mixed.transpose(1, 2)
    expected = torch.einsum("bij,bjsc->bisc", of_pairs(nodes.flatten(2), layer.over_nodes), nodes).permute(0, 3, 1, 2)
    torch.testing.assert_close(layer(stream), expected + layer.bias)
