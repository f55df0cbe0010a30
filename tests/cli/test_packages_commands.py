"""Packages register commands of their own; a former command names the present one."""

from __future__ import annotations

import importlib

import click
import pytest

from prbench.cli.commands import Group
from prbench.cli.main import _RENAMED, main, program
from tests.parsing import all_commands

GREETING = """
import click
from prbench.cli.commands import command

@command("greet", example="prbench greet", section="look")
@click.argument("name")
def greet(name):
    '''Greet somebody.'''
    print("hello", name)

broken = 3
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a command, one that is none, one whose module is missing, and one that is called as ours."""
    info = tmp_path / "made-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: made\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[prbench.commands]\ngreet = made_commands:greet\nno-command = made_commands:broken\n"
        "absent = nowhere_to_be_found:x\nrun = made_commands:greet\nodd\n"
    )
    (tmp_path / "made_commands.py").write_text(GREETING)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    program.__dict__.pop("_plugins", None)
    yield
    program.__dict__.pop("_plugins", None)


def test_a_command_of_a_package_is_listed_in_its_section_and_runs(package, capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    look = text.partition("look: ")[2].partition("\n\n")[0]
    assert "greet" in look
    assert "Greet somebody" in look
    assert main(["greet", "you"]) == 0
    assert capsys.readouterr().out == "hello you\n"
    assert main(["greet"]) == 2


@pytest.mark.parametrize(
    ("name", "problem"),
    [("no-command", "expected a Command or Group"), ("absent", "No module named 'nowhere_to_be_found'")],
)
def test_a_broken_command_breaks_itself_only(name, problem, package, capsys):
    assert main(["--help"]) == 0
    assert name not in capsys.readouterr().out
    assert main([name]) == 2
    error = capsys.readouterr().err
    assert f"the command '{name}' of the package made 1.0 cannot be used: " in error
    assert problem in error


def test_a_package_never_takes_the_place_of_a_command_of_prbench(package):
    assert all_commands()["run"].callback.__module__.startswith("prbench")


@pytest.mark.parametrize("former", _RENAMED)
def test_a_former_command_names_the_present_one(former, capsys):
    if former in all_commands() or isinstance(program.get_command(None, former), Group):
        pytest.skip("not moved yet")
    assert main([*former.split(), "--json"]) == 2
    assert f"'prbench {former}' is now `prbench {_RENAMED[former]}`." in capsys.readouterr().err


def test_a_section_without_commands_is_left_out():
    group = Group(
        "g",
        example="prbench diff a b",
        sections={"empty: nothing here": {}, "data: one": {"diff": "prbench.cli.view:diff"}},
    )
    text = group.get_help(click.Context(group, info_name="g"))
    assert "empty" not in text
    assert "data: one" in text
