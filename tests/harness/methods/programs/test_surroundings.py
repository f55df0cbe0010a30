"""Virtual environments, conda and containers: exactly what is started, tried with stand-ins for their tools."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from prbench.errors import InputFileError, UsageError
from prbench.harness.methods.process import Program
from prbench.harness.methods.programs import find_executable, own_environment, program_of

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
    hidden = (folder / "m/data/table", folder / "elsewhere")
    words = started(folder, 'container = "i"\nvolumes = ["data:/d"]', hidden=hidden).words
    masked = [words[place + 1] for place, word in enumerate(words) if word == "--tmpfs"]
    assert masked == ["/method/data/table", "/d/table"]


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


def test_a_program_gets_the_users_environment_without_the_harness_variables():
    user = {"PATH": "p", "PRBENCH_CACHE": "c", "prbench_samples": "s", "TOKEN": "t"}
    assert own_environment(user) == {"PATH": "p", "TOKEN": "t"}


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


def test_a_name_is_looked_up_in_path_and_a_path_in_the_directory(programs):
    assert found(programs, "glide") == found(programs, "bin/glide") == found(programs, "./bin/../bin/glide")
    assert found(programs, "glide") == str(programs / "bin/glide")


def test_a_path_may_begin_at_home(programs, monkeypatch):
    monkeypatch.setenv("HOME", str(programs))
    assert found(programs / "bin", "~/bin/walk") == str(programs / "bin/walk")


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
