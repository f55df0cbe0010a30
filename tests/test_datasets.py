"""Readers of installed packages: found by their metadata; what is wrong with one hides no other."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.datasets import find_reader, installed_readers, readable_datasets
from prbench.errors import InputFileError, UsageError
from prbench.protocol.manifests import dataset_names, load_manifest
from prbench.readers import reader_for
from prbench.readers.discover import usable_readers

READER = """
from dataclasses import dataclass
from prbench.readers import ReaderOptions

@dataclass(frozen=True)
class Reader:
    dataset: str = "{dataset}"
    options: ReaderOptions = ReaderOptions()

    def find(self, root):
        return ()

    def read(self, found):
        raise NotImplementedError

READER = Reader()
"""
MANIFEST = """
schema = 1
name = "{dataset}"
title = "Made up"
homepage = ""
how_to_obtain = ""
licence = ""
redistribution = "none"
citation = "@misc{{a}}"
required_files = []
optional_files = []
rates_hz = {{}}
body = {{ pose_source = "nobody", head_tilt_deg = 0.0 }}
"""
OWN = ("adt", "gimo", "hd-epic", "hot3d", "mogaze", "own")


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Installs a package of one module that offers a reader under a name."""

    def _install(name: str, *, package: str = "other_data", source: str = READER, manifest: str = MANIFEST) -> None:
        site = tmp_path / package
        info = site / f"{package}-1.2.dist-info"
        info.mkdir(parents=True)
        (site / f"{package}.py").write_text(source.format(dataset=name) if source is READER else source)
        if manifest:
            (site / f"{name}.toml").write_text(manifest.format(dataset=name) if manifest is MANIFEST else manifest)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[prbench.readers]\n{name} = {package}:READER\n")
        monkeypatch.syspath_prepend(str(site))
        monkeypatch.delitem(sys.modules, package, raising=False)

    yield _install
    load_manifest.cache_clear()


def _problem(package: str = "other_data") -> str:
    (reader,) = [reader for reader in installed_readers() if reader.package == package]
    return reader.problem


def test_a_reader_of_another_package_is_found_with_its_manifest(install) -> None:
    install("made-up")
    assert set(readable_datasets()) == {*OWN, "made-up"}
    assert {"made-up", "nymeria"} <= set(dataset_names())
    assert reader_for("made-up").dataset == "made-up"
    assert reader_for("synthetic-made-up").dataset == "made-up"
    assert load_manifest("made-up").title == "Made up"
    assert all(find_reader(name).built_in for name in OWN)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("adt", "'adt' is a dataset of prbench already"),
        ("hdepic", "'hd-epic' is a dataset of prbench already"),
        ("nymeria", "'nymeria' is a dataset of prbench already"),
        ("all", "reserved word"),
        ("check", "reserved word"),
        ("synthetic-adt", "reserved word"),
        ("Made_Up", "expected a name of at most 60 characters of a to z"),
        ("x" * 61, "expected a name of at most 60 characters"),
    ],
)
def test_a_name_that_is_not_its_own_is_refused_and_hides_nobody(install, name, problem) -> None:
    install(name, manifest="")
    assert problem in _problem()
    assert readable_datasets() == OWN
    assert reader_for("adt").dataset == "adt"


def test_a_name_that_two_packages_offer_is_used_by_neither(install) -> None:
    install("made-up", package="one_data")
    install("made-up", package="two_data")
    assert _problem("one_data") == _problem("two_data") == "it is offered more than once, by one_data and two_data"
    with pytest.raises(UsageError, match="offered more than once, by one_data and two_data"):
        reader_for("made-up")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import nowhere_at_all", "cannot be imported: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("raise SystemExit(3)", "cannot be imported: SystemExit: 3"),
        ("READER = 3", "expected an instance of a frozen data class .* found int"),
        (READER.format(dataset="another"), "it reads 'another'; both names must be the same"),
    ],
)
def test_a_broken_reader_is_named_in_the_list_and_when_it_is_asked_for(install, source, message, tmp_path, capsys):
    install("made-up", source=source)
    with pytest.raises(UsageError, match=message):
        reader_for("made-up")
    usable, unusable = usable_readers()
    assert tuple(reader.dataset for reader in usable) == OWN
    assert len(unusable) == 1
    assert main(["datasets"]) == 0
    assert "! reader of 'made-up' (package other_data 1.2, other_data:READER): " in capsys.readouterr().out
    empty = tmp_path / "empty"
    empty.mkdir()
    assert main(["inspect", str(empty)]) != 0
    assert "reader of 'made-up'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ("", "made-up.toml"),
        ("schema = ", "expected a TOML file"),
        (MANIFEST.format(dataset="made-up") + "tilt = 3", "tilt"),
        (MANIFEST.format(dataset="another"), "expected name = 'made-up' and kind = 'benchmark'"),
    ],
)
def test_a_manifest_that_does_not_fit_is_named(install, manifest, message) -> None:
    install("made-up", manifest=manifest)
    with pytest.raises(InputFileError, match=message):
        load_manifest("made-up")
    assert tuple(reader.dataset for reader in usable_readers()[0]) == OWN


def test_a_module_that_is_not_there_is_named(install) -> None:
    install("made-up")
    (Path(sys.path[0]) / "other_data.py").unlink()
    with pytest.raises(UsageError, match="there is no module 'other_data'"):
        load_manifest("made-up")


def test_a_search_that_fails_unforeseen_is_told_and_hides_nobody(install, tmp_path) -> None:
    from prbench.readers.discover import discover

    install("made-up", source=READER.format(dataset="made-up").replace("return ()", "return 1 / 0"))
    (tmp_path / "data").mkdir()
    discovery = discover(tmp_path / "data")
    (broken,) = discovery.broken
    assert broken.dataset == "made-up"
    assert "ZeroDivisionError" in broken.message


def test_an_unknown_dataset_is_answered_with_the_nearest_known_one() -> None:
    with pytest.raises(UsageError, match=r"no reader for 'atd'\. Did you mean 'adt'.*adt, gimo, hd-epic"):
        find_reader("atd")
