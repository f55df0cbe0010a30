"""The TOML file of a method: what it may say, and how its mistakes are named."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from prbench.errors import InputFileError
from prbench.harness.methods.programs import read_description

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


@pytest.mark.parametrize(
    ("text", "where", "answer"),
    [
        ("", "[method]", "missing required field `method`"),
        ("[method]\n", "method", "missing required field `command`"),
        (COMMAND + "[metod]\n", "[method]", "unknown field `metod`"),
        ('[method]\ncomand = "x"\n', "method", "unknown field `comand`"),
        (COMMAND + "[limits]\nbatch = 3\n", "limits", "unknown field `batch`"),
        (COMMAND + "[limits]\nbatch_s = 0\n", "limits.batch_s", "> 0"),
        (COMMAND + '[limits]\nstart_s = "long"\n', "limits.start_s", "found expected `float`, got `str`"),
        (COMMAND + '[environment]\nvirtual_environment = "v"\n', "environment", "unknown field `virtual_environment`"),
        (
            COMMAND + '[environment]\nconda = "a"\ncontainer = "b"\n',
            "environment.container",
            "found conda and container",
        ),
        (COMMAND + "[environment]\ngpus = true\n", "environment.gpus", "beside 'container' only"),
        (COMMAND + '[environment]\nconda = "a"\nengine = "lxc"\n', "environment.engine", "'lxc'"),
        (COMMAND + '[environment]\nvariables = { PRBENCH_CACHE = "x" }\n', "variables.PRBENCH_CACHE", "never get"),
        ("[method\n", "", "TOML"),
    ],
)
def test_a_mistake_is_named_with_file_and_key(tmp_path, text, where, answer):
    path = written(tmp_path, text)
    with pytest.raises(InputFileError) as error:
        read_description(path)
    assert str(error.value).startswith(str(path))
    assert where in error.value.where
    assert answer in str(error.value)


def test_the_files_that_the_page_shows_are_read(tmp_path):
    page = (Path(__file__).parents[4] / "docs/environments.md").read_text(encoding="utf-8")
    shown = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    assert len(shown) == 5
    for text in shown:
        read_description(written(tmp_path, text if "[method]" in text else COMMAND + text))


def test_a_file_that_is_not_there_is_answered_with_the_nearest_one(tmp_path):
    written(tmp_path, COMMAND)
    with pytest.raises(InputFileError, match=r"found no such file\. Did you mean 'glide\.toml'\?"):
        read_description(tmp_path / "glid.toml")
