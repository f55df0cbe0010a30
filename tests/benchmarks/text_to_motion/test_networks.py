from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from prbench.representation import Statistics
from prbench.text import text_encoder
from prbench_benchmarks.text_to_motion.clips import Extractor
from prbench_benchmarks.text_to_motion.networks import (
    EvaluatorConfiguration,
    MovementDecoder,
    MovementEncoder,
    TextEncoder,
    motion_encoder,
)

TINY = EvaluatorConfiguration(
    movement_width=8, motion_width=6, text_width=6, embedding=5, text="hashed-ngrams", max_frames=60
)
CAPTIONS = ["picks up a cup", "walks", "the person moves across and puts an object down", ""]


def parameters(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_parameter_counts_are_those_of_the_text_to_motion_paper():
    paper = EvaluatorConfiguration()
    assert parameters(MovementEncoder(paper.movement_width)) == 1_842_688
    assert parameters(motion_encoder(paper)) == 15_747_584
    assert parameters(TextEncoder(paper, 315)) == 4_100_288


@pytest.fixture(scope="module")
def extractor() -> Extractor:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        networks = MovementEncoder(8), motion_encoder(TINY), TextEncoder(TINY, 64)
    std = np.full(263, 2.0, dtype=np.float32)
    statistics = Statistics(np.linspace(-1, 1, 263, dtype=np.float32), std)
    return Extractor(TINY, *networks, statistics=statistics, tokens=text_encoder("hashed-ngrams"))


@pytest.fixture(scope="module")
def motions() -> list[np.ndarray]:
    generator = np.random.default_rng(0)
    return [generator.normal(size=(n, 263)).astype(np.float32) for n in (60, 8, 31, 40, 4, 59)]


def test_an_embedding_does_not_depend_on_its_neighbours_in_the_batch(extractor, motions):
    together = extractor.embed_motions(motions)
    alone = np.concatenate([extractor.embed_motions([motion]) for motion in motions])
    np.testing.assert_allclose(together, alone, atol=1e-6)
    together = extractor.embed_texts(CAPTIONS)
    alone = np.concatenate([extractor.embed_texts([text]) for text in CAPTIONS])
    np.testing.assert_allclose(together, alone, atol=1e-6)


def test_shuffling_a_batch_changes_nothing(extractor, motions):
    order = np.array([3, 0, 5, 1, 4, 2])
    shuffled = extractor.embed_motions([motions[i] for i in order])
    np.testing.assert_allclose(shuffled, extractor.embed_motions(motions)[order], atol=1e-6)
    assert not np.allclose(shuffled, extractor.embed_motions(motions), atol=1e-3)


def test_what_exceeds_a_multiple_of_four_frames_and_the_contacts_are_not_seen(extractor, motions):
    changed = [motion.copy() for motion in motions]
    for motion in changed:
        motion[len(motion) // 4 * 4 :] = 9.0
        motion[:, 259:] = 9.0
    assert np.array_equal(extractor.embed_motions(changed), extractor.embed_motions(motions))
    changed[2][27, 0] += 1.0  # the last frame that counts, of 31
    assert not np.allclose(extractor.embed_motions(changed)[2], extractor.embed_motions(motions)[2], atol=1e-6)


def test_features_are_standardised_with_the_evaluators_own_statistics(extractor, motions):
    plain = Statistics(np.zeros(263, dtype=np.float32), np.ones(263, dtype=np.float32))
    networks = extractor.movement, extractor.motion, extractor.text
    unscaled = Extractor(TINY, *networks, statistics=plain, tokens=extractor.tokens)
    standardised = [extractor.statistics.standardise(motion) for motion in motions]
    np.testing.assert_allclose(unscaled.embed_motions(standardised), extractor.embed_motions(motions), atol=1e-6)


def test_motions_that_are_too_short_or_too_long_are_refused(extractor, motions):
    with pytest.raises(ValueError, match="motion 1: expected 4 to 60 frames, found 3"):
        extractor.embed_motions([motions[0], motions[0][:3]])
    with pytest.raises(ValueError, match="found 61"):
        extractor.embed_motions([np.zeros((61, 263), dtype=np.float32)])


def test_the_decoder_gives_back_four_frames_a_snippet():
    features, n_frames = torch.zeros(2, 24, 259), torch.tensor([24, 24])
    assert MovementDecoder(8)(MovementEncoder(8)(features, n_frames)).shape == (2, 24, 259)


def test_at_most_the_configured_number_of_tokens_is_read(extractor):
    long = " ".join(f"word{i}" for i in range(32))
    networks = extractor.movement, extractor.motion, extractor.text
    two = EvaluatorConfiguration(
        movement_width=8, motion_width=6, text_width=6, embedding=5, text="hashed-ngrams", most_tokens=2
    )
    short = Extractor(two, *networks, statistics=extractor.statistics, tokens=extractor.tokens)
    np.testing.assert_allclose(short.embed_texts([long]), extractor.embed_texts(["word0 word1"]), atol=1e-6)


def test_the_decoder_ends_with_the_bias_of_its_last_layer_where_that_has_no_weights():
    decoder = MovementDecoder(8)
    last = decoder.convolutions[-1]
    assert isinstance(last, nn.ConvTranspose1d)
    assert last.bias is not None
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.arange(259.0))
        features = decoder(torch.randn(2, 3, 8))
    assert torch.equal(features, torch.arange(259.0).expand(2, 12, 259))
