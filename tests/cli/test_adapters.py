"""``prbench adapters`` as a user meets it."""

from __future__ import annotations

import json

import pytest

from prbench.cli import main
from prbench.errors import AdapterError
from prbench.training.installed import load_task
from tests.fakes import fake_dataset


@pytest.mark.parametrize("command", [["adapters"], ["adapters", "list"], ["adapters", "new"], ["adapters", "check"]])
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    assert "example:\n  prbench adapters " in capsys.readouterr().out


def test_the_list_is_columns_or_json(capsys):
    assert main(["adapters", "list", "static"]) == 0
    header, row = capsys.readouterr().out.splitlines()
    assert header.split() == ["name", "package", "version", "target"]
    assert row.split()[0::3] == ["static", "prbench_adapters.static:load"]
    assert main(["adapters", "list", "--json"]) == 0
    found = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert found["static"]["target"] == "prbench_adapters.static:load"
    assert {row["problem"] for row in found.values() if row["package"] == "prbench"} == {""}


def test_the_group_alone_lists(capsys):
    assert main(["adapters"]) == 0
    assert "prbench_adapters.static:load" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--method", "{}", "--data", "nowhere"],
        ["adapters", "check", "{}"],
        ["adapters", "list", "--details", "{}"],
    ],
)
@pytest.mark.parametrize(
    ("name", "message"),
    [("statik", "Did you mean 'static'?"), ("python glide.py", "'cmd:python glide.py'"), ("a/b", "looks like a path")],
)
def test_an_unknown_method_is_answered_alike_wherever_it_is_named(arguments, name, message, capsys, tmp_path):
    data = str(fake_dataset(tmp_path / "table", 4).folder) if "--data" in arguments else ""
    assert main([part.format(name).replace("nowhere", data) for part in arguments]) == 5
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors


def test_what_cannot_be_trained_is_told_apart_from_what_does_not_exist():
    with pytest.raises(AdapterError, match="The method 'static' is not trained by this command"):
        load_task("static")
    with pytest.raises(AdapterError, match=r"Did you mean 'mdm'\?"):
        load_task("mdn")
