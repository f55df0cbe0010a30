"""Words and networks of the evaluator."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from prbench.errors import InputFileError
from prbench.representation import Statistics
from prbench.text import text_encoder
from prbench_benchmarks.text_to_motion.clips import Extractor
from prbench_benchmarks.text_to_motion.networks import (
    LISTS,
    POS_CLASSES,
    EvaluatorConfiguration,
    GloveCaptions,
    MovementDecoder,
    MovementEncoder,
    TextEncoder,
    WordVectors,
    motion_encoder,
)

WORDS = ["unk", "sos", "eos", "walk", "left", "hand"]


@pytest.fixture
def vocabulary(tmp_path):
    (tmp_path / "words.txt").write_text("\n".join(WORDS) + "\n")
    vectors = np.repeat(np.arange(len(WORDS), dtype=np.float64)[:, None], 300, axis=1)
    np.save(tmp_path / "vectors.npy", vectors)
    for name, words in zip(LISTS, (["left"], ["hand"], [], ["walk"], ["left"])):
        (tmp_path / f"{name}.txt").write_text("\n".join(words))
    return tmp_path


def classes(vectors: np.ndarray) -> list[str]:
    assert np.array_equal(vectors[:, 300:].sum(axis=1), np.ones(len(vectors)))
    return [POS_CLASSES[index] for index in vectors[:, 300:].argmax(axis=1)]


def test_captions_are_framed_and_listed_words_get_their_class(vocabulary):
    vectors = WordVectors.read(vocabulary).encode("walk/VERB the/DET left/ADJ hand/NOUN eos/NOUN")
    assert vectors[:, 0].tolist() == [1, 3, 0, 4, 5, 2, 2]
    assert classes(vectors) == ["OTHER", "Act_VIP", "OTHER", "Loc_VIP", "Body_VIP", "NOUN", "OTHER"]


def test_captions_are_cut_to_20_words(vocabulary):
    vectors = WordVectors.read(vocabulary).encode(" ".join(["walk/VERB"] * 30))
    assert len(vectors) == 22
    assert vectors[-1, 0] == 2


def test_a_class_that_is_not_known_is_other(vocabulary):
    assert classes(WordVectors.read(vocabulary).encode("eos/INTJ sos/ADV")) == ["OTHER", "OTHER", "ADV", "OTHER"]


def test_the_text_encoder_adds_the_class_to_the_word(vocabulary):
    tokens = torch.from_numpy(WordVectors.read(vocabulary).encode("walk/VERB"))[None]
    network = TextEncoder(EvaluatorConfiguration(text_width=4, embedding=3), 315).eval()
    with torch.no_grad():
        own = network(tokens, torch.tensor([3]))
        assert network.classes is not None
        by_hand = network.sequence(tokens[..., :300] + network.classes(tokens[..., 300:]), torch.tensor([3]))
        tokens[0, 1, 300:] = 0.0
        without = network(tokens, torch.tensor([3]))
    assert torch.equal(own, by_hand)
    assert not torch.allclose(own, without)


def test_captions_without_tokens_are_refused_by_name(vocabulary):
    source = GloveCaptions(WordVectors.read(vocabulary), {"He walks.": "walk/VERB", "Hm.": ""}, source="corpora/x")
    assert source.encode(["He walks."]).tokens.shape == (1, 3, 315)
    with pytest.raises(InputFileError, match=r"corpora/x.*'Hm\.'.*hashed-ngrams"):
        source.encode(["He walks.", "Hm."])


def test_files_that_do_not_fit_are_refused(vocabulary, tmp_path):
    (vocabulary / "words.txt").write_text("\n".join([*WORDS, "one more"]))
    with pytest.raises(InputFileError, match=r"expected an array of shape \(7, 300\).*found shape \(6, 300\)"):
        WordVectors.read(vocabulary)
    (vocabulary / "words.txt").write_text("\n".join(["a", *WORDS[1:]]))
    with pytest.raises(InputFileError, match="the word 'unk'"):
        WordVectors.read(vocabulary)
    np.save(vocabulary / "vectors.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputFileError, match=r"vectors\.npy: expected numbers or text, found Python objects"):
        WordVectors.read(vocabulary)
    (vocabulary / "Loc_VIP.txt").unlink()
    np.save(vocabulary / "vectors.npy", np.zeros((6, 300)))
    (vocabulary / "words.txt").write_text("\n".join(WORDS))
    with pytest.raises(InputFileError, match=r"Loc_VIP\.txt: expected a text file.*no such file"):
        WordVectors.read(vocabulary)


def test_the_digest_names_words_vectors_and_lists(vocabulary):
    first = WordVectors.read(vocabulary).digest
    assert WordVectors.read(vocabulary).digest == first
    (vocabulary / "Obj_VIP.txt").write_text("eos\n")
    assert WordVectors.read(vocabulary).digest != first


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
