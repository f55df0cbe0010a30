"""Text encoders: the built-in one never changes; pretrained ones give transformers' own vectors, without pickles."""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import InputFileError, MissingExtraError, UsageError
from prbench.text import DIMENSION, HashedNgrams, TextEncoder, ngrams, text_encoder, words
from tests.text import tiny_clip
from tests.text.tiny_clip import END, START, VOCABULARY

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


# CLIP


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("transformers")
    return tiny_clip.write(tmp_path_factory.mktemp("clip"))


def _pieces(*pieces: str) -> list[int]:
    return [START, *(VOCABULARY.index(piece) for piece in pieces), END]


def _as_the_original_does(ids: list[int]) -> np.ndarray:
    """Padded with zeros to 77 pieces, read off at the highest id: transformers' own vector for the whole model."""
    import torch

    padded = torch.zeros(1, 77, dtype=torch.long)
    padded[0, : len(ids)] = torch.tensor(ids)
    with torch.no_grad():
        return tiny_clip.model()(input_ids=padded).text_embeds.numpy()


def test_a_text_is_one_token_with_the_vector_of_the_whole_model(folder):
    encoded = text_encoder("clip-vit-b32", folder).encode(["Puts a", "a  cat."])
    assert encoded.tokens.shape == (2, 1, 512)
    assert not encoded.padding.any()
    for row, ids in enumerate([_pieces("puts</w>", "a</w>"), _pieces("a</w>", "c", "a", "t</w>", ".</w>")]):
        np.testing.assert_allclose(encoded.tokens[row], _as_the_original_does(ids), atol=1e-5)
    assert np.abs(encoded.tokens[0] - encoded.tokens[1]).max() > 0.1


def test_a_caption_is_cut_after_twenty_word_pieces(folder):
    encode = text_encoder("clip-vit-b32", folder).encode
    twenty = encode([" ".join("abcdefghijklmnopqrst")]).tokens
    longer = encode([" ".join("abcdefghijklmnopqrst") + " puts x y z"]).tokens
    assert np.array_equal(twenty, longer)
    np.testing.assert_allclose(
        twenty[0], _as_the_original_does(_pieces(*(f"{letter}</w>" for letter in "abcdefghijklmnopqrst"))), atol=1e-5
    )
    assert not np.array_equal(twenty, encode([" ".join("abcdefghijklmnopqrs")]).tokens)


def test_an_empty_text_has_a_vector_too(folder):
    encoded = text_encoder("clip-vit-b32", folder).encode([""])
    np.testing.assert_allclose(encoded.tokens[0], _as_the_original_does([START, END]), atol=1e-5)


def test_the_end_of_a_text_is_found_whatever_the_configuration_calls_it(folder, tmp_path):
    """The public file names piece 2, newer ones the true number."""
    other = tiny_clip.write(tmp_path / "other", eos_token_id=END)
    found, expected = (text_encoder("clip-vit-b32", path).encode(["a cat"]).tokens for path in (folder, other))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_files_of_a_whole_clip_will_do_as_well(folder, tmp_path, capfd):
    transformers = pytest.importorskip("transformers")
    vision = {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "num_attention_heads": 1}
    whole = transformers.CLIPModel(
        transformers.CLIPConfig(
            text_config=tiny_clip.text_configuration().to_dict(),
            vision_config={**vision, "image_size": 8, "patch_size": 8},
            projection_dim=512,
        )
    )
    tower = tiny_clip.model()
    whole.text_model.load_state_dict(tower.text_model.state_dict())
    whole.text_projection.load_state_dict(tower.text_projection.state_dict())
    whole.save_pretrained(tmp_path, safe_serialization=True)
    tiny_clip.write_vocabulary(tmp_path)
    capfd.readouterr()
    found, expected = (text_encoder("clip-vit-b32", path).encode(["a cat"]).tokens for path in (tmp_path, folder))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert "vision_model" not in capfd.readouterr().err


def test_the_command_of_the_message_makes_a_folder_that_works(folder, tmp_path, monkeypatch):
    transformers = pytest.importorskip("transformers")
    monkeypatch.chdir(tmp_path)
    for part in (transformers.CLIPTextModelWithProjection, transformers.CLIPTokenizerFast):
        part.from_pretrained(str(folder)).save_pretrained("clip-vit-b32")
    paths = (tmp_path / "clip-vit-b32", folder)
    made, expected = (text_encoder("clip-vit-b32", path).encode(["a cat"]).tokens for path in paths)
    np.testing.assert_allclose(made, expected, atol=1e-5)


def test_another_dimension_of_clip_is_refused(tmp_path):
    pytest.importorskip("transformers")
    with pytest.raises(InputFileError, match="a model of dimension 32"):
        text_encoder("clip-vit-b32", tiny_clip.write(tmp_path, projection_dim=32)).encode(["puts"])


def test_what_a_file_lacks_is_not_filled_with_random_numbers(tmp_path):
    transformers = pytest.importorskip("transformers")
    tiny_clip.write_vocabulary(tmp_path)
    transformers.CLIPTextModel(tiny_clip.text_configuration()).save_pretrained(tmp_path, safe_serialization=True)
    with pytest.raises(InputFileError, match=r"a model without 'text_projection\.weight'"):
        text_encoder("clip-vit-b32", tmp_path).encode(["puts"])


@pytest.mark.parametrize("missing", [("vocab.json",), ("merges.txt", "vocab.json")])
def test_a_model_without_its_vocabulary_is_refused(folder, tmp_path, missing):
    copied = shutil.copytree(folder, tmp_path / "copy", ignore=shutil.ignore_patterns(*missing))
    with pytest.raises(InputFileError, match=r"found (a vocabulary of|none that can be loaded)"):
        text_encoder("clip-vit-b32", copied).encode(["puts"])


# DistilBERT

WORDS = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", "the", "person", "moves", "and", "pick", "##s", "puts", "."]


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory):
    """One layer with random weights in DistilBERT's own files, and what transformers makes of one text."""
    torch = pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    folder = tmp_path_factory.mktemp("distilbert")
    (folder / "vocab.txt").write_text("\n".join(WORDS) + "\n", encoding="utf-8")
    transformers.DistilBertTokenizerFast(str(folder / "vocab.txt")).save_pretrained(folder)
    config = transformers.DistilBertConfig(vocab_size=len(WORDS), n_layers=1, n_heads=2, hidden_dim=16, dim=768)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = transformers.DistilBertModel(config).eval()
    model.save_pretrained(folder, safe_serialization=True)
    ids = torch.tensor([[2, 5, 6, 9, 10, 3]])  # [CLS] the person pick ##s [SEP]
    with torch.no_grad():
        states = model(input_ids=ids).last_hidden_state[0].numpy()
    return folder, states


def test_all_word_pieces_and_both_special_ones_are_tokens(tiny_model):
    folder, expected = tiny_model
    encoded = text_encoder("distilbert", folder).encode(["The Person picks", "puts"])
    assert encoded.tokens.shape == (2, 6, 768)
    assert encoded.padding.tolist() == [[False] * 6, [False] * 3 + [True] * 3]
    np.testing.assert_allclose(encoded.tokens[0], expected, atol=1e-6)
    assert not encoded.tokens[1, 3:].any()


def test_an_empty_text_has_its_two_special_tokens(tiny_model):
    assert text_encoder("distilbert", tiny_model[0]).encode([""]).padding.tolist() == [[False, False]]


def test_a_file_that_lacks_parameters_is_refused_instead_of_filled_with_random_numbers(tiny_model, tmp_path):
    safetensors = pytest.importorskip("safetensors.numpy")
    copied = shutil.copytree(tiny_model[0], tmp_path / "copy")
    tensors = safetensors.load_file(copied / "model.safetensors")
    del tensors["transformer.layer.0.ffn.lin1.bias"]
    safetensors.save_file(tensors, copied / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(InputFileError, match=r"a model without 'transformer\.layer\.0\.ffn\.lin1\.bias'"):
        text_encoder("distilbert", copied).encode(["puts"])


def test_another_dimension_is_refused(tmp_path, tiny_model):
    transformers = pytest.importorskip("transformers")
    config = transformers.DistilBertConfig(vocab_size=len(WORDS), n_layers=1, n_heads=2, hidden_dim=16, dim=32)
    transformers.DistilBertTokenizerFast(str(tiny_model[0] / "vocab.txt")).save_pretrained(tmp_path)
    transformers.DistilBertModel(config).save_pretrained(tmp_path, safe_serialization=True)
    with pytest.raises(InputFileError, match="a model of dimension 32"):
        text_encoder("distilbert", tmp_path).encode(["puts"])


# both pretrained encoders

PRETRAINED = pytest.mark.parametrize("name", ["clip-vit-b32", "distilbert"])


@pytest.fixture
def files_of(folder, tiny_model) -> Callable[[str], Path]:
    """The folder of a tiny model."""
    return lambda name: folder if name == "clip-vit-b32" else tiny_model[0]


@PRETRAINED
def test_a_text_has_the_same_vectors_alone_and_beside_others(name, files_of):
    alone = text_encoder(name, files_of(name)).encode(["puts ."]).tokens[0]
    beside = text_encoder(name, files_of(name)).encode(["the person moves and picks .", "puts ."]).tokens[1]
    assert np.array_equal(beside[: len(alone)], alone)


@PRETRAINED
def test_a_text_goes_through_the_network_once(name, files_of, monkeypatch):
    encoder = text_encoder(name, files_of(name))
    encoder.encode(["the person", "the person", "puts"])
    monkeypatch.setattr(encoder, "_loaded", (None, None))  # a second pass would fail
    encoder.encode(["puts", "the person"])
    with pytest.raises(TypeError):
        encoder.encode(["moves"])


@pytest.mark.parametrize(
    ("name", "variable", "shape"),
    [("clip-vit-b32", "PRBENCH_CLIP", (1, 1, 512)), ("distilbert", "PRBENCH_DISTILBERT", (1, 3, 768))],
)
def test_the_environment_names_the_folder(name, variable, shape, files_of, monkeypatch):
    monkeypatch.setenv(variable, str(files_of(name)))
    encoder = text_encoder(name)
    assert isinstance(encoder, TextEncoder)
    assert (encoder.name, encoder.dimension) == (name, shape[-1])
    assert encoder.encode(["puts"]).tokens.shape == shape


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("clip-vit-b32", r"no such folder.*save_pretrained\('clip-vit-b32'\).*PRBENCH_CLIP"),
        ("distilbert", r"no such folder.*model\.safetensors.*PRBENCH_DISTILBERT"),
    ],
)
def test_a_missing_folder_says_how_to_make_one_and_where_to_name_it(name, told, tmp_path):
    pytest.importorskip("transformers")
    with pytest.raises(InputFileError, match=told):
        text_encoder(name, tmp_path / "nowhere").encode(["puts"])


@PRETRAINED
def test_pickled_weights_are_not_read(name, files_of, tmp_path):
    torch = pytest.importorskip("torch")
    copied = shutil.copytree(files_of(name), tmp_path / "copy", ignore=shutil.ignore_patterns("*.safetensors"))
    torch.save({}, copied / "pytorch_model.bin")
    with pytest.raises(InputFileError, match="none that can be loaded"):
        text_encoder(name, copied).encode(["puts"])


@PRETRAINED
def test_without_transformers_the_extra_is_named(name, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'prbench\[text\]'"):
        text_encoder(name)


def test_a_machine_without_internet_is_told_at_once_and_not_after_minutes_of_attempts(monkeypatch, tmp_path):
    pytest.importorskip("transformers")
    import huggingface_hub

    asked = []
    monkeypatch.delenv("PRBENCH_DISTILBERT", raising=False)
    monkeypatch.setattr(huggingface_hub, "try_to_load_from_cache", lambda *_: None)

    def unreachable(_self: object, name: str, timeout: float) -> None:
        asked.append((name, timeout))
        raise ConnectionError("Name or service not known")

    monkeypatch.setattr(huggingface_hub.HfApi, "model_info", unreachable)
    with pytest.raises(InputFileError, match=r"no answer from the model hub \(Name or service not known\).*Download"):
        text_encoder("distilbert").encode(["reach"])
    assert len(asked) == 1
