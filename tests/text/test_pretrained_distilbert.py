from __future__ import annotations

import importlib.util
import shutil

import numpy as np
import pytest

from prbench.errors import InputFileError, MissingExtraError
from prbench.text import DISTILBERT_VARIABLE as VARIABLE
from prbench.text import TextEncoder, text_encoder

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


def test_a_text_has_the_same_vectors_alone_and_beside_others(tiny_model):
    folder, _ = tiny_model
    alone = text_encoder("distilbert", folder).encode(["puts ."]).tokens[0]
    beside = text_encoder("distilbert", folder).encode(["the person moves and picks .", "puts ."]).tokens[1]
    assert np.array_equal(beside[: len(alone)], alone)


def test_a_text_goes_through_the_network_once(tiny_model, monkeypatch):
    encoder = text_encoder("distilbert", tiny_model[0])
    encoder.encode(["the person", "the person", "puts"])
    monkeypatch.setattr(encoder, "_loaded", (None, None))  # a second pass would fail
    encoder.encode(["puts", "the person"])
    with pytest.raises(TypeError):
        encoder.encode(["moves"])


def test_an_empty_text_has_its_two_special_tokens(tiny_model):
    assert text_encoder("distilbert", tiny_model[0]).encode([""]).padding.tolist() == [[False, False]]


def test_the_environment_names_the_folder(tiny_model, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tiny_model[0]))
    encoder = text_encoder("distilbert")
    assert isinstance(encoder, TextEncoder)
    assert (encoder.name, encoder.dimension) == ("distilbert", 768)
    assert encoder.encode(["puts"]).tokens.shape == (1, 3, 768)


def test_a_missing_folder_says_what_to_download_and_where_to_name_it(tmp_path):
    with pytest.raises(InputFileError, match=r"no such folder.*model\.safetensors.*PRBENCH_DISTILBERT"):
        text_encoder("distilbert", tmp_path / "nowhere").encode(["puts"])


def test_pickled_weights_are_not_read(tiny_model, tmp_path):
    torch = pytest.importorskip("torch")
    for file in tiny_model[0].iterdir():
        if file.name != "model.safetensors":
            (tmp_path / file.name).write_bytes(file.read_bytes())
    torch.save({}, tmp_path / "pytorch_model.bin")
    with pytest.raises(InputFileError, match="none that can be loaded"):
        text_encoder("distilbert", tmp_path).encode(["puts"])


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


def test_without_transformers_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'prbench\[text\]'"):
        text_encoder("distilbert")
