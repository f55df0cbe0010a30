from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.text import DIMENSION, HashedNgrams, TextEncoder, ngrams, text_encoder, words

SENTENCES = (
    "The person moves across and picks an object.",
    "C walks 3 steps, then puts the cup down",
    "",
    "Café №5 — ok",
)


def test_the_vectors_never_change():
    """The bundled weights are trained on these bytes. If this fails, the encoder is wrong and not the test."""
    encoded = HashedNgrams().encode(SENTENCES)
    digest = hashlib.sha256(encoded.tokens.astype("<f4").tobytes() + encoded.padding.tobytes()).hexdigest()
    assert digest == "4e9dc160547692d331449857d3a9b7ab2a959f47bf6a0088167fdae1143b3aab"


def test_one_vector_worked_by_hand():
    def integers(kind: str) -> list[int]:
        parts = [
            hashlib.sha256(f"prbench/hashed-ngrams/{kind}/{part}/{text}".encode()).digest()
            for text in [{"word": "a", "ngram": "<a>"}[kind]]
            for part in range(4)
        ]
        found = b"".join(parts)
        return [2 * (found[2 * i] + 256 * found[2 * i + 1]) - 65535 for i in range(64)]

    unit = (3 / (65536**2 - 1)) ** 0.5
    expected = [(a + b) * unit / 2**0.5 for a, b in zip(integers("word"), integers("ngram"))]
    np.testing.assert_allclose(HashedNgrams().encode(["a"]).tokens[0, 0], expected, rtol=1e-6)


def test_words_are_lower_case_runs_of_letters_and_digits():
    assert words("Picks-up the CUP_2, isn't it?") == ["picks", "up", "the", "cup", "2", "isn", "t", "it"]


def test_ngrams_have_boundary_marks():
    assert ngrams("cup") == ("<cu", "cup", "up>", "<cup", "cup>", "<cup>")
    assert ngrams("a") == ("<a>",)


def test_an_empty_text_is_one_zero_token_that_is_no_padding():
    encoded = HashedNgrams().encode(["", "pick up", "…"])
    assert encoded.padding.tolist() == [[False, True], [False, False], [False, True]]
    assert not encoded.tokens[[0, 2]].any()


def test_a_text_has_the_same_vectors_alone_and_beside_longer_ones():
    alone = HashedNgrams().encode(["picks a cup"]).tokens[0]
    beside = HashedNgrams().encode(["one two three four five", "picks a cup"])
    assert np.array_equal(beside.tokens[1, :3], alone)
    assert not beside.tokens[1, 3:].any()


def test_at_most_32_words_are_kept():
    assert HashedNgrams().encode(["word " * 40]).tokens.shape == (1, 32, DIMENSION)


def test_vectors_have_unit_variance_and_inflections_are_neighbours():
    names = ["".join(letters) for letters in np.random.default_rng(0).choice(list("abcdefghijklmnop"), (500, 6))]
    vectors = np.concatenate([HashedNgrams().encode([name]).tokens[0] for name in names])
    assert vectors.std() == pytest.approx(1.0, abs=0.02)
    assert vectors.mean() == pytest.approx(0.0, abs=0.03)
    pick, picks, places = HashedNgrams().encode(["pick picks places"]).tokens[0]
    assert pick @ picks > 0.25 * (pick @ pick) > abs(pick @ places)


def test_composed_and_decomposed_letters_are_one():
    assert np.array_equal(HashedNgrams().encode(["caf\u00e9"]).tokens, HashedNgrams().encode(["cafe\u0301"]).tokens)


def test_it_is_a_text_encoder_and_reads_no_files():
    encoder = text_encoder("hashed-ngrams")
    assert isinstance(encoder, TextEncoder)
    assert (encoder.name, encoder.dimension) == ("hashed-ngrams", 64)
    with pytest.raises(UsageError, match="reads no files"):
        text_encoder("hashed-ngrams", "folder")


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(UsageError, match="Did you mean 'hashed-ngrams'"):
        text_encoder("hash-ngrams")


def test_importing_the_room_imports_neither_torch_nor_transformers():
    code = """
import sys
from prbench.text import text_encoder
text_encoder("hashed-ngrams").encode(["a"])
print("torch" in sys.modules, "transformers" in sys.modules)
"""
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["False", "False"]
