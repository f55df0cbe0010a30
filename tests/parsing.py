"""Parse a command line as ``prbench`` does, without running it."""

from __future__ import annotations

from collections.abc import Sequence

import click

from prbench.cli.commands import Session
from prbench.cli.main import program


def parsed(words: Sequence[str]) -> click.Context:
    """The parsed command line of one command; ``--help``, which ends a program at once, is passed over.

    Raises:
        click.UsageError: as ``prbench`` would.
    """
    context = click.Context(program, info_name="prbench", obj=Session())
    command: click.Command = program
    rest = [word for word in words if word != "--help"]
    if not rest:
        return context
    while isinstance(command, click.Group):
        name, found, rest = command.resolve_command(context, rest)
        assert found is not None
        command = found
        context = command.make_context(name, rest, parent=context)
        rest = [*context._protected_args, *context.args]
    return context


def all_commands() -> dict[str, click.Command]:
    """Every command by its full name, such as ``leaderboard export``."""
    return dict(program.walk(click.Context(program, info_name="prbench")))
