from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from prbench.errors import AdapterError
from prbench_adapters.diffusion import method


@pytest.fixture
def shipped(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "shipped" / "mdm" / "weights"
    folder.mkdir(parents=True)
    for name in ("mdm-small.safetensors", "mdm-small.json", "pr-small-goal-loc.safetensors"):
        (folder / name).touch()
    monkeypatch.setattr(method, "files", lambda package: tmp_path / "shipped")
    return folder


def test_the_default_is_a_bundled_file(shipped):
    assert method.resolve(None, "mdm-small") == shipped / "mdm-small.safetensors"
    assert method.bundled_names() == ["mdm-small", "pr-small-goal-loc"]


def test_a_bundled_name_may_be_given(shipped, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert method.resolve(Path("pr-small-goal-loc"), "mdm-small") == shipped / "pr-small-goal-loc.safetensors"


def test_a_file_of_that_name_comes_before_the_bundled_one(shipped, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mdm-small").touch()
    assert method.resolve(Path("mdm-small"), "mdm-small") == Path("mdm-small")


def test_a_folder_stands_for_the_one_weights_file_in_it(shipped, tmp_path):
    (tmp_path / "trained").mkdir()
    file = tmp_path / "trained" / "weights.safetensors"
    with pytest.raises(AdapterError, match=r"expected one \.safetensors file in the folder, found none"):
        method.resolve(file.parent, "mdm-small")
    file.touch()
    assert method.resolve(file.parent, "mdm-small") == file
    (file.parent / "average.safetensors").touch()
    with pytest.raises(AdapterError, match=r"found average\.safetensors, weights\.safetensors\. Name the file"):
        method.resolve(file.parent, "mdm-small")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mdm-smal", r"weights 'mdm-smal': .*bundled weights \(mdm-small, pr-.*Did you mean 'mdm-small'\?"),
        ("gone.safetensors", r"gone\.safetensors: expected a file or folder, found neither"),
        ("no/such/weights", r"weights: expected a file or folder, found neither"),
    ],
)
def test_what_is_not_there_is_named(shipped, tmp_path, monkeypatch, given, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AdapterError, match=message):
        method.resolve(Path(given), "mdm-small")


def test_an_installation_without_weights_says_so(shipped):
    for file in shipped.iterdir():
        file.unlink()
    with pytest.raises(AdapterError, match="none in this installation"):
        method.resolve(None, "mdm-small")


def test_weights_of_every_method_are_found_by_a_name_of_their_own_and_have_cards():
    files = list(Path(str(resources.files("prbench_adapters"))).rglob("*.safetensors"))
    assert sorted(file.stem for file in files) == method.bundled_names()
    for file in files:
        assert method.resolve(None, file.stem) == file
        assert file.with_suffix(".json").is_file()
