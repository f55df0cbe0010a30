"""What package metadata and Python files say about methods, however damaged they are, and who may use which name."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.errors import AdapterError, MemoryFullError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.controls import CONTROLS
from prbench.harness.first_run import companions
from prbench.harness.methods.installed import (
    BUILT_IN_METHODS,
    METHOD_CONTROLS,
    InstalledEntry,
    entry_points_of,
    has_form,
    is_python_method,
    list_adapters,
    name_problem,
    offered_twice,
    short_name,
)
from prbench.harness.methods.loading import find_adapter, forget_loaded_methods, load_adapter, method_spec
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source


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


def test_other_groups_are_read_as_robustly(package):
    package("broken", "[prbench.training_tasks]\nnonsense\nfine = broken:task\n")
    found = {point.name: point.value for point in entry_points_of("prbench.training_tasks")}
    assert found["fine"] == "broken:task"
    assert "t2m-evaluator" in found


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


ROOT = Path(__file__).parents[3]


def test_the_reserved_names_are_those_of_the_methods_and_controls_that_come_with_prbench():
    points = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    installed = {adapter.name for adapter in list_adapters() if adapter.built_in}
    assert set(BUILT_IN_METHODS) == set(points["prbench.adapters"]) == installed
    assert tuple(control.name for control in CONTROLS if control.use == "--method") == METHOD_CONTROLS
    others = points["prbench.predictors"].keys() | points["prbench.trackers"].keys()  # of other benchmarks
    tasks = points["prbench.training_tasks"].keys() - others
    for name in (*BUILT_IN_METHODS, *(control.name for control in CONTROLS), *tasks, "all"):
        assert "only prbench itself may use this name" in str(name_problem(name))


@pytest.mark.parametrize("name", ["PR", "Static", "ground_truth", "Ground Truth", "W.A.N.D.R", "groundtruth", "m-d-m"])
def test_a_name_that_reads_like_one_of_prbenchs_is_reserved_too(name):
    assert "only prbench itself may use this name" in str(name_problem(name))


@pytest.mark.parametrize("name", ["glide", "pr2", "my-static", "PR (ours)", "Glide 2.0+", "scripted-v2", "x" * 100])
def test_other_names_of_the_right_form_can_be_used(name):
    assert name_problem(name) is None


@pytest.mark.parametrize(
    "name",
    [
        "",
        " glide",
        "glide ",
        "-x",
        "=cmd|x",
        "a\nb",
        "a\x1b[2J",
        "<img>",
        "a|b",
        "x" * 101,
        "рr",
        "ｐｒ",
        None,
        3,
        "@a",
        "../a",
    ],
)
def test_a_name_of_another_form_is_refused_with_the_form(name):
    assert not has_form(name)
    assert "expected a name of 1 to 100 characters of A to Z" in str(name_problem(name))


def test_a_package_that_claims_a_method_of_prbench_spoils_nothing_and_is_listed_with_the_reason(install, capsys):
    install("static", adapter_source(), package="prbench_thief")
    install("scripted", adapter_source(), package="prbench_shadow")
    static = find_adapter("static")
    assert (static.package, static.built_in) == ("prbench", True)
    assert type(load_adapter("static", None, {}, "cpu")).__module__.startswith("prbench_adapters")
    asked = RunRequest(method="pr", condition=Condition.GOAL_LOCATION, data=(Path(),))
    assert [one.method for one in companions(asked)] == ["mdm", "scripted", "static", "ground-truth"]
    assert main(["adapters", "list"]) == 0
    lines = {tuple(line.split()[:2]): line for line in capsys.readouterr().out.splitlines()}
    assert "'static' is a method of prbench itself; only prbench" in lines["static", "prbench_thief"]
    assert "'scripted' is a control of prbench; only prbench" in lines["scripted", "prbench_shadow"]
    assert "!" not in lines["static", "prbench"]


def test_a_companion_is_the_built_in_method_or_none(install, monkeypatch):
    install("static", adapter_source(), package="prbench_thief")
    others = [adapter for adapter in list_adapters() if adapter.package != "prbench"]
    monkeypatch.setattr("prbench.harness.first_run.list_adapters", lambda: others)
    asked = RunRequest(method="made", data=(Path(),))
    assert [one.method for one in companions(asked)] == ["scripted", "ground-truth"]


def test_a_name_that_two_packages_claim_is_unusable_and_nothing_else_is(install):
    install("same", adapter_source(), package="prbench_one")
    install("same", adapter_source(), package="prbench_two")
    install("made", adapter_source())
    assert offered_twice(list_adapters()) == {"same"}
    with pytest.raises(AdapterError, match=r"offered more than once: .*prbench_one 1\.2.*prbench_two 1\.2"):
        find_adapter("same")
    assert find_adapter("made").package == "prbench_made"


def test_a_package_never_trains_in_place_of_a_method_of_prbench(install, tmp_path):
    install("made", adapter_source())
    info = tmp_path / "site" / "prbench_made-1.2.dist-info" / "entry_points.txt"
    info.write_text(info.read_text() + "\n[prbench.training_tasks]\nmdm = prbench_made:task\nt2m-evaluator = x:y\n")
    found = [(point.name, point.value) for point in entry_points_of("prbench.training_tasks")]
    assert ("mdm", "prbench_made:task") not in found
    assert [value for name, value in found if name == "t2m-evaluator"] == [
        "prbench_benchmarks.text_to_motion.training:t2m_evaluator"
    ]


def test_the_command_says_which_package_claims_the_name_that_it_runs(install, table, tmp_path, capsys):
    install("static", adapter_source(), package="prbench_thief")
    words = ["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "out"), "--limit", "4"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "note: prbench_thief 1.2 is not used: 'static' is a method of prbench itself" in said.err
    assert "static (built in), condition none" in said.out
    assert RunRecord.read(tmp_path / "out").method.kind == "built-in"


def test_a_file_of_motions_is_refused_under_a_name_of_prbenchs(table, tmp_path):
    with pytest.raises(UsageError, match="--name: 'ground-truth' is a control of prbench"):
        ScoreRequest(predictions=tmp_path / "x.npz", data=(table.folder,), name="ground-truth")
    with pytest.raises(UsageError, match="--name: expected a name of 1 to 100 characters"):
        ScoreRequest(predictions=tmp_path / "x.npz", data=(table.folder,), name="=cmd|' /C calc'!A0")
    wanted = ScoreRequest(predictions=tmp_path / "ground-truth.npz", data=(table.folder,))
    with pytest.raises(UsageError, match=r"ground-truth\.npz: .* Say what the method is called with --name\."):
        score_predictions(wanted)


def test_the_kind_of_a_method_is_recorded_and_told(install, table, tmp_path):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "made", "made", limit=2))
    run_method(request(table, tmp_path / "truth", "ground-truth", limit=2))
    made = RunRecord.read(tmp_path / "made").method
    assert (made.kind, made.origin) == ("package", "package prbench_made 1.2")
    assert RunRecord.read(tmp_path / "truth").method.origin == "control"


@pytest.mark.parametrize(
    ("method", "origin"),
    [
        ({"kind": "adapter", "package": "prbench"}, "built in"),
        ({"kind": "adapter", "package": "prbench-glide"}, "package prbench-glide 1.0"),
        ({"kind": "offline", "package": "m.npz"}, "file m.npz"),
        (
            {"kind": "program", "package": "python m.py", "isolation": "bubblewrap"},
            "program python m.py, isolated: bubblewrap",
        ),
        ({"package": "who"}, "unknown kind"),
        ({"kind": "whatever", "package": "who"}, "unknown kind"),
        ({"kind": "package", "package": "a\x1b[2Jb"}, r"package a\x1b[2Jb 1.0"),
    ],
)
def test_records_of_older_versions_are_read_and_say_what_they_know(table, tmp_path, method, origin):
    run_method(request(table, tmp_path / "out", limit=2))
    record = json.loads((tmp_path / "out/run.json").read_text())
    del record["method"]["kind"]
    record["method"] |= {"version": "1.0", **method}
    (tmp_path / "out/run.json").write_text(json.dumps(record))
    assert RunRecord.read(tmp_path / "out").method.origin == origin


def test_a_method_that_ends_its_worker_is_blamed(install, table, tmp_path):
    class Broken:
        def map(self, function, items):
            raise MemoryFullError("one item of the work", "a worker process ended without an answer")

    install("made", adapter_source())
    with pytest.raises(AdapterError, match="method 'made': one item of the work: a worker process ended"):
        run_method(request(table, tmp_path / "made", "made"), engine=Broken())
    with pytest.raises(MemoryFullError):
        run_method(request(table, tmp_path / "static"), engine=Broken())


GROUP = load_benchmark("motion-prediction").methods
SOURCE = """
    from prbench_benchmarks.motion_prediction.predictors import ZeroVelocity

    def load(weights, *, options, device):
        return ZeroVelocity(name="NAME")

    make = load
"""


@pytest.fixture
def file(tmp_path):
    def write(name: str = "mine"):
        path = tmp_path / "still_one.py"
        path.write_text(textwrap.dedent(SOURCE).replace("NAME", name))
        return path

    yield write
    forget_loaded_methods()


@pytest.mark.parametrize("suffix", ["", ":make"])
def test_a_file_is_a_method_by_the_name_that_it_gives_itself(file, suffix):
    method = f"{file()}{suffix}"
    spec = method_spec(method, group=GROUP)
    assert spec.load().name == "mine"
    found = find_adapter(method, entry_points=GROUP.entry_points)
    assert (found.package, len(found.version)) == ("still_one.py", 12)
    assert short_name(method) == "still_one"


def test_a_file_without_the_function_is_not_run(tmp_path):
    program = tmp_path / "reads.py"
    program.write_text("import sys\nsys.exit('it ran')\n")
    with pytest.raises(AdapterError, match=r"found none in this file. A program is given .* 'cmd:python reads.py'"):
        method_spec(str(program), group=GROUP)
    program.write_text("def load(:\n")
    with pytest.raises(AdapterError, match="expected Python, found"):
        method_spec(str(program), group=GROUP)


def test_names_of_prbench_and_isolation_are_refused(file):
    with pytest.raises(AdapterError, match="'still_one': 'zero-velocity' is a method of prbench itself"):
        method_spec(str(file("zero-velocity")), group=GROUP).load()
    with pytest.raises(UsageError, match=r"still_one\.py is no package"):
        method_spec(str(file()), group=GROUP, isolate=True)


def test_other_words_are_no_python_methods(tmp_path):
    assert not any(map(is_python_method, ("static", "gone.py", "cmd:python x", str(tmp_path), "a b:c")))
