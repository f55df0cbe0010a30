"""The engine that a command's user has chosen, closed when the command ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from prbench.cli.commands import note
from prbench.engine import close_engine
from prbench.engine.choice import open_engine

if TYPE_CHECKING:
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice


def opened(choice: EngineChoice, **needs: Any) -> Engine:
    """Open an engine for the rest of the command.

    Args:
        choice: What ``prbench.cli.options.engine_options`` gave the command.
        needs: See :func:`prbench.engine.choice.open_engine`.
    """
    engine = open_engine(choice, **needs, tell=note)
    click.get_current_context().call_on_close(lambda: close_engine(engine))
    return engine
