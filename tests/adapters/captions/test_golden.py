"""The public program's values for TM2T; sizes and weights come from the file."""

import numpy as np
import pytest
import torch

from prbench_adapters.captions.network import Captioner, CaptionerConfiguration, beam_search, caption_losses, greedy
from prbench_adapters.diffusion.denoiser import sinusoid_table


@pytest.fixture(scope="module")
def golden(samples):
    with np.load(samples / "nymeria-tasks" / "tm2t.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


@pytest.fixture(scope="module")
def network(golden):
    weights = {name.removeprefix("w/"): each.float() for name, each in golden.items() if name.startswith("w/")}
    output = weights.pop("trg_word_prj.weight")
    assert bool(golden["tied"])
    assert torch.equal(output, weights["decoder.trg_word_emb.weight"])
    codes, pieces = (len(weights[f"{name}.weight"]) - 3 for name in ("encoder.src_word_emb", "decoder.trg_word_emb"))
    shape = CaptionerConfiguration(
        codes=codes,
        pieces=pieces,
        width=output.shape[1],
        inner=len(weights["encoder.layer_stack.0.pos_ffn.w_1.weight"]),
        layers=sum(name.endswith("enc_attn.fc.bias") for name in weights),
        heads=int(golden["heads"]),
        head_width=int(golden["d_k"]),
    )
    network = Captioner(shape)
    network.load_state_dict(weights)
    return network.eval().requires_grad_(False)


def close(found, wanted, tolerance=6e-6):
    np.testing.assert_allclose(found.numpy(), wanted.numpy(), rtol=0, atol=tolerance)


def test_the_ids_of_padding_are_the_last_ones(golden, network):
    assert golden["ids"][:2].tolist() == [network.source_padding, network.padding]


def test_positions_encoder_and_logits(golden, network):
    close(sinusoid_table(*golden["positional"].shape), golden["positional"])
    close(network.encode(golden["source"])[0], golden["encoder_output"])
    close(network(golden["source"], golden["target"][:, :-1]), golden["logits"])


@pytest.mark.parametrize(("name", "smoothing"), [("loss_sum", 0.0), ("loss_sum_smoothed", 0.1)])
def test_losses_and_counts(name, smoothing, golden, network):
    logits = network(golden["source"], golden["target"][:, :-1])
    found = caption_losses(logits, golden["target"][:, 1:], network.padding, smoothing)
    close(found["loss"], golden[name], 5e-5)
    assert (int(found["right"]), int(found["pieces"])) == (int(golden["n_correct"]), int(golden["n_word"]))


def decoding(golden, longest):
    start, end = golden["ids"][2:].tolist()
    return {"start": start, "end": end, "longest": longest}


def test_greedy_decoding_of_a_batch_and_of_single_motions(golden, network):
    settings = decoding(golden, 10)
    tokens = greedy(network, golden["source"], **settings)
    assert torch.equal(tokens, golden["greedy_tokens"])
    lengths = ((tokens[:, 1:] == settings["end"]).cumsum(1) == 0).sum(1)
    assert torch.equal(lengths, golden["greedy_lengths"].flatten())
    for row in range(len(tokens)):
        alone = greedy(network, golden["source"][row : row + 1], **settings)[0]
        assert torch.equal(alone[alone != settings["end"]], golden[f"greedy_single_{row}"])


@pytest.mark.parametrize("width", [2, 3])
def test_beam_search(width, golden, network):
    for row in range(len(golden["source"])):
        source = golden["source"][row : row + 1]
        found = beam_search(network, source, width, **decoding(golden, 11))
        assert torch.equal(found, golden[f"beam{width}_{row}"])
