"""`prbench datasets check`: each planted fault is named by the check that should, and sound readers have none."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from prbench.checking.conformance import Outcome
from prbench.checking.dataset_checks import CHECKS, check_dataset
from prbench.checking.scaffold import new_dataset
from prbench.cli import main
from prbench.protocol.manifests import load_manifest
from prbench.readers.own import format as own
from prbench.readers.own.write import write_recording
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import refused, reported
from tests.readers.own.plain import METRES, plain_tables, recording_of
from tests.shared import made_once


def make(folder: Path) -> None:
    """The example package, its recordings, and a package of readers with faults, installed by their metadata."""
    source = new_dataset("tabletop", folder / "new").folder / "src"
    sys.path.insert(0, str(source))
    readers = importlib.import_module("tests.checking.faulty_readers")
    program = folder / "new" / "make_example.py"
    subprocess.run([sys.executable, program, folder / "root"], check=True, env={"PYTHONPATH": str(source)})
    package = source / "prbench_faulty"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "reader.py").write_text(
        "from tests.checking.faulty_readers import READERS\n"
        "globals().update({name.replace('-', '_'): reader for name, (_, reader) in READERS.items()})\n"
    )
    for name in readers.READERS:
        kind = "tabletop-tracked" if name in readers.OF_TRACKS else "tabletop"
        text = (source / "prbench_tabletop" / f"{kind}.toml").read_text("utf-8")
        text = text.replace(f'name = "{kind}"', f'name = "{name}"').replace(*readers.MANIFESTS.get(name, ("", "")))
        (package / f"{name}.toml").write_text(text, "utf-8")
    points = {name: f"prbench_faulty.reader:{name.replace('-', '_')}" for name in readers.READERS}
    points |= {"tabletop": "prbench_tabletop.reader:READER", "tabletop-tracked": "prbench_tabletop.tracked:READER"}
    info = source / "prbench_faulty-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench-faulty\nVersion: 0.1\n")
    sys.path.remove(str(source))
    for module in [*sys.modules]:  # the folder moves when it is ready
        if module.startswith("prbench_tabletop") or module == readers.__name__:
            del sys.modules[module]
    lines = [f"{name} = {target}" for name, target in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[prbench.readers]", *lines]))


@pytest.fixture
def root(monkeypatch: pytest.MonkeyPatch) -> Path:
    """Recordings of the example, whose package and faulty readers are installed."""
    folder = made_once("faulty-readers", make)
    monkeypatch.syspath_prepend(str(folder / "new" / "src"))
    yield folder / "root"
    load_manifest.cache_clear()


def outcomes(dataset: str, root: Path) -> dict[str, str]:
    report = check_dataset(dataset, root, most=2)
    return {
        finding.check: finding.said + finding.remedy
        for finding in report.findings
        if finding.outcome in (Outcome.FAILED, Outcome.WARNING)
    }


FAULTS = [
    *("z-up", "hands-exchanged", "millimetres", "gaze-late", "joints-shuffled", "nan", "order-of-a-set", "event-lies"),
    *("gaze-beside", "box-in-the-world", "reads-in-find", "names-by-root", "writes", "no-licence"),
]
MORE_FAULTS = [
    *("centimetres-body", "z-up-body", "swapped-quaternion", "backward-head", "gaze-in-head-frame", "gaze-mirrored"),
    *("gaze-from-the-origin", "sides-exchanged", "milliseconds", "gaze-in-milliseconds", "gaze-stuck", "raised-body"),
    *("clock-back", "long-quaternion", "other-id", "random", "event-in-microseconds", "event-box-in-millimetres"),
    *(
        "gaze-mirrored-in-z",
        "box-in-millimetres",
        "crashes",
        "names-no-file",
        "changeable",
        "empty-licence",
        "no-citation",
    ),
]


@pytest.mark.parametrize("name", [*FAULTS, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_FAULTS)])
def test_a_planted_fault_is_named_by_the_check_that_should(name, root):
    readers = importlib.import_module("tests.checking.faulty_readers").READERS
    assert set(readers) == {*FAULTS, *MORE_FAULTS}
    found = outcomes(name, root)
    assert list(found) == [readers[name][0]], found


@pytest.mark.parametrize("name", ["tabletop", "tabletop-tracked"])
def test_the_example_has_no_finding(name, root, capsys):
    report = reported(["datasets", "check", name, "--root", str(root)], capsys)
    assert [finding.check for finding in report.findings] == [each.name for each in CHECKS]
    assert {finding.outcome for finding in report.findings} == {"passed"}, report.findings
    assert main(["datasets", "check", name, "--root", str(root)]) == 0
    assert f"{name} keeps the contract: {len(CHECKS)} passed" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["adt", "hot3d", "mogaze", "gimo", "hd-epic"])
def test_the_readers_of_prbench_have_no_finding(preset, tmp_path):
    root = synthesize_tree(preset, tmp_path / "copy", recordings=2, seed=4, n_events=3).root
    assert outcomes(preset, root) == {}


def test_a_fault_ends_the_command_with_exit_code_3_and_what_to_change(root, capsys):
    assert main(["datasets", "check", "z-up", "--root", str(root), "--max-recordings", "1"]) == 3
    printed = capsys.readouterr().out
    assert "failed   axes             P1_office: " in printed
    assert "Change it in the reader." in printed
    assert "skipped  not looked at before 'axes' passes. 1: build." in printed
    assert "z-up does not keep the contract" in printed


def test_what_cannot_be_checked_is_refused_and_checks_are_listed(root, capsys):
    refused(["datasets", "check", "tabeltop", "--root", str(root)], capsys, code=2, message="Did you mean 'tabletop'?")
    refused(["datasets", "check", "tabletop"], capsys, code=2, message="NAME and --root DIR are needed")
    assert main(["datasets", "check", "--list"]) == 0
    printed = capsys.readouterr().out
    assert all(each.name in printed and each.title in printed for each in CHECKS)


def test_a_folder_without_recordings_is_one_finding(root, tmp_path):
    load_manifest.cache_clear()
    assert list(outcomes("tabletop", tmp_path)) == ["find"]


def late(tables: dict, seconds: float) -> None:
    tables["gaze"]["time"] = tables["gaze"]["time"] + seconds


def exchanged(tables: dict, seconds: float) -> None:
    tables["wrists"]["side"] = [{"left": "right", "right": "left"}[side] for side in tables["wrists"]["side"]]


OWN_FAULTS = {
    "none": ({}, None, ""),
    "metres called millimetres": ({"units": own.Units(length="mm", time="s")}, None, "unit"),
    "seconds called milliseconds": ({"units": own.Units(length="m", time="ms")}, None, "clock"),
    "y up called z up": ({"axes": own.Axes(up="z")}, None, "axes"),
    "world rays called rays in the head": ({"gaze": own.GazeFrame(frame="head")}, None, "axes"),
    "wrong order of quaternions": ({"axes": own.Axes(up="y", quaternion="xyzw")}, None, "read"),
    "hands exchanged": ({}, exchanged, "axes"),
    "gaze a second late": ({}, late, "clock"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN_FAULTS)
def test_a_fault_in_own_recordings_is_named(name, tmp_path):
    said, change, expected = OWN_FAULTS[name]
    tables = plain_tables(recording_of("adt"), METRES)
    if change is not None:
        change(tables, 1.0)
    for folder in ("one", "two"):
        write_recording(tmp_path / folder, msgspec.structs.replace(METRES, **said), tables)
    assert list(outcomes("own", tmp_path)) == [expected] * bool(expected)


@pytest.mark.parametrize("dataset", ["adt", "hot3d", "hd-epic"])
def test_real_samples_have_no_fault(samples, dataset):
    assert set(outcomes(dataset, samples / dataset)) <= {"build"}  # of a few seconds no sequences come
