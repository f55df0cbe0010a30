"""What the commands that work in shards share: ``--shard K/N``, and the report of one shard."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec

from prbench.cli.commands import Answer, note

if TYPE_CHECKING:
    from prbench.engine.shards import Shard

_Function = TypeVar("_Function", bound=Callable[..., Any])


class MadeShard(msgspec.Struct, frozen=True, kw_only=True):
    """One shard that was made, with ``--shard``.

    Attributes:
        shard: Which one it is, such as ``3/16``.
        folder: Its folder, for `prbench merge`.
        made_of: Number of its recordings (of a corpus: groups of them, of a run: batches).
        planned: Number of those of all shards.
        taken_over: Number of recordings or batches that an interrupted call had already finished.
    """

    shard: str
    folder: Path
    made_of: int
    planned: int
    taken_over: int


def shard_option(of: str) -> Callable[[_Function], _Function]:
    """Add ``--shard K/N``.

    Args:
        of: What is dealt out to the shards.
    """
    return click.option(
        "--shard",
        metavar="K/N",
        help=f"Work on shard K of N, such as 3/16: every N-th of {of}; --out is the shard's own folder, and `prbench"
        " merge` puts all of them together (docs/cluster.md).",
    )


def chosen_shard(text: str | None, **refused: object) -> Shard | None:
    """Return the shard that was asked for.

    Args:
        text: What ``--shard`` says.
        refused: Values of options that do not go with it, by the option's name.

    Raises:
        UsageError: for another text, or an option that does not go with it.
    """
    if text is None:
        return None
    from prbench.engine.shards import Shard
    from prbench.errors import UsageError

    shard = Shard.parse(text)
    for name, value in refused.items():
        if value:
            raise UsageError(f"--shard {shard}: does not go with {_REFUSED[name]}.")
    return shard


_REFUSED = {
    "replace": "--replace: a shard replaces nothing; give the option to `prbench merge`",
    "dry_run": "--dry-run, which is of the whole build; leave one of them out",
    "everything": "'all': each dataset is merged by itself; name one",
    "data": "--data: windows of a built table are made in one go; leave --shard out",
    "view": "--view: the motions are whole after `prbench merge`",
    "first_run": "a run without --data: name the tables",
    "table_two": "all: name one method and one condition",
}
"""What is wrong with an option beside ``--shard``, and what to do."""


def shard_answer(report: Any, made: MadeShard, *, unit: str, exit_code: int = 0) -> Answer:
    """Answer a command that has made one shard.

    Args:
        report: The command's report.
        made: The shard.
        unit: What it consists of.
        exit_code: Of the command.
    """

    def show() -> None:
        print(f"shard {made.shard}: {made.made_of} of {made.planned} {unit}")
        print(f"shard folder: {made.folder}")

    if not made.made_of:
        note(f"there are fewer {unit} than shards: shard {made.shard} is empty, and is merged like the others.")
    return Answer(report, show, exit_code)
