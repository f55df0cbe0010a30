"""What an isolated method sees of the machine, tried from inside."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from prbench.errors import AdapterError, UsageError
from prbench.harness.methods.isolation import available_fence
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.run import run_method
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source

SPY = """
import json, os, socket, sys

def exists(path):
    try:
        return sorted(os.listdir(path)) if os.path.isdir(path) else os.path.exists(path)
    except OSError as error:
        return type(error).__name__

def report(paths):
    try:
        socket.create_connection(("127.0.0.1", PORT), timeout=1).close()
        network = True
    except OSError:
        network = False
    try:
        open(os.path.join(os.path.dirname(__file__), "written"), "w").close()
        written = True
    except OSError:
        written = False
    return json.dumps({
        "seen": {path: exists(path) for path in paths}, "environment": sorted(os.environ), "network": network,
        "home": os.environ.get("HOME"), "pwd": os.environ.get("PWD"),
        "written": written, "here": exists("."), "tmp": exists("/tmp")[:9],
        "processes": sum(name.isdecimal() for name in os.listdir("/proc")) if os.path.isdir("/proc") else 0,
    })
"""


@pytest.fixture
def port():
    """Somebody listens on this machine."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def told(spec_or_request, tmp_path) -> dict:
    """What the spy has told in the error that ends its run."""
    with pytest.raises(AdapterError) as error:
        run_method(spec_or_request)
    text = str(error.value)
    return json.JSONDecoder().raw_decode(text[text.index("{") :])[0]


@pytest.fixture
def spy(install, tmp_path, port, monkeypatch):
    """An installed method that looks around; its folder, and a table inside it as in an editable checkout."""

    def _spy(paths: list[Path]) -> None:
        body = f"import spy_tools; raise ValueError(spy_tools.report({[str(path) for path in paths]!r}))"
        install("made", adapter_source(body=body))
        (tmp_path / "site/spy_tools.py").write_text(SPY.replace("PORT", str(port)))

    monkeypatch.setenv("PRBENCH_SECRET", "1")
    monkeypatch.setenv("DATA_ROOT", "/data")
    return _spy


def test_behind_bubblewrap_there_is_no_table_run_cache_home_or_network(bubblewrap, spy, table, tmp_path):
    inside = tmp_path / "site/data/table"
    shutil.copytree(table.folder, inside)
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache/secret").touch()
    home = Path.home()
    spy(
        [
            inside,
            table.folder,
            tmp_path / "out",
            tmp_path / "cache",
            tmp_path / "site/data",
            tmp_path,
            home,
            Path("/proc/1/root/root"),
        ]
    )
    assert available_fence().notice.endswith("network and the file system are withheld.")
    seen = told(request(table, tmp_path / "out", "made", data=(inside,), isolate=True), tmp_path)
    assert seen["seen"][str(inside)] == []  # covered, though its folder is shown
    assert seen["seen"][str(tmp_path / "site/data")] == ["table"]
    assert seen["seen"][str(table.folder)] is False
    assert seen["seen"][str(tmp_path / "out")] is False
    assert seen["seen"][str(tmp_path / "cache")] is False
    assert seen["seen"][str(tmp_path)] == ["site"]
    assert seen["network"] is False
    assert seen["written"] is False
    assert seen["here"] == []
    assert {"home", "work"} <= set(seen["tmp"])
    assert seen["processes"] <= 3
    assert not {"PRBENCH_SECRET", "DATA_ROOT", "OLDPWD", "USER"} & set(seen["environment"])
    assert (seen["home"], seen["pwd"]) == ("/tmp/home", "/tmp/work")
    visible = {name for name, content in seen["seen"].items() if content} - {str(tmp_path), str(inside.parent)}
    assert not [name for name in visible if "table" in name]


def test_without_bubblewrap_paths_and_environment_are_withheld_and_the_notice_says_what_is_not(
    no_bubblewrap, spy, table, tmp_path
):
    spy([table.folder])
    seen = told(request(table, tmp_path / "out", "made", isolate=True), tmp_path)
    assert not {"PRBENCH_SECRET", "DATA_ROOT", "HOME", "PWD"} & set(seen["environment"])
    assert seen["here"] == []
    assert seen["seen"][str(table.folder)]  # the file system is not withheld, and the notice says so:
    assert "THE FILE SYSTEM IS NOT WITHHELD " in available_fence().notice


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
    seen = told(request(table, tmp_path / "out", method, data=(folder / "table",), isolate=True), tmp_path)
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


def test_the_folder_that_was_made_to_be_covered_vanishes_with_a_run_that_fails(
    bubblewrap, table, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AdapterError):
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
