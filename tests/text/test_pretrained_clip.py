from __future__ import annotations

import importlib.util
import shutil

import numpy as np
import pytest

from prbench.errors import InputFileError, MissingExtraError
from prbench.text import CLIP_VARIABLE as VARIABLE
from prbench.text import TextEncoder, text_encoder
from tests.text import tiny_clip
from tests.text.tiny_clip import END, START, VOCABULARY


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


def test_a_text_has_the_same_vector_alone_and_beside_others(folder):
    encoder = text_encoder("clip-vit-b32", folder)
    beside = encoder.encode(["puts a cat", "puts"]).tokens[1]
    assert np.array_equal(beside, text_encoder("clip-vit-b32", folder).encode(["puts"]).tokens[0])


def test_a_text_goes_through_the_network_once(folder, monkeypatch):
    encoder = text_encoder("clip-vit-b32", folder)
    encoder.encode(["puts"])
    monkeypatch.setattr(encoder, "_loaded", (None, None))  # a second pass would fail
    encoder.encode(["puts"])
    with pytest.raises(TypeError):
        encoder.encode(["cat"])


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


def test_the_environment_names_the_folder(folder, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(folder))
    encoder = text_encoder("clip-vit-b32")
    assert isinstance(encoder, TextEncoder)
    assert (encoder.name, encoder.dimension) == ("clip-vit-b32", 512)
    assert encoder.encode(["puts"]).tokens.shape == (1, 1, 512)


def test_a_missing_folder_says_how_to_make_one_and_where_to_name_it(tmp_path):
    pytest.importorskip("transformers")
    with pytest.raises(InputFileError, match=r"no such folder.*save_pretrained\('clip-vit-b32'\).*PRBENCH_CLIP"):
        text_encoder("clip-vit-b32", tmp_path / "nowhere").encode(["puts"])


def test_the_command_of_the_message_makes_a_folder_that_works(folder, tmp_path, monkeypatch):
    transformers = pytest.importorskip("transformers")
    monkeypatch.chdir(tmp_path)
    for part in (transformers.CLIPTextModelWithProjection, transformers.CLIPTokenizerFast):
        part.from_pretrained(str(folder)).save_pretrained("clip-vit-b32")
    paths = (tmp_path / "clip-vit-b32", folder)
    made, expected = (text_encoder("clip-vit-b32", path).encode(["a cat"]).tokens for path in paths)
    np.testing.assert_allclose(made, expected, atol=1e-5)


def test_pickled_weights_are_not_read(folder, tmp_path):
    torch = pytest.importorskip("torch")
    copied = shutil.copytree(folder, tmp_path / "copy", ignore=shutil.ignore_patterns("*.safetensors"))
    torch.save({}, copied / "pytorch_model.bin")
    with pytest.raises(InputFileError, match="none that can be loaded"):
        text_encoder("clip-vit-b32", copied).encode(["puts"])


def test_another_dimension_is_refused(tmp_path):
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


def test_without_transformers_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'prbench\[text\]'"):
        text_encoder("clip-vit-b32")
