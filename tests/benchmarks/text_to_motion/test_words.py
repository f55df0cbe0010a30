from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.errors import InputFileError
from prbench_benchmarks.text_to_motion.networks import (
    LISTS,
    POS_CLASSES,
    EvaluatorConfiguration,
    GloveCaptions,
    TextEncoder,
    WordVectors,
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
