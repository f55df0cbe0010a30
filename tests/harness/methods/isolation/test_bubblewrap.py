"""What is shown behind the fence, and what is covered there."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.harness.methods.isolation import Mount, Shown, arrange


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """``code/table`` is a table inside a checkout; ``code/table/weights`` are weights inside it."""
    root = tmp_path.resolve()
    for name in ("code/package", "code/table/weights", "elsewhere", "cache/fits"):
        (root / name).mkdir(parents=True)
    return root


def test_a_hidden_folder_inside_a_shown_one_is_covered_after_it_is_shown(root):
    steps = arrange([Shown(root / "code")], [root / "code/table", root / "elsewhere"])
    assert steps == [Mount(root / "code", root / "code"), Mount(None, root / "code/table")]


def test_what_lies_in_a_hidden_folder_is_shown_only_if_it_is_essential(root):
    shown = [Shown(root / "code"), Shown(root / "code/table/weights")]
    assert Mount(None, root / "code/table") in arrange(shown, [root / "code/table"])
    assert len(arrange(shown, [root / "code/table"])) == 2
    essential = [Shown(root / "code"), Shown(root / "code/table/weights", essential=True)]
    steps = arrange(essential, [root / "code/table"])
    assert [step.place for step in steps] == [root / "code", root / "code/table", root / "code/table/weights"]


def test_a_folder_that_is_hidden_itself_stays_hidden(root):
    assert arrange([Shown(root / "elsewhere")], [root / "elsewhere"]) == []
    steps = arrange([Shown(root / "elsewhere", essential=True)], [root / "elsewhere"])
    assert steps[-1].source is None


def test_a_hidden_folder_is_covered_wherever_a_link_would_show_it(root):
    (root / "link").symlink_to(root / "code")
    (root / "data").symlink_to(root / "code/table")
    steps = arrange([Shown(root / "link")], [root / "data"])
    assert {step.place for step in steps if step.source is None} == {root / "link/table", root / "code/table"}
    assert {step.place for step in steps if step.source is not None} == {root / "link", root / "code"}


def test_a_hidden_folder_that_does_not_exist_yet_is_made_to_be_covered(root):
    steps = arrange([Shown(root / "code")], [root / "code/runs/one", root / "nowhere/two"])
    assert steps[-1] == Mount(None, root / "code/runs/one")
    assert (root / "code/runs/one").is_dir()
    assert not (root / "nowhere").exists()


def test_a_hidden_file_is_covered_as_a_file(root):
    (root / "code/predictions.npz").touch()
    assert arrange([Shown(root / "code")], [root / "code/predictions.npz"])[-1] == Mount(
        None, root / "code/predictions.npz", file=True
    )


def test_nothing_is_mounted_twice_and_nothing_that_does_not_exist(root):
    shown = [Shown(root / "code/package"), Shown(root / "code"), Shown(root / "code"), Shown(root / "none")]
    assert arrange(shown, []) == [Mount(root / "code", root / "code")]
    assert arrange([Shown(Path("/usr/bin"))], []) == []


def test_what_is_to_be_written_is_writable_inside_what_is_not(root):
    steps = arrange([Shown(root), Shown(root / "cache/fits", writable=True, essential=True)], [root / "cache"])
    assert [step.source is None for step in steps] == [False, True, False]
    assert steps[-1] == Mount(root / "cache/fits", root / "cache/fits", writable=True)
