"""``prbench adapters`` as a user meets it."""

from __future__ import annotations

import pytest

from prbench.cli import main
from prbench.errors import AdapterError
from prbench.harness.methods.installed import load_task
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


def test_the_list_is_columns_or_json(capsys):
    assert main(["adapters", "list", "static"]) == 0
    header, row = capsys.readouterr().out.splitlines()
    assert header.split() == ["name", "package", "version", "target"]
    assert row.split()[0::3] == ["static", "prbench_adapters.static:load"]
    report = reported(["adapters", "list"], capsys)
    found = {method.name: method for method in report}
    assert found["static"].target == "prbench_adapters.static:load"
    assert {method.problem for method in found.values() if method.package == "prbench"} == {""}


def test_details_are_reported_for_the_named_methods(capsys):
    (static,) = reported(["adapters", "list", "--details", "static"], capsys, kind="--details")
    assert (static.method.name, static.conditions, static.fitted, static.motionless) == ("static", ["none"], True, True)
    refused(["adapters", "list", "statik"], capsys, code=5, message="Did you mean 'static'?")


def test_the_group_alone_shows_help(capsys):
    assert main(["adapters"]) == 2
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in ("list", "new", "check"))


def test_a_new_method_and_the_converters_are_reported(tmp_path, capsys):
    made = reported(["adapters", "new", "glide", "--out", str(tmp_path / "glide")], capsys)
    assert made.folder == tmp_path / "glide"
    assert all((made.folder / file).is_file() for file in made.files)
    assert made.next_steps
    words = ["adapters", "new", "glide", "--out", str(tmp_path / "glide")]
    refused(words, capsys, code=8, message="glide")
    out = tmp_path / "c.py"
    assert reported(["adapters", "list", "--converters", str(out)], capsys) == []
    assert out.is_file()
    out.write_text("somebody's own file")
    refused(["adapters", "list", "--converters", str(out)], capsys, code=8, message="c.py")


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
    [("statik", "Did you mean 'static'?"), ("python glide.py", "'cmd:COMMAND'"), ("a/b", "'cmd:COMMAND'")],
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
