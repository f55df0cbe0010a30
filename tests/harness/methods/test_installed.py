"""What package metadata say about methods, however damaged they are."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.errors import AdapterError
from prbench.harness.methods.installed import (
    InstalledEntry,
    entry_points_of,
    list_adapters,
    no_such_method,
    offered_twice,
)
from prbench.harness.methods.loading import find_adapter


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Puts a ``.dist-info`` folder on the path, with whatever metadata are given."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def _package(name: str, entry_points: str | bytes, *, metadata: str | None = None) -> Path:
        info = site / f"{name}-1.0.dist-info"
        info.mkdir()
        if isinstance(entry_points, str):
            entry_points = entry_points.encode()
        (info / "entry_points.txt").write_bytes(entry_points)
        if metadata is None:
            metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
        if metadata:
            (info / "METADATA").write_text(metadata)
        return info

    return _package


def test_a_source_checkout_on_the_path_is_prbench_itself(tmp_path, monkeypatch):
    info = tmp_path / "prbench.egg-info"  # as an editable installation leaves it, without a version
    info.mkdir()
    (info / "entry_points.txt").write_text("[prbench.adapters]\nstatic = prbench_adapters.static:load\n")
    (info / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: prbench\nVersion: 0.1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (static,) = [adapter for adapter in list_adapters() if adapter.name == "static"]
    assert (static.built_in, static.version, static.problem) == (True, "0.1", "")


def _mine() -> list[InstalledEntry]:
    return [adapter for adapter in list_adapters() if adapter.package != "prbench"]


def test_a_line_that_is_no_entry_point_is_named_and_hides_nobody(package):
    package("broken", "[prbench.adapters]\nthis is no entry point\nfine = broken:load\n")
    package(
        "other", "[console_scripts]\nother = other:main\n\n[prbench.adapters]\n# a comment\nother=other.a:load [gpu]\n"
    )
    bad, fine, other = sorted(_mine(), key=lambda adapter: (adapter.package, -len(adapter.problem)))
    assert bad.problem == "entry_points.txt: expected 'name = module:callable', found 'this is no entry point'"
    assert (fine.name, fine.target, fine.problem) == ("fine", "broken:load", "")
    assert (other.name, other.target, other.problem) == ("other", "other.a:load [gpu]", "")
    assert "static" in {adapter.name for adapter in list_adapters()}


@pytest.mark.parametrize("target", ["module_only", "", "3d:load", "a b:load", "module:", "https://example.org/x:load"])
def test_a_target_that_names_no_callable_is_a_problem_of_that_method_only(package, target):
    package("broken", f"[prbench.adapters]\nbroken = {target}\n")
    (broken,) = _mine()
    assert broken.problem == f"entry point: expected 'module:callable', found '{target}'"
    with pytest.raises(AdapterError, match=r"adapter 'broken' \(package broken\): entry point: expected"):
        find_adapter("broken")


@pytest.mark.parametrize("metadata", ["", "Name: nameless\n", "\x00\x01 no metadata at all", "Version: 2\n"])
def test_missing_names_and_versions_do_not_matter(package, metadata):
    package("nameless", "[prbench.adapters]\nx = x:load\n", metadata=metadata)
    (found,) = _mine()
    assert (found.name, found.package) == ("x", "nameless")
    assert found.version in ("unknown", "2")


def test_entry_points_in_another_encoding_are_passed_over(package):
    package("latin", "[prbench.adapters]\nhülle = x:load\n".encode("latin-1"))
    assert _mine() == []


def test_the_copy_that_stands_first_on_the_path_is_the_installed_one(package, tmp_path, monkeypatch):
    package("mine", "[prbench.adapters]\nmine = old:load\n")
    first = tmp_path / "first"
    info = first / "Mine-2.0.dist-info"
    info.mkdir(parents=True)
    (info / "entry_points.txt").write_text("[prbench.adapters]\nmine = new:load\n")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: Mine\nVersion: 2.0\n")
    monkeypatch.syspath_prepend(str(first))
    assert _mine() == [InstalledEntry("mine", "Mine", "2.0", "new:load")]


def test_names_that_two_packages_offer_are_known(package):
    package("one", "[prbench.adapters]\nsame = one:load\nother = one:load\n")
    package("two", "[prbench.adapters]\nsame = two:load\n")
    assert offered_twice(list_adapters()) == {"same"}


def test_other_groups_are_read_as_robustly(package):
    package("broken", "[prbench.training_tasks]\nnonsense\nfine = broken:task\n")
    found = {point.name: point.value for point in entry_points_of("prbench.training_tasks")}
    assert found["fine"] == "broken:task"
    assert "t2m-evaluator" in found


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("sttic", " Did you mean 'static'?"),
        ("glide.toml", " A program is given as 'cmd:COMMAND', or as a .toml file that holds it."),
    ],
)
def test_an_unknown_name_is_answered_with_what_may_have_been_meant(name, hint):
    assert hint in str(no_such_method(name, ["static", "pr"]))


DAMAGED = "[prbench.adapters]\nthis is no entry point\nno-colon = module\n"


@pytest.mark.parametrize(
    "arguments", [["--help"], ["adapters", "list"], ["adapters", "list", "--json"], ["train", "--help"]]
)
def test_the_command_line_lives_with_damaged_packages(package, arguments, tmp_path):
    package("damaged", DAMAGED, metadata="Name: damaged\n")
    package("exploding", "[prbench.adapters]\nboom = exploding:load\n")
    (tmp_path / "site" / "exploding.py").write_text("import os; os._exit(7)")
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r}); from prbench.cli import main; sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    if "list" in arguments:
        assert "boom" in done.stdout
        assert "expected 'module:callable', found 'module'" in done.stdout


def test_the_list_marks_what_cannot_be_used(package, capsys):
    package("one", "[prbench.adapters]\nsame = one:load\nbare = one\n")
    package("two", "[prbench.adapters]\nsame = two:load\n")
    assert main(["adapters", "list"]) == 0
    lines = {line.split()[0] + line.split()[1]: line for line in capsys.readouterr().out.splitlines()}
    assert lines["sameone"].endswith("! offered more than once: uninstall all but one")
    assert lines["sametwo"].endswith("! offered more than once: uninstall all but one")
    assert lines["bareone"].endswith("! entry point: expected 'module:callable', found 'one'")
    assert "!" not in lines["staticprbench"]
