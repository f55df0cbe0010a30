"""What is shown to an isolated method and what is withheld; in process and isolated it gives the same bytes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from prbench.cli.main import main
from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError, RunError, UsageError
from prbench.harness.methods.isolation import (
    Mount,
    Shown,
    arrange,
    available_fence,
    isolated_environment,
    readable_folders,
    text_encoder,
)
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.methods.motions import generate_checked
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source


@pytest.fixture
def bubblewrap() -> None:
    """Skips where bubblewrap does not work."""
    fence = available_fence()
    if fence.program is None:
        pytest.skip(fence.reason)


@pytest.fixture
def no_bubblewrap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine, and all processes that a test starts on it, where bubblewrap is installed and does not work."""
    (tmp_path / "broken").mkdir()
    broken = tmp_path / "broken/bwrap"
    broken.write_text("#!/bin/sh\necho 'setting up uid map: Permission denied' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{broken.parent}{os.pathsep}{os.environ['PATH']}")
    available_fence.cache_clear()
    yield
    available_fence.cache_clear()


@pytest.fixture(params=["process", "bubblewrap"])
def fence(request: pytest.FixtureRequest) -> str:
    """Both kinds, one after the other."""
    request.getfixturevalue("bubblewrap" if request.param == "bubblewrap" else "no_bubblewrap")
    return request.param


def test_a_bubblewrap_that_does_not_work_or_is_not_there_is_told_with_the_reason(no_bubblewrap, tmp_path, monkeypatch):
    assert available_fence().program is None
    assert "(bubblewrap does not work here: setting up uid map: Permission denied)" in available_fence().notice
    available_fence.cache_clear()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "THE FILE SYSTEM IS NOT WITHHELD (bubblewrap is not installed)" in available_fence().notice


def test_a_users_program_behind_the_fence_reads_its_own_folder_and_nothing_else(
    bubblewrap, table, tmp_path, monkeypatch
):
    folder = tmp_path / "method"
    folder.mkdir()
    shutil.copytree(table.folder, folder / "table")
    (folder / "look.py").write_text(
        "import json, os, sys\n"
        "sys.stdin.readline()\n"
        "try:\n    open('written', 'w')\nexcept OSError as error:\n    written = type(error).__name__\n"
        "found = {'here': sorted(os.listdir('.')), 'table': os.listdir('table'), 'written': written,\n"
        f"         'beside': os.path.exists({str(table.folder)!r}), 'environment': sorted(os.environ)}}\n"
        "print(json.dumps({'message': 'error', 'text': json.dumps(found)}), flush=True)\n"
    )
    monkeypatch.chdir(folder)
    monkeypatch.setenv("SECRET", "1")
    method = f'cmd:"{sys.executable}" look.py'
    with pytest.raises(AdapterError) as error:
        run_method(request(table, tmp_path / "out", method, data=(folder / "table",), isolate=True))
    text = str(error.value)
    seen = json.JSONDecoder().raw_decode(text[text.index("{") :])[0]
    assert not (tmp_path / "out").exists(), "the folder that was made to be covered vanishes"
    assert seen["here"] == ["look.py", "table"]
    assert seen["table"] == []
    assert seen["written"] == "OSError"
    assert seen["beside"] is False
    assert "SECRET" not in seen["environment"]


def test_a_program_does_not_start_in_a_folder_that_is_withheld(bubblewrap, table, tmp_path, monkeypatch):
    monkeypatch.chdir(table.folder)
    with pytest.raises(UsageError, match=r"--isolate: the program starts in .*, which is withheld"):
        run_method(request(table, tmp_path / "out", f'cmd:"{sys.executable}" -c 1', isolate=True))
    assert not (tmp_path / "out").exists()


def test_weights_and_files_named_by_options_are_shown_to_an_isolated_method(bubblewrap, install, tmp_path):
    for name in ("w.npz", "option.npz", "other.npz"):
        (tmp_path / name).touch()
    source = adapter_source() + (
        "\n    import os\n    def load(weights, *, options, device):\n"
        "        raise ValueError([os.path.exists(path) for path in (weights, options['a'], options['b'][1:])])\n"
    )
    install("made", source)
    options = {"a": str(tmp_path / "option.npz"), "b": f":{tmp_path / 'other.npz'}"}
    with pytest.raises(AdapterError, match=r"\[True, True, False\]"):
        method_spec("made", weights=tmp_path / "w.npz", options=options, isolate=True).load()
    forget_loaded_methods()


def test_nothing_of_a_fenced_method_is_left_when_its_harness_is_killed(bubblewrap, install, tmp_path):
    install("made", adapter_source(), package="prbench_left_behind")
    code = (
        "import sys, time; sys.path.insert(0, sys.argv[1])\n"
        "from prbench.harness.methods.loading import method_spec\n"
        "method_spec('made', isolate=True).load(); print('up', flush=True); time.sleep(60)"
    )
    run = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "site")], stdout=subprocess.PIPE, text=True)
    assert run.stdout.readline() == "up\n"
    family = psutil.Process(run.pid).children(recursive=True)
    assert len(family) >= 2
    run.kill()
    run.communicate()
    _, alive = psutil.wait_procs(family, timeout=5)
    assert not alive


def test_what_leads_to_data_or_to_the_user_is_withheld_and_what_computing_needs_is_kept(tmp_path):
    kept = {"PATH": "/bin", "LC_ALL": "C", "CUDA_VISIBLE_DEVICES": "1", "OMP_NUM_THREADS": "2", "SystemRoot": "C:"}
    withheld = {
        "HOME": "/home/me", "PWD": "/data", "OLDPWD": "/data", "USER": "me", "PRBENCH_CACHE": "c", "HF_TOKEN": "t",
        "ADT_ROOT": "/data/adt", "SSH_AUTH_SOCK": "s", "PYTHONPATH": "/x", "prbench_samples": "s", "VIRTUAL_ENV": "v",
    }  # fmt: skip
    assert isolated_environment({**kept, **withheld, "XDG_CACHE_HOME": str(tmp_path)}) == kept


def test_model_caches_are_named_where_they_exist_because_there_is_no_home_to_find_them_in(tmp_path):
    (tmp_path / "huggingface").mkdir()
    found = isolated_environment({"XDG_CACHE_HOME": str(tmp_path)})
    assert found == {"HF_HOME": str(tmp_path / "huggingface")}
    assert readable_folders(found) == (tmp_path / "huggingface",)
    assert isolated_environment({"XDG_CACHE_HOME": str(tmp_path), "HF_HOME": "/m"}) == {"HF_HOME": "/m"}


def test_the_text_encoders_of_our_own_models_are_the_only_variables_of_prbench_that_are_passed_on(tmp_path):
    user = {"PRBENCH_DISTILBERT": str(tmp_path), "PRBENCH_CACHE": "c"}
    assert text_encoder(user) == {"PRBENCH_DISTILBERT": str(tmp_path)}
    assert readable_folders(user) == (Path(tmp_path),)
    assert text_encoder({"PRBENCH_CLIP": str(tmp_path)}) == {"PRBENCH_CLIP": str(tmp_path)}
    assert readable_folders({"PRBENCH_CLIP": str(tmp_path)}) == (Path(tmp_path),)
    assert text_encoder({}) == {}


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


def results(folder) -> dict[str, bytes]:
    """Everything but the record, which says how the method was kept."""
    return {name: content for name, content in reproducible_bytes(folder).items() if name != "run.json"}


def test_a_method_that_draws_gives_the_same_bytes_in_process_and_isolated(fence, table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "here", "made", samples=2))
    run_method(request(table, tmp_path / "apart", "made", samples=2, isolate=True))
    assert len(results(tmp_path / "apart")) == 7
    assert results(tmp_path / "apart") == results(tmp_path / "here")
    record = RunRecord.read(tmp_path / "apart").method
    assert (record.name, record.kind, record.package, record.version) == ("made", "package", "prbench_made", "1.2")
    assert record.isolation == fence


def test_a_method_that_is_fitted_learns_the_same_from_a_copy_of_the_training_rows(fence, table, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    fits, folders = {}, {}
    for name, isolate in (("here", False), ("apart", True)):
        monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / f"cache-{name}"))
        run_method(request(table, tmp_path / name, "static", isolate=isolate))
        [fits[name]] = (tmp_path / f"cache-{name}/fits").glob("*/mean_pose.json")
        folders[name] = fits[name].parent.name
    assert fits["here"].read_bytes() == fits["apart"].read_bytes()
    assert folders["here"] == folders["apart"]
    assert results(tmp_path / "here") == results(tmp_path / "apart")
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_network_computes_the_same_apart_with_its_bundled_weights_and_threads(no_bubblewrap, table, tmp_path):
    asked = {"condition": Condition.TEXT, "limit": 1, "options": {"steps": "1"}, "threads": 2}
    for name, isolate in (("here", False), ("apart", True)):
        run_method(request(table, tmp_path / name, "mdm", isolate=isolate, **asked))
    assert results(tmp_path / "here") == results(tmp_path / "apart")
    here, apart = (RunRecord.read(tmp_path / name).method for name in ("here", "apart"))
    assert apart.weights_digest is not None
    assert (apart.weights, apart.weights_digest) == (here.weights, here.weights_digest)


def test_a_fit_gets_no_path_to_the_table(no_bubblewrap, table, tmp_path, install):
    body = "raise ValueError([str(train.folder), type(train).__name__])"
    source = adapter_source(attributes=f"def fit(self, train, *, validation, run): {body}")
    install("made", source)
    with pytest.raises(AdapterError) as error:
        run_method(request(table, tmp_path / "out", "made", isolate=True))
    assert "prbench-train-" in str(error.value)
    assert "TrainingSplit" in str(error.value)
    assert str(table.folder) not in str(error.value)


def test_a_run_that_was_isolated_does_not_go_on_in_one_that_was_not(no_bubblewrap, table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    with pytest.raises(RunError, match=r"method\.isolation: expected process for this run, found nothing"):
        run_method(request(table, tmp_path / "out", "made", isolate=True))


WRONG = """
            if seed == 0: raise ValueError("no way")
            if seed == 1: joints = joints[:, :-1]
            if seed == 2: joints[0, 1] = np.nan
            if seed == 3: n_frames = n_frames - 1
            if seed == 4: joints = joints.tolist()
            if seed == 5: import sys; sys.exit("enough")
            if seed == 6: import os; os._exit(3)"""
ANSWERS = (
    "ValueError: no way (",
    "expected 60 frames, found 59 in joints",
    "sequence a/b, frame 1: expected finite positions",
    "sequence a/b: expected 60 frames, found 59",
    "expected joints as a NumPy array, found list",
    "SystemExit: enough",
    "exit status 3",
)


def test_errors_are_told_like_those_of_a_method_in_process(no_bubblewrap, install):
    install("made", adapter_source(body=WRONG.strip()))
    adapter = method_spec("made", isolate=True).load().adapter
    batch = ConditionBatch(
        condition=Condition.NONE, n_frames=np.array([60, 9]), fps=20.0, opaque_id=("0f", "f0"), noise_seed=(1, 2)
    )
    for seed, answer in enumerate(ANSWERS):
        with pytest.raises(AdapterError) as error:
            generate_checked(adapter, batch, seed=seed, method="made", sequence_ids=("a/b", "c/d"))
        assert answer in str(error.value)
        assert "a/b" in str(error.value)
    forget_loaded_methods()


def test_prints_of_a_method_and_of_its_libraries_do_no_harm(no_bubblewrap, table, tmp_path, install):
    noise = "import os, sys; print('hello'); os.write(1, b'from C'); os.system('echo from a child'); sys.stdin.read()"
    install("made", adapter_source(body=noise))
    run_method(request(table, tmp_path / "out", "made", isolate=True))
    install("quiet", adapter_source())
    run_method(request(table, tmp_path / "quiet", "quiet"))
    names = [name for name in results(tmp_path / "out") if "predictions/" in name]
    assert len(names) == 4
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "quiet" / name).read_bytes()


@pytest.mark.slow
def test_a_batch_that_does_not_fit_in_the_workers_memory_is_run_in_halves(no_bubblewrap, table, tmp_path, install):
    install("made", adapter_source(body="if len(batch) > 2: raise MemoryError"))
    assert run_method(request(table, tmp_path / "out", "made", isolate=True)).batches_made == 4


def test_the_command_line_says_what_is_withheld_and_shows_the_methods_own_name(no_bubblewrap, table, tmp_path, capsys):
    words = ["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "out"), "--isolate"]
    assert main([*words, "--limit", "2", "--timeout", "60"]) == 0
    shown = capsys.readouterr()
    assert "THE FILE SYSTEM IS NOT WITHHELD" in shown.err
    assert "static (built in, isolated: process), condition none" in shown.out


def test_settings_that_the_method_refuses_are_told(no_bubblewrap, table, tmp_path):
    with pytest.raises(AdapterError, match="unknown option 'pose'; known options: pose-only"):
        run_method(request(table, tmp_path / "out", options={"pose": "1"}, isolate=True))
    with pytest.raises(AdapterError, match="does not take the condition 'text'"):
        run_method(request(table, tmp_path / "out", condition=Condition.TEXT, isolate=True))


def test_declared_limits_and_weights_cross_the_border(no_bubblewrap, table, tmp_path, install):
    attributes = (
        "max_frames = 200; native_fps = 30.0; motionless = True\n"
        "        def weights_for(self, condition):\n"
        "            import pathlib\n"
        "            return pathlib.Path(__file__)"
    )
    install("made", adapter_source(attributes=attributes))
    run_method(request(table, tmp_path / "here", "made"))
    run_method(request(table, tmp_path / "apart", "made", isolate=True))
    here, apart = RunRecord.read(tmp_path / "here").method, RunRecord.read(tmp_path / "apart").method
    assert apart.weights_digest
    for name in ("max_frames", "native_fps", "motionless", "weights", "weights_digest"):
        assert getattr(here, name) == getattr(apart, name)
    assert results(tmp_path / "here") == results(tmp_path / "apart")
