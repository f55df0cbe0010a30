"""The networks of motion tokens: the public program's values, and laws that need no sample."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn.functional import smooth_l1_loss

from prbench_benchmarks.motion_tokens.network import Quantiser, Tokeniser, TokeniserConfiguration, perplexity

BATCH, TOKENS, LATENT, CODES = 2, 6, 8, 10


class Golden:
    """Arrays of the public program, and its networks as ours."""

    def __init__(self, path):
        self.arrays = np.load(path)

    def __getitem__(self, name):
        return torch.from_numpy(self.arrays[name])

    def tokeniser(self, parts=1, *, initialised=True):
        network = Tokeniser(TokeniserConfiguration(width=12, latent=LATENT, codes=CODES, parts=parts))
        names = [name for name in self.arrays if name.startswith("w/")]
        weights = {name.removeprefix("w/").replace(".model.", "."): self[name].float() for name in names}
        odd = network.load_state_dict(weights, strict=False)
        assert not odd.unexpected_keys
        assert all(name.split(".")[0] in ("quantisers", "mean", "std") for name in odd.missing_keys)
        for place, quantiser in enumerate(network.quantisers if initialised else ()):
            own = slice(place * LATENT // parts, (place + 1) * LATENT // parts)
            quantiser.codebook.data.copy_(self["codebook"][:, own])
            quantiser.sum.data.copy_(self["code_sum"][:, own])
            quantiser.count.data.copy_(self["code_count"])
            quantiser.initialised.fill_(True)
        return network

    def holds(self, name, found, tolerance=3e-6):
        found = found.detach().numpy()
        assert found.shape == self.arrays[name].shape, name
        np.testing.assert_allclose(found, self.arrays[name], rtol=0, atol=tolerance, err_msg=name)

    def holds_state(self, prefix, quantiser, suffix=""):
        for name, value in (("codebook", quantiser.codebook), ("sum", quantiser.sum), ("count", quantiser.count)):
            self.holds(f"{prefix}_{name}{suffix}", value)


@pytest.fixture(scope="module")
def golden(samples):
    return Golden(samples / "nymeria-tasks" / "motion_vqvae.npz")


def in_time(vectors):
    return vectors.unflatten(0, (BATCH, -1)).mT


def test_features_become_the_programs_tokens_and_features_again(golden):
    network = golden.tokeniser().eval()
    golden.holds("encoder_output", network.encode(golden["features"]))
    made, quantised = network(golden["features"])
    assert torch.equal(quantised.tokens.view(BATCH, TOKENS), golden["tokens"])
    golden.holds("quantised", in_time(quantised.vectors))
    golden.holds("reconstruction", made)
    golden.holds("commit", quantised.commitment)
    golden.holds("perplexity", quantised.perplexity, 1e-6)
    golden.holds("decoded_tokens0", network.from_tokens(quantised.tokens.view(BATCH, TOKENS, 1)[:1]))


def test_two_steps_have_the_programs_losses_gradients_codes_and_resets(golden):
    network = golden.tokeniser().train()
    features = golden["features"]
    made, quantised = network(features)
    feature, position = smooth_l1_loss(made, features), smooth_l1_loss(made[..., 4:67], features[..., 4:67])
    loss = feature + 0.5 * position + 0.02 * quantised.commitment
    parts = {"feature": feature, "position": position, "commit": quantised.commitment, "total": loss}
    for name, value in parts.items():
        golden.holds(f"loss_{name}", value, 1e-7)
    golden.holds("train_perplexity", quantised.perplexity, 1e-6)
    loss.backward()
    golden.holds("grad_first_conv", network.encoder[0].weight.grad[:, :20])
    golden.holds("grad_last_encoder_bias", network.encoder[-1].bias.grad)
    (quantiser,) = network.quantisers
    golden.holds_state("step1", quantiser)
    assert torch.equal(quantiser.count < 1, golden["reset"])
    network(features)
    golden.holds_state("step2", quantiser)
    assert torch.equal(quantiser.count < 1, golden["reset2"])


def test_the_first_batch_is_the_first_codebook(golden):
    network = golden.tokeniser(initialised=False).train()
    made, quantised = network(golden["features"])
    golden.holds("first_output", made)
    golden.holds("first_commit", quantised.commitment)
    golden.holds("first_perplexity", quantised.perplexity, 1e-6)
    golden.holds_state("first", network.quantisers[0], "_after")


def test_fewer_vectors_than_codes_are_repeated_with_noise(golden, monkeypatch):
    draws = iter(golden["small_draws"])
    monkeypatch.setattr(torch, "randn", lambda *_, **__: next(draws))
    network = Tokeniser(TokeniserConfiguration(width=4, latent=5, codes=20)).train()
    quantised = network.quantise(golden["small_input"])
    golden.holds("small_output", in_time(quantised.vectors))
    golden.holds("small_commit", quantised.commitment)
    golden.holds("small_perplexity", quantised.perplexity, 1e-6)
    golden.holds_state("small", network.quantisers[0], "_after")
    assert next(draws, None) is None


def test_two_parts_quantise_their_own_channels(golden):
    network = golden.tokeniser(parts=2).eval()
    made, quantised = network(golden["features"])
    assert torch.equal(quantised.tokens.view(BATCH, TOKENS, 2), golden["pq_tokens"])
    golden.holds("pq_quantised", in_time(quantised.vectors))
    golden.holds("pq_reconstruction", made)
    assert quantised.commitment.item() == pytest.approx(golden["pq_commit"].mean().item(), abs=3e-6)


def test_two_parts_worked_by_hand():
    network = Tokeniser(TokeniserConfiguration(width=4, latent=4, codes=2, parts=2)).eval()
    for quantiser in network.quantisers:
        quantiser.codebook.data.copy_(torch.eye(2))
    quantised = network.quantise(torch.tensor([0.9, 0.1, -0.2, 1.2]).view(1, 4, 1))
    assert quantised.tokens.tolist() == [[0, 1]]
    assert quantised.vectors.tolist() == [pytest.approx([1.0, 0.0, 0.0, 1.0])]
    # Squared distances 0.02 and 0.08, a mean over two channels of each part.
    assert quantised.commitment.item() == pytest.approx(0.10 / 4)


def test_the_published_sizes_have_the_measured_number_of_parameters():
    with torch.device("meta"):
        network = Tokeniser(TokeniserConfiguration())
    outside = [p.numel() for name, p in network.named_parameters() if not name.startswith("quantisers")]
    assert round(sum(outside) / 1e6, 2) == 19.44


@pytest.mark.parametrize("shares", [[1.0, 0.0], [0.5, 0.5], [0.25] * 4])
def test_perplexity_counts_equally_used_codes(shares):
    assert perplexity(torch.tensor(shares)).item() == pytest.approx(sum(share > 0 for share in shares), rel=1e-5)


def test_evaluation_changes_no_code_and_training_does():
    torch.manual_seed(0)
    network = Tokeniser(TokeniserConfiguration(width=4, latent=4, codes=3))
    features = torch.randn(2, 16, 263)
    network.train()(features, torch.Generator().manual_seed(0))
    (quantiser,) = network.quantisers
    before = quantiser.codebook.detach().clone()
    network.eval()(features)
    assert torch.equal(quantiser.codebook, before)
    network.train()(features + 1)
    assert not torch.equal(quantiser.codebook, before)
    assert quantiser.codebook.grad is None


def test_the_first_vectors_of_the_first_batch_stand_for_themselves():
    torch.manual_seed(0)
    network = Tokeniser(TokeniserConfiguration(width=4, latent=4, codes=3)).train()
    encoded = torch.randn(2, 4, 5)
    quantised = network.quantise(encoded)
    assert quantised.tokens[:3, 0].tolist() == [0, 1, 2]
    assert torch.allclose(quantised.vectors[:3], encoded[0, :, :3].mT)
    assert network.quantisers[0].initialised


def test_codes_follow_in_full_precision_where_the_networks_are_in_half():
    torch.manual_seed(0)
    network = Tokeniser(TokeniserConfiguration(width=4, latent=4, codes=3)).train()
    with torch.autocast("cpu", torch.bfloat16):
        _, quantised = network(torch.randn(2, 16, 263))
    assert quantised.vectors.dtype == torch.float32
    assert torch.isfinite(network.quantisers[0].codebook).all()


def test_an_unused_code_is_replaced_until_its_count_reaches_one():
    quantiser = Quantiser(2, 1)
    quantiser.initialise(torch.tensor([[0.0], [10.0]]), None)
    vectors = torch.tensor([[0.0], [5.0], [0.0]])
    quantiser.update(vectors, torch.zeros(3, dtype=torch.long), None)
    assert quantiser.codebook[1].item() == 5.0  # vector number 1
    assert quantiser.sum[1].item() == pytest.approx(9.9)  # not reset
    assert quantiser.count.tolist() == pytest.approx([1.02, 0.99])
