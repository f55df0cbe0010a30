"""Methods that are programs of the user's own: commands, TOML files, environments, and what a run of them records."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from prbench.engine import ProcessPool
from prbench.errors import AdapterError, InputFileError, RunError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.methods.installed import is_program, short_name
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.methods.process import Program
from prbench.harness.methods.programs import find_executable, program_of, read_description, shown_command, split_command
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.run_folder.summary import DatasetSummary
from tests.harness.methods.made_programs import MARK, READ_AND_WRITE, marked
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source

SOURCE = """
import numpy as np
import pyarrow as pa

settings, _ = read()
introduction = {"message": "hello", "wire": 1, "name": "drawn", "version": "2.1", "conditions": ["none", "goal-loc"]}
%(hello)s
write(introduction)
while True:
    header, payload = read()
    rows = pa.ipc.open_stream(payload).read_next_batch().to_pydict()
    joints = []
    for seed, n_frames in zip(rows["noise_seed"], rows["n_frames"]):
        joints.append(np.random.default_rng(seed).normal(size=n_frames * 66).astype(np.float32))
    answer = {"message": "motions", "batch": header["batch"], "network_passes": 3}
    %(body)s
    batch = pa.record_batch([pa.array(rows["opaque_id"]), pa.array(joints, pa.list_(pa.float32()))],
                            names=["opaque_id", "joints"])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    write(answer, sink.getvalue().to_pybytes())
"""


@dataclass(frozen=True)
class OwnProgram:
    """A folder with a program, and the mark that all its processes carry."""

    folder: Path
    mark: str

    @property
    def method(self) -> str:
        """For ``--method``."""
        return f'cmd:"{sys.executable}" "{self.folder / "drawn.py"}"'

    def write(self, *, hello: str = "", body: str = "") -> str:
        """Write ``drawn.py``; ``hello`` changes ``introduction``, ``body`` runs before a batch is answered."""
        self.folder.mkdir(exist_ok=True)
        text = READ_AND_WRITE + SOURCE % {"hello": hello, "body": body.replace("\n", "\n    ")}
        (self.folder / "drawn.py").write_text(text)
        return self.method

    def running(self) -> list[psutil.Process]:
        """This program and its kin, in this process or below another one."""
        found = []
        for process in marked(self.mark):
            with contextlib.suppress(psutil.Error):
                if "drawn.py" in " ".join(process.cmdline()):
                    found.append(process)
        return found


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnProgram]:
    """A program of the user's own; nothing of it may be left when the test is over."""
    program = OwnProgram(tmp_path / "method", uuid.uuid4().hex)
    monkeypatch.setenv(MARK, program.mark)
    yield program
    until = time.monotonic() + 5
    while (left := program.running()) and time.monotonic() < until:
        time.sleep(0.05)
    for process in left:
        process.kill()
    assert not left, "a program is left behind"


@pytest.mark.parametrize(
    ("text", "windows", "words"),
    [
        (
            """python 'my methods/glide.py' --title "a b" c\\ d""",
            False,
            ("python", "my methods/glide.py", "--title", "a b", "c d"),
        ),
        (
            r'"C:\Program Files\Python\python.exe" C:\methods\glide.py --root D:\data\ ""',
            True,
            (r"C:\Program Files\Python\python.exe", r"C:\methods\glide.py", "--root", "D:\\data\\", ""),
        ),
    ],
)
def test_a_command_is_split_as_the_system_splits_it(text, windows, words):
    assert split_command(text, where="", windows=windows) == words


@pytest.mark.parametrize("windows", [False, True])
@pytest.mark.parametrize("text", ["", "   ", "''", 'python "glide.py'])
def test_a_command_of_nothing_and_an_open_quotation_are_refused(text, windows):
    told = 'found: python "glide' if "python" in text else 'expected a command, such as cmd:"python glide.py"'
    with pytest.raises(UsageError, match=f"--method cmd:…: .*{told}"):
        split_command(text, where="--method cmd:…", windows=windows)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (("python", "glide.py"), "python glide.py"),
        (("/home/me/envs/x/bin/python", "/home/me/glide.py"), "python glide.py"),
        (("node", "--cwd=/home/me/m", "--n=3", "~/glide.mjs"), "node --cwd=m --n=3 glide.mjs"),
        ((r"C:\Users\me\python.exe", "sub/glide.py"), "python.exe sub/glide.py"),
        (("python", "my glide.py"), "python 'my glide.py'"),
    ],
)
def test_a_recorded_command_tells_no_folders_of_the_machine(words, shown):
    assert shown_command(words) == shown


def test_methods_are_told_apart_by_their_form_and_never_called_by_a_path():
    assert [is_program(text) for text in ("static", "cmd:python glide.py", "a/Glide.TOML")] == [False, True, True]
    assert short_name("/home/me/methods/glide.toml") == "glide"
    assert short_name("cmd:  python   glide.py") == "python glide.py"
    assert short_name('cmd:"/home/me/bin/python" /home/me/glide.py') == "python glide.py"
    assert short_name("cmd:python glide.py" + " --more" * 20).endswith("--more …")
    assert short_name("static") == "static"


COMMAND = '[method]\ncommand = ["python", "glide.py"]\n'


def written(tmp_path, text):
    path = tmp_path / "glide.toml"
    path.write_text(text)
    return path


def test_a_command_is_enough_and_the_rest_has_defaults(tmp_path):
    description = read_description(written(tmp_path, COMMAND))
    assert description.method.command == ("python", "glide.py")
    assert (description.method.name, description.method.directory) == (None, ".")
    assert (description.limits.start_s, description.limits.batch_s) == (120, 600)
    assert description.environment.virtual_environment is None


def test_every_key_of_the_page_is_read(tmp_path):
    description = read_description(
        written(
            tmp_path,
            '[method]\nname = "glide"\ncommand = "node glide.mjs"\ndirectory = "js"\n'
            '[environment]\ncontainer = "glide@sha256:1"\nengine = "docker"\ngpus = true\nuser = "1:1"\n'
            'volumes = ["a", "b:/b"]\nvariables = { A = "1" }\n[limits]\nstart_s = 1.5\nbatch_s = 2\n',
        )
    )
    environment = description.environment
    assert (description.method.name, description.method.command) == ("glide", "node glide.mjs")
    assert (environment.container, environment.engine, environment.gpus) == ("glide@sha256:1", "docker", True)
    assert (environment.user, environment.volumes, environment.variables) == ("1:1", ("a", "b:/b"), {"A": "1"})
    assert (description.limits.start_s, description.limits.batch_s) == (1.5, 2.0)


def test_the_files_that_the_page_shows_are_read(tmp_path):
    page = (Path(__file__).parents[3] / "docs/environments.md").read_text(encoding="utf-8")
    shown = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    assert len(shown) == 5
    for text in shown:
        read_description(written(tmp_path, text if "[method]" in text else COMMAND + text))


pytestmark = pytest.mark.skipif(os.name == "nt", reason="makes programs as POSIX systems have them")

TOOL = '#!/bin/sh\nwhile [ $# -gt 0 ] && [ "$1" != python ]; do shift; done\nexec "$@"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A method ``m/glide.py``, and stand-ins for conda, podman and docker that run the rest of their command."""
    (tmp_path / "m").mkdir()
    (tmp_path / "m/glide.py").write_text("import os, sys; print(sys.argv, os.environ.get('A'))")
    (tmp_path / "tools").mkdir()
    for name in ("conda", "podman", "docker"):
        (tmp_path / "tools" / name).write_text(TOOL)
        (tmp_path / "tools" / name).chmod(0o755)
    return tmp_path


def started(folder: Path, environment: str, *, tools: tuple[str, ...] = ("conda", "podman", "docker"), **given):
    for tool in {"conda", "podman", "docker"} - set(tools):
        (folder / "tools" / tool).unlink(missing_ok=True)
    file = folder / "m/glide.toml"
    file.write_text(f'[method]\ncommand = ["python", "glide.py", "-x"]\n[environment]\n{environment}\n')
    path = os.pathsep.join([str(folder / "tools"), str(Path(sys.executable).parent)])
    return program_of(str(file), environment={"PATH": path, "PYTHONHOME": "/nowhere"}, **given)


def output(program: Program) -> str:
    done = subprocess.run(
        program.words, cwd=program.directory, env=dict(program.environment), capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_python_becomes_that_of_the_virtual_environment_and_its_variables_are_set(folder):
    venv.create(folder / "envs/glide", with_pip=False)
    method = started(folder, 'virtual-environment = "../envs/glide"\nvariables = { A = "1" }')
    own = folder / "envs/glide"
    environment = dict(method.environment)
    assert method.words == (str(own / "bin/python"), "glide.py", "-x")
    assert method.directory == folder / "m"
    assert environment["PATH"].split(os.pathsep)[0] == str(own / "bin")
    assert environment["VIRTUAL_ENV"] == str(own)
    assert "PYTHONHOME" not in environment
    assert method.package == "virtual environment glide: python glide.py -x"
    assert output(method) == "['glide.py', '-x'] 1"


def test_a_virtual_environment_that_is_not_there_is_answered_with_how_to_make_it(folder):
    with pytest.raises(
        InputFileError, match=r"glide\.toml, environment\.virtual-environment: .*python -m venv"
    ) as error:
        started(folder, 'virtual-environment = "~/no/such"')
    assert str(Path.home() / "no/such") in str(error.value)


def test_conda_runs_the_command_in_a_named_environment_and_passes_streams_through(folder):
    method = started(folder, 'conda = "glide"')
    expected = ("run", "--no-capture-output", "-n", "glide", "python", "glide.py", "-x")
    assert method.words == (str(folder / "tools/conda"), *expected)
    assert method.package == "conda glide: python glide.py -x"
    assert "'-x'" in output(started(folder, 'conda = "glide"\nvariables = { PYTHONHOME = "" }'))


def test_conda_finds_an_environment_by_its_folder(folder):
    (folder / "m/env/conda-meta").mkdir(parents=True)
    method = started(folder, 'conda = "./env"')
    assert method.words[1:5] == ("run", "--no-capture-output", "-p", str(folder / "m/env"))
    with pytest.raises(InputFileError, match=r"environment\.conda: expected a conda environment at .*no such folder"):
        started(folder, 'conda = "./other"')


def test_conda_itself_may_be_missing(folder):
    with pytest.raises(InputFileError, match=r"environment\.conda: expected the program 'conda', found none in PATH"):
        started(folder, 'conda = "glide"', tools=())


def test_a_container_sees_the_method_read_only_and_no_network(folder):
    method = started(folder, 'container = "glide@sha256:12"')
    expected = ("run", "--rm", "--init", "-i", "--network", "none", "--workdir", "/method")
    mounted = ("--volume", f"{folder / 'm'}:/method:ro")
    assert method.words == (
        str(folder / "tools/podman"), *expected, *mounted, "glide@sha256:12", "python", "glide.py", "-x",
    )  # fmt: skip
    assert method.package == "podman glide@sha256:12: python glide.py -x"
    assert method.in_container


def test_docker_runs_as_the_user_with_gpus_volumes_weights_and_variables(folder):
    (folder / "bodies").mkdir()
    (folder / "w.npz").touch()
    method = started(
        folder,
        'container = "i"\nengine = "docker"\ngpus = true\nvolumes = ["../bodies", "../bodies:/b"]\n'
        'variables = { B = "2", A = "1" }',
        weights=folder / "w.npz",
    )
    words = method.words
    bodies = folder / "bodies"
    assert words[0] == str(folder / "tools/docker")
    assert words[words.index("--volume") + 2 : words.index("i")] == (
        "--volume", f"{bodies}:{bodies}:ro", "--volume", f"{bodies}:/b:ro",
        "--volume", f"{folder / 'w.npz'}:{folder / 'w.npz'}:ro",
        "--user", f"{os.getuid()}:{os.getgid()}", "--gpus", "all", "--env", "A=1", "--env", "B=2",
    )  # fmt: skip


def test_podman_takes_gpus_by_their_device_and_a_user_if_one_is_named(folder):
    words = started(folder, 'container = "i"\ngpus = true\nuser = "7:8"').words
    assert words[-9:-4] + words[-4:] == (
        f"{folder / 'm'}:/method:ro", "--user", "7:8", "--device", "nvidia.com/gpu=all",
        "i", "python", "glide.py", "-x",
    )  # fmt: skip


def test_a_container_that_must_not_see_a_table_gets_an_empty_folder_in_its_place(folder):
    (folder / "m/data/table").mkdir(parents=True)
    (folder / "m/a.key").touch()
    hidden = (folder / "m/data/table", folder / "elsewhere", folder / "m/a.key")
    words = started(folder, 'container = "i"\nvolumes = ["data:/d"]', hidden=hidden).words
    masked = [words[place + 1] for place, word in enumerate(words) if word == "--tmpfs"]
    assert masked == ["/method/data/table", "/d/table"]
    assert "/dev/null:/method/a.key:ro" in words


def test_the_other_engine_is_taken_where_one_is_missing_and_none_is_named(folder):
    assert started(folder, 'container = "i"', tools=("docker",)).words[0] == str(folder / "tools/docker")
    with pytest.raises(InputFileError, match=r"environment\.container: expected the program podman or docker"):
        started(folder, 'container = "i"', tools=())


def test_a_volume_or_directory_that_is_not_there_is_named(folder):
    with pytest.raises(InputFileError, match=r"environment\.volumes: expected the file or folder .*m/none"):
        started(folder, 'container = "i"\nvolumes = ["none:/n"]')
    (folder / "m/glide.toml").write_text('[method]\ncommand = "python glide.py"\ndirectory = "none"\n')
    with pytest.raises(InputFileError, match=r"method\.directory: expected a folder at .*m/none"):
        program_of(str(folder / "m/glide.toml"), environment={})


def test_python_of_a_command_is_that_of_the_users_shell_not_the_harness(folder, monkeypatch):
    (folder / "tools/python").write_text(TOOL)
    (folder / "tools/python").chmod(0o755)
    monkeypatch.chdir(folder / "m")
    method = program_of("cmd:python glide.py", environment={"PATH": str(folder / "tools")})
    assert method.words == (str(folder / "tools/python"), "glide.py")
    assert method.directory == folder / "m"
    assert method.package == "python glide.py"


def test_words_may_begin_at_home_as_in_a_shell(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder))
    method = program_of("cmd:sh ~/m/glide.py --n ~ a~/b", environment={"PATH": "/bin"})
    assert method.words[1:] == (str(folder / "m/glide.py"), "--n", "~", "a~/b")
    assert method.package == "sh glide.py --n '~' 'a~/b'"


def test_limits_come_from_the_file_and_the_users_timeout_comes_before_them(folder):
    file = folder / "m/glide.toml"
    file.write_text('[method]\ncommand = "./glide.py"\n[limits]\nstart_s = 3\nbatch_s = 4\n')
    with pytest.raises(UsageError, match=r"glide\.toml, method\.command: .* cannot be executed"):
        program_of(str(file), environment={})
    (folder / "m/glide.py").chmod(0o755)
    program = program_of(str(file), environment={})
    assert (program.start_timeout, program.batch_timeout, program.name) == (3, 4, "glide")
    assert program_of(str(file), environment={}, timeout=9.0).batch_timeout == 9


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """``bin/glide`` and ``bin/walk`` can be executed, ``glide.py`` and ``notes`` cannot."""
    (tmp_path / "bin").mkdir()
    for name in ("bin/glide", "bin/walk", "glide.py", "notes"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755 if name.startswith("bin/") else 0o644)
    return tmp_path


def found(programs: Path, word: str) -> str:
    return find_executable(word, directory=programs, path=str(programs / "bin"), where="here")


def test_a_name_is_looked_up_in_path_and_a_path_in_the_directory_or_at_home(programs, monkeypatch):
    monkeypatch.setenv("HOME", str(programs))
    for word in ("glide", "bin/glide", "./bin/../bin/glide", "~/bin/glide"):
        assert found(programs, word) == str(programs / "bin/glide")


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("glid", "the program 'glid' was not found. It is looked up in the folders of PATH."),
        ("bin/wallk", "found none. Did you mean 'walk'?"),
        ("./glide.py", "found a file that cannot be executed. Start it with its interpreter."),
        ("zzzzzzzzz", "It is looked up in the folders of PATH."),
    ],
)
def test_a_program_that_is_not_there_is_answered_with_what_may_be_meant(programs, word, answer):
    with pytest.raises(UsageError) as error:
        found(programs, word)
    assert answer in str(error.value)


PROGRAM = """
import sys
from pathlib import Path
from prbench.contract import Condition
from prbench.engine import engine_for
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
if __name__ == "__main__":
    run_method(
        RunRequest(
            method=sys.argv[1],
            condition=Condition.NONE,
            data=(Path(sys.argv[2]),),
            out=Path(sys.argv[3]),
            batch_size=4,
        ),
        engine=engine_for(int(sys.argv[4])),
        progress=lambda step: print(step.stage, step.done, flush=True),
    )
"""


def parts(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in reproducible_bytes(folder).items() if name != "run.json"}


def test_the_record_holds_what_the_program_says_and_no_path_of_the_machine(own, table, tmp_path):
    own.write(hello='introduction.update(weights={"none": {"name": "w.npz", "sha256": "%s"}})' % ("0" * 64))
    report = run_method(request(table, tmp_path / "out", own.method, options={"a": "1"}))
    record = RunRecord.read(tmp_path / "out").method
    assert (record.name, record.kind, record.version) == ("drawn", "program", "2.1")
    assert record.package == f"{Path(sys.executable).name} drawn.py"
    assert (record.weights, record.weights_digest, record.isolation) == ("w.npz", "0" * 64, None)
    assert record.options == {"a": "1"}
    assert report.summaries[0].method == "drawn"
    assert DatasetSummary.read(tmp_path / "out/synthetic-adt").method == "drawn"
    written = (tmp_path / "out/run.json").read_text() + (tmp_path / "out/synthetic-adt/summary.json").read_text()
    assert str(tmp_path) not in written
    assert "cmd:" not in written


def test_a_program_and_the_same_method_in_process_give_the_same_bytes(own, table, tmp_path, install):
    own.write()
    install("made", adapter_source(body="joints = joints.astype(np.float32)"))
    run_method(request(table, tmp_path / "in", "made", samples=2))
    run_method(request(table, tmp_path / "out", own.method, samples=2), engine=ProcessPool(2))
    predictions = {name: content for name, content in parts(tmp_path / "in").items() if "summary" not in name}
    assert len(predictions) == 6
    assert {name: parts(tmp_path / "out")[name] for name in predictions} == predictions


def test_seconds_passes_and_the_programs_memory_stand_in_the_cost(own, table, tmp_path):
    own.write(hello="ballast = np.ones(50_000_000)")
    run_method(request(table, tmp_path / "out", own.method))
    cost = json.loads((tmp_path / "out/synthetic-adt/cost.json").read_text())
    assert cost["network_passes_declared"] == 3 * 4
    assert cost["seconds"] > 0
    assert cost["peak_process_bytes"] > 400_000_000


def test_a_program_gets_settings_and_an_environment_without_the_harness(own, table, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_SECRET", "1")
    monkeypatch.setenv("prbench_samples", "s")
    monkeypatch.setenv("USER_OWN", "2")
    (tmp_path / "w.npz").write_bytes(b"weights")
    own.write(hello='print(json.dumps([settings, dict(os.environ), os.getcwd()]), file=open("told.json", "w"))')
    monkeypatch.chdir(tmp_path)
    changes = {"weights": Path("w.npz"), "options": {"k": "v"}, "threads": 2, "device": "cuda:1"}
    run_method(request(table, tmp_path / "out", own.method, limit=1, **changes))
    settings, environment, directory = json.loads((tmp_path / "told.json").read_text())
    assert settings["weights"] == str(tmp_path / "w.npz")
    assert (settings["options"], settings["threads"], settings["device"]) == ({"k": "v"}, 2, "cuda:1")
    assert environment["USER_OWN"] == "2"
    assert not [name for name in environment if name.upper().startswith("PRBENCH_")]
    assert directory == str(tmp_path)
    record = RunRecord.read(tmp_path / "out").method
    assert (record.weights, record.weights_digest) == ("w.npz", file_digest(tmp_path / "w.npz"))


@pytest.mark.parametrize(
    ("name", "owner"), [("Ground_Truth", "control of prbench"), ("pr", "method of prbench itself")]
)
def test_a_program_must_not_call_itself_like_what_belongs_to_prbench(own, table, tmp_path, name, owner):
    own.write(hello=f'introduction.update(name="{name}")')
    with pytest.raises(
        AdapterError,
        match=f"'{name}' is a {owner}; only prbench itself may use this name. Let it introduce itself by another",
    ):
        run_method(request(table, tmp_path / "out", own.method))
    assert not (tmp_path / "out").exists()


def test_a_toml_file_says_how_the_program_must_call_itself(own, table, tmp_path):
    own.write()
    file = own.folder / "drawn.toml"
    file.write_text(f'[method]\nname = "drawn"\ncommand = [\'{sys.executable}\', "drawn.py"]\n')
    run_method(request(table, tmp_path / "out", str(file)))
    assert RunRecord.read(tmp_path / "out").method.package == f"{Path(sys.executable).name} drawn.py"
    file.write_text(file.read_text().replace('"drawn"', '"glide"'))
    with pytest.raises(AdapterError, match="method 'glide': expected the program to introduce itself by this name"):
        run_method(request(table, tmp_path / "other", str(file)))


@pytest.mark.skipif(os.name == "nt", reason="makes programs as POSIX systems have them")
@pytest.mark.parametrize(
    ("environment", "tool", "isolation"),
    [('conda = "drawn"', "conda", None), ('container = "drawn@sha256:1"', "podman", "container")],
)
def test_a_method_runs_in_its_own_environment(own, table, tmp_path, monkeypatch, environment, tool, isolation):
    own.write()
    (tmp_path / tool).write_text('#!/bin/sh\nwhile [ "$1" != python ]; do shift; done\nshift\nexec $REAL "$@"\n')
    (tmp_path / tool).chmod(0o755)
    file = own.folder / "drawn.toml"
    variables = f'variables = {{ REAL = "{sys.executable}" }}'
    file.write_text(f'[method]\ncommand = "python drawn.py"\n[environment]\n{environment}\n{variables}\n')
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/bin")
    run_method(request(table, tmp_path / "out", str(file), limit=2, isolate=isolation is not None))
    record = RunRecord.read(tmp_path / "out").method
    assert (record.name, record.isolation) == ("drawn", isolation)
    assert record.package.startswith(tool)
    assert record.package.endswith(": python drawn.py")


def test_another_version_of_the_program_does_not_go_on_in_the_folder(own, table, tmp_path):
    own.write()
    run_method(request(table, tmp_path / "out", own.method))
    own.write(hello='introduction.update(version="3")')
    with pytest.raises(RunError, match=r"method\.version: expected 3 for this run, found 2\.1"):
        run_method(request(table, tmp_path / "out", own.method))


def test_wrong_lengths_and_late_answers_end_the_run_and_keep_what_was_finished(own, table, tmp_path):
    own.write(body='if header["batch"] == 2: joints[0] = joints[0][66:]')
    with pytest.raises(AdapterError, match=r"method 'drawn', sequence synthetic-adt.*: expected \d+ frames, found \d+"):
        run_method(request(table, tmp_path / "out", own.method))
    assert len(list((tmp_path / "out/synthetic-adt/predictions").glob("part-*.parquet"))) == 2
    own.write(body="time.sleep(60)")
    with pytest.raises(AdapterError, match="--timeout"):
        run_method(request(table, tmp_path / "out", own.method, timeout=0.5))
    own.write()
    report = run_method(request(table, tmp_path / "out", own.method))
    assert (report.batches_found, report.batches_made) == (2, 2)
    run_method(request(table, tmp_path / "whole", own.method))
    assert reproducible_bytes(tmp_path / "out") == reproducible_bytes(tmp_path / "whole")


def test_ctrl_c_ends_the_program_keeps_what_was_finished_and_the_same_command_resumes(own, table, tmp_path):
    own.write()

    def interrupt(step):
        if (step.stage, step.done) == ("generate", 2):
            assert own.running()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_method(request(table, tmp_path / "out", own.method), progress=interrupt)
    assert not own.running()
    report = run_method(request(table, tmp_path / "out", own.method))
    assert (report.batches_found, report.batches_made) == (2, 2)
    run_method(request(table, tmp_path / "whole", own.method))
    assert reproducible_bytes(tmp_path / "out") == reproducible_bytes(tmp_path / "whole")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(("end", "workers"), [("SIGINT", 2), ("SIGKILL", 1)])
def test_no_program_outlives_a_harness_that_was_stopped(own, table, tmp_path, end, workers):
    own.write(body="time.sleep(0.2)")
    (tmp_path / "run.py").write_text(PROGRAM)
    words = [str(tmp_path / "run.py"), own.method, str(table.folder), str(tmp_path / "out"), str(workers)]
    run = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True, start_new_session=True)
    next(line for line in run.stdout if line.startswith("generate 1"))
    assert own.running()
    os.killpg(run.pid, getattr(signal, end))
    run.communicate(timeout=20)  # the fixture sees that the programs have ended


def test_settings_that_do_not_fit_together_are_refused(table, tmp_path):
    with pytest.raises(UsageError, match=r"--timeout: 'static' runs in this process.*Add --isolate"):
        method_spec("static", timeout=3.0)
    with pytest.raises(UsageError, match="--timeout: expected seconds above 0, found 0"):
        request(table, tmp_path, timeout=0.0)
    with pytest.raises(UsageError, match="--method scripted is part of the harness"):
        request(table, tmp_path, "scripted", isolate=True)
    with pytest.raises(UsageError, match=r"--weights no/such\.npz: expected a file or folder"):
        run_method(RunRequest(method="cmd:python x", data=(table.folder,), weights=Path("no/such.npz")))


def test_a_forgotten_program_ends_at_once(own):
    own.write()
    assert method_spec(own.method).load().adapter.name == "drawn"
    assert len(own.running()) == 1
    forget_loaded_methods()
    assert not own.running()


CRASH = """
if {when}:
    print("CUDA error: an illegal memory access", file=sys.stderr, flush=True)
    os._exit(134)
"""


def test_after_a_crash_the_same_command_resumes(own, table, tmp_path, monkeypatch):
    own.write()
    monkeypatch.chdir(own.folder)  # where a program of the user's own starts
    run_method(request(table, tmp_path / "whole", own.method))

    own.write(body=CRASH.format(when="header['batch'] == 1"))
    with pytest.raises(AdapterError) as caught:
        run_method(request(table, tmp_path / "twice", own.method))
    message = str(caught.value)
    assert message.startswith("method 'drawn': its program ended with exit status 134")
    assert "It was asked for the batch of 4 sequences from synthetic-adt/rec" in message
    assert message.endswith("    CUDA error: an illegal memory access")
    assert len(list((tmp_path / "twice/synthetic-adt/predictions").glob("part-*.parquet"))) == 1

    own.write()
    assert run_method(request(table, tmp_path / "twice", own.method)).batches_found == 1
    assert reproducible_bytes(tmp_path / "twice") == reproducible_bytes(tmp_path / "whole")
