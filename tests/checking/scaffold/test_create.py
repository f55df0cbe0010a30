"""A new method's folder: complete, clean, whole or not there at all, and working as generated; its names."""

from __future__ import annotations

import ast
import importlib
import itertools
import keyword
import os
import pickle
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import torch

from prbench.checking.conformance import CheckRequest, Outcome
from prbench.checking.conformance.findings import examine
from prbench.checking.conformance.session import judge_of
from prbench.checking.scaffold import ScaffoldRequest, new_adapter
from prbench.checking.scaffold.create import (
    MADE_UP_WEIGHTS,
    PROGRAM,
    filled,
    method_names,
    template_flags,
    template_values,
)
from prbench.cli import main
from prbench.cli.adapters import _SOURCES
from prbench.errors import StorageError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench_benchmarks.motion_prediction.conformance import PredictorSubject, windows_of_table
from tests.benchmarks.motion_prediction.windows import walking, write
from tests.fakes import fake_dataset

CONDITIONS = ("none", "text", "goal-pose", "goal-loc")
CHOICES = [
    (conditions, kind)
    for size in (1, 2, 4)
    for conditions in itertools.combinations(CONDITIONS, size)
    for kind in ("package", "trainable", "program")
]

WRAPPED = ("goal-loc", "goal-pose", "text")
PREDICTED = (("pose",), ("pose+gaze", "pose+head"))


@pytest.fixture(scope="module")
def all_kinds(tmp_path_factory) -> Path:
    """A folder of every kind of package and program."""
    root = tmp_path_factory.mktemp("kinds")
    for number, (conditions, kind) in enumerate(CHOICES):
        source = "program" if kind == "program" else None
        new_adapter(
            ScaffoldRequest(f"made-{number}", conditions, root / f"{kind}{number}", kind == "trainable", source)
        )
    for source in MADE_UP_WEIGHTS:
        for condition in WRAPPED:
            new_adapter(ScaffoldRequest("wrapped", (condition,), root / f"{source}-{condition}", source=source))
    for conditions in PREDICTED:
        for kind in ("package", "trainable", "program"):
            _predictor(root / f"{kind}-of-{'-'.join(conditions)}", conditions, kind)
    return root


def _predictor(folder: Path, conditions: tuple[str, ...], kind: str) -> Path:
    chosen = {"trainable": kind == "trainable", "source": "program" if kind == "program" else None}
    request = ScaffoldRequest("glance", conditions, folder, **chosen, benchmark="motion-prediction")
    return new_adapter(request).folder


def _run(*command: str, cwd: Path, path: Path | str = "") -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(path), "PRBENCH_CACHE": str(cwd / "cache")}
    return subprocess.run([sys.executable, *command], cwd=cwd, env=environment, capture_output=True, text=True)


def test_no_template_leaves_a_mark_and_all_python_parses(all_kinds):
    for path in all_kinds.rglob("*"):
        if path.is_file():
            text = path.read_text(encoding="utf-8")
            assert "<<" not in text, path
            assert "\n%" not in text, path
            if path.suffix == ".py":
                version = (3, 8) if path.parent.parent == all_kinds and path.name != "make_weights.py" else None
                ast.parse(text, feature_version=version)
            if path.suffix == ".toml":
                tomllib.loads(text)


def test_everything_is_clean_under_ruff(all_kinds):
    ruff = shutil.which("ruff")
    if ruff is None:
        pytest.skip("ruff is not installed")
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run([ruff, *command, "--no-cache", "."], cwd=all_kinds, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:]


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A generated package, installed by pip as a user would, in a folder of its own."""
    root = tmp_path_factory.mktemp("new")
    report = new_adapter(ScaffoldRequest("newcomer", out=root / "prbench-newcomer"))
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    done = _run("-m", "pip", "install", *options, "--target", str(root / "site"), str(report.folder), cwd=root)
    assert done.returncode == 0, done.stderr
    return root


def test_an_installed_package_is_listed_with_what_it_declares(installed):
    command = ["adapters", "list", "--details", "newcomer"]
    done = _run("-m", "prbench", *command, cwd=installed, path=installed / "site")
    assert "newcomer  prbench-newcomer 0.1.0  goal-loc    no      any     any   none" in done.stdout, done.stdout


@pytest.mark.slow
def test_packages_pass_their_own_tests_as_generated(installed, all_kinds):
    everything = all_kinds / f"trainable{len(CHOICES) - 2}"  # all conditions, and fit()
    predictor = all_kinds / "trainable-of-pose+gaze-pose+head"
    tests = [
        *(installed / "prbench-newcomer" / "tests", everything / "tests" / "test_method.py"),
        predictor / "tests" / "test_method.py",
    ]
    path = os.pathsep.join([str(installed / "site"), str(everything / "src"), str(predictor / "src")])
    options = ["-q", "-p", "no:cacheprovider", "--import-mode=importlib"]
    done = _run("-m", "pytest", *options, *map(str, tests), cwd=installed, path=path)
    assert done.returncode == 0, done.stdout[-3000:]
    summary = done.stdout.splitlines()[-1]
    assert int(summary.split()[0]) >= 30, summary


def test_an_installed_package_is_run_and_scored(installed):
    data = fake_dataset(installed / "table", 24).folder
    command = ["run", "--method", "newcomer", "--condition", "goal-loc", "--data", str(data), "--out", "out"]
    done = _run("-m", "prbench", *command, cwd=installed, path=installed / "site")
    assert done.returncode == 0, done.stderr
    assert "newcomer (package prbench-newcomer 0.1.0), condition goal-loc; 6 sequences" in done.stdout


def test_a_program_is_run_and_scored_by_its_toml(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    data = fake_dataset(tmp_path / "table", 12).folder
    assert (
        main(["adapters", "new", "slider", "--from", "program", "--condition", "text", "--out", f"{tmp_path}/slider"])
        == 0
    )
    toml = tmp_path / "slider" / "slider.toml"
    toml.write_text(toml.read_text().replace('"python"', repr(sys.executable)))
    out = tmp_path / "out"
    arguments = ["run", "--method", str(toml), "--condition", "text", "--data", str(data), "--out", str(out)]
    assert main(arguments) == 0
    assert f"slider (program {Path(sys.executable).name} slider.py), condition text" in capsys.readouterr().out


@pytest.mark.parametrize("source", MADE_UP_WEIGHTS)
@pytest.mark.parametrize(
    "condition", ["goal-loc", *(pytest.param(each, marks=pytest.mark.slow) for each in ("goal-pose", "text"))]
)
def test_a_wrapped_model_keeps_the_contract_on_made_up_weights(all_kinds, tmp_path, monkeypatch, source, condition):
    folder = all_kinds / f"{source}-{condition}"
    monkeypatch.syspath_prepend(folder / "src")
    monkeypatch.setattr(sys, "argv", ["make_weights.py", str(tmp_path / "weights")])
    _forget("prbench_wrapped")
    runpy.run_path(str(folder / "make_weights.py"))
    _, weights, *option = MADE_UP_WEIGHTS[source].split()
    monkeypatch.chdir(tmp_path)
    options = dict([option[1].split("=")]) if option else {}
    request = CheckRequest(str(folder / "src" / "prbench_wrapped" / "adapter.py"))
    spec = method_spec(request.method, weights=tmp_path / weights, options=options)
    judge = judge_of("prime-and-reach")
    quick = [one for one in judge.checks if not one.fresh and one.name not in ("memory", "text")]
    found = list(examine(judge.subject(spec, request, tmp_path), quick))
    forget_loaded_methods()
    _forget("prbench_wrapped")
    problems = [each for each in found if each.outcome in (Outcome.FAILED, Outcome.WARNING)]
    # MDM's family makes no more than 196 frames, and says so; what checks shapes in these tests draws from `random`.
    known = {("lengths", Outcome.WARNING), ("global-random", Outcome.WARNING)}
    assert {(each.check, each.outcome) for each in problems} <= known, problems
    assert {each.check for each in found if each.outcome is Outcome.PASSED} >= {"finite", "noise-seed", "bone-lengths"}


def _forget(package: str) -> None:
    """Every new package of these tests has the same name."""
    for name in [each for each in sys.modules if each.partition(".")[0] == package]:
        del sys.modules[name]


def test_a_checkpoint_that_executes_code_is_not_loaded(all_kinds, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(all_kinds / "joints22-text" / "src")
    _forget("prbench_wrapped")
    torch.save({"step": Path("x")}, tmp_path / "model.pt")
    made = importlib.import_module("prbench_wrapped").load(tmp_path / "model.pt", options={}, device="cpu")
    with pytest.raises(pickle.UnpicklingError, match="Weights only load failed"):
        _ = made.network
    _forget("prbench_wrapped")


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (
            {"conditions": ("text", "goal-loc")},
            "--from hml263: expected one --condition, .* found text, goal-loc",
        ),
        ({"conditions": ("none",)}, "expected one --condition, text, goal-loc or goal-pose, found none"),
        ({"trainable": True}, "--trainable --from hml263: a model that brings its weights is not fitted by a run"),
        ({"benchmark": "motion-prediction"}, "--from hml263: expected program, or no --from, for the benchmark"),
    ],
)
def test_what_a_wrapped_model_cannot_be_is_refused(tmp_path, wanted, message):
    with pytest.raises(UsageError, match=message):
        new_adapter(ScaffoldRequest("glide", **{"out": tmp_path / "new", "source": "hml263", **wanted}))


def test_program_is_the_older_spelling_of_from_program(tmp_path, capsys):
    for number, words in enumerate((["--program"], ["--from", "program"])):
        assert main(["adapters", "new", "slider", *words, "--out", str(tmp_path / str(number))]) == 0
    assert "--program goes in prbench 0.13.0; use --from program." in capsys.readouterr().err
    old, new = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in "01")
    assert old == new
    assert main(["adapters", "new", "slider", "--program", "--from", "smplx", "--out", str(tmp_path / "2")]) == 2
    assert "--program --from smplx: expected one of them" in capsys.readouterr().err


def test_the_command_line_offers_what_can_be_written():
    assert (*MADE_UP_WEIGHTS, PROGRAM) == _SOURCES


@pytest.mark.parametrize("kind", ["package", "trainable"])
def test_a_new_predictor_keeps_the_contract(all_kinds, tmp_path, kind):
    file = all_kinds / f"{kind}-of-pose" / "src" / "prbench_glance" / "predictor.py"
    spec = method_spec(str(file), group=load_benchmark("motion-prediction").methods)
    quick = [one for one in judge_of("motion-prediction").checks if not one.fresh and one.name != "memory"]
    table = write(tmp_path / "w", walking("a", 120), walking("b", 120, split="train", number=1))
    (tmp_path / "check").mkdir()
    subject = PredictorSubject(spec, windows_of_table(table, tmp_path / "check"), tmp_path / "check")
    found = list(examine(subject, quick))
    forget_loaded_methods()
    assert [each for each in found if each.outcome in (Outcome.FAILED, Outcome.WARNING)] == []


def test_a_new_predictor_as_a_program_is_run_and_scored(tmp_path, capsys):
    toml = _predictor(tmp_path / "glance", ("pose+gaze",), "program") / "glance.toml"
    toml.write_text(toml.read_text().replace('"python"', repr(sys.executable)))
    data = write(tmp_path / "w", walking("a", 120))
    arguments = ["run", "--benchmark", "motion-prediction", "--method", str(toml), "--condition", "pose+gaze"]
    assert main([*arguments, "--data", str(data), "--samples", "5", "--out", str(tmp_path / "out")]) == 0
    assert "glance (program" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"conditions": ("goal-loc",)}, "--condition goal-loc: expected one of the benchmark motion-prediction: pose,"),
        ({"name": "humanmac"}, "method of prbench itself"),
    ],
)
def test_a_predictor_of_another_benchmarks_condition_or_of_our_name_is_refused(tmp_path, wanted, message):
    given = {"name": "glance", "out": tmp_path / "new", "benchmark": "motion-prediction", **wanted}
    with pytest.raises(UsageError, match=message):
        new_adapter(ScaffoldRequest(**given))


def test_new_says_what_to_do_next(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["adapters", "new", "glide", "--condition", "text", "--condition", "goal-loc", "--trainable"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:] == [
        "  cd prbench-glide",
        '  pip install -e ".[test]"',
        "  python -m pytest",
        "  prbench adapters check glide",
        "  prbench run --method glide --condition text",
    ]
    assert (tmp_path / "prbench-glide" / "src" / "prbench_glide" / "standing.py").is_file()


@pytest.mark.parametrize("source", [None, "program", *MADE_UP_WEIGHTS])
def test_the_readme_shows_the_same_commands(tmp_path, source):
    report = new_adapter(ScaffoldRequest("glide", out=tmp_path / "glide", source=source))
    readme = (report.folder / "README.md").read_text()
    for step in report.next_steps[1:]:
        assert step in readme


@pytest.mark.parametrize("what", ["a file", "a folder with a file", "a link", "the current folder"])
def test_nothing_is_ever_overwritten(what, tmp_path, monkeypatch):
    out = tmp_path / "out"
    if what == "a file":
        out.write_text("mine")
    elif what == "a link":
        out.symlink_to(tmp_path / "nowhere")
    else:
        out.mkdir()
        if what == "the current folder":
            monkeypatch.chdir(out)
        else:
            (out / "mine.txt").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(StorageError, match=r"exists already; nothing was written\. Name a new folder with --out DIR"):
        new_adapter(ScaffoldRequest("glide", out=out))
    assert sorted(tmp_path.rglob("*")) == before


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "out").mkdir()
    report = new_adapter(ScaffoldRequest("glide", out=tmp_path / "out"))
    found = {path.relative_to(report.folder) for path in report.folder.rglob("*") if path.is_file()}
    assert found == set(report.files)


def test_an_interrupted_writing_leaves_nothing(tmp_path, monkeypatch):
    written: list[Path] = []

    def fail(self: Path, *arguments, **keywords) -> None:
        if written:
            raise KeyboardInterrupt
        written.append(self)

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(KeyboardInterrupt):
        new_adapter(ScaffoldRequest("glide", out=tmp_path / "out"))
    assert written
    assert list(tmp_path.iterdir()) == []


def test_a_program_is_not_fitted_by_a_run(tmp_path):
    with pytest.raises(UsageError, match="a program is not fitted by a run"):
        new_adapter(ScaffoldRequest("glide", out=tmp_path / "out", trainable=True, source="program"))


def test_every_other_name_follows_from_the_methods():
    names = method_names("goal-diffusion-2")
    assert (names.distribution, names.module) == ("prbench-goal-diffusion-2", "prbench_goal_diffusion_2")
    assert (names.class_name, names.program) == ("GoalDiffusion2Method", "goal_diffusion_2")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("My_Method", "Would 'my-method' do?"),
        ("my method", "Would 'my-method' do?"),
        ("my--method", "Would 'my-method' do?"),
        ("-x-", "Would 'x' do?"),
        ("3d", "beginning with a letter"),
        ("", "beginning with a letter"),
        ("../evil", "beginning with a letter"),
        ("glïde", "beginning with a letter"),
        ("a\nb", "Would 'a-b' do?"),
        ("prbench-glide", "the package is called prbench-NAME by itself. Give 'glide'."),
        ("x" * 41, "expected at most 40 characters, found 41"),
        ("ground-truth", "is a control of prbench"),
        ("shuffled-goal", "is a control of prbench"),
        ("static", "only prbench itself may use this name. Choose another, such as 'my-static'."),
        ("adapters", "is a reserved name"),
        ("data-manifests", "is a reserved name"),
        ("cmd", "is a reserved name"),
        ("nul", "is a reserved name"),
        ("com1", "is a reserved name"),
    ],
)
def test_names_that_cannot_be_used_are_refused_with_one_that_can(name, hint):
    with pytest.raises(UsageError) as caught:
        method_names(name)
    assert hint in str(caught.value)
    assert str(caught.value).startswith(repr(name))


@pytest.mark.parametrize("name", ["none", "true", "condition", "motions", "condition-batch", "path", "exception"])
def test_a_class_never_hides_what_its_file_needs(name):
    made = method_names(name).class_name
    assert made.endswith("Method")
    assert made.isidentifier()
    assert not keyword.iskeyword(made)


@pytest.mark.parametrize(
    ("name", "program"), [("random", "random_method"), ("numpy", "numpy_method"), ("json", "json_method")]
)
def test_a_program_never_hides_a_module_that_it_imports(name, program):
    assert method_names(name).program == program


@pytest.mark.parametrize(
    ("flags", "expected"),
    [({"a"}, "1\nonly a\nend\n"), ({"b"}, "1\nnot a\nend\n"), ({"a", "b"}, "1\nonly a\na and b\nend\n")],
)
def test_parts_are_kept_by_flags(flags, expected):
    template = "1\n%if a\nonly a\n%else\nnot a\n%end\n%if a and b\na and b\n%end\n%if not a and not b\nx\n%end\nend"
    assert filled(template, {}, flags) == expected


def test_values_are_put_in_and_an_empty_one_leaves_no_line():
    assert (
        filled("a <<x>> b\n\n  <<y>>\n<<z>>\nend", {"x": "1", "y": "2\n  3", "z": ""}, ()) == "a 1 b\n\n  2\n  3\nend\n"
    )


def test_a_mark_without_a_value_is_a_mistake():
    with pytest.raises(KeyError, match="unheard"):
        filled("<<unheard>>", {}, ())


def asked(*conditions: str, trainable: bool = False) -> ScaffoldRequest:
    return ScaffoldRequest("x", conditions=conditions, trainable=trainable)


def test_flags_say_which_kinds_of_condition_a_method_takes():
    assert template_flags(asked("none")) == {"free"}
    assert template_flags(asked("text", trainable=True)) == {"free", "text", "trainable"}
    assert template_flags(asked("goal-loc")) == {"goal", "goal_location", "text"}
    assert template_flags(asked("goal-pose", "none")) == {"goal", "goal_pose", "free", "text"}


def test_conditions_are_named_once_and_in_the_given_order():
    values = template_values(method_names("x"), asked("text", "none", "text"))
    assert values["conditions"] == "Condition.TEXT, Condition.NONE"
    assert values["condition"] == "text"
