"""The embedded synthetic datasets, which commands take that are given no other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.commands import note
from prbench.cli.progress import progress

if TYPE_CHECKING:
    from prbench.engine import Engine


def embedded_tables(engine: Engine) -> tuple[Path, ...]:
    """Return the folders of the embedded synthetic datasets, which are built on the first call."""
    from prbench.harness.first_run import LAYOUTS, default_folder, default_tables, default_tables_are_built

    folder = default_folder()
    if default_tables_are_built():
        note(f"no --data given: using the {len(LAYOUTS)} embedded synthetic datasets in {folder}")
    else:
        note(f"no --data given: building {len(LAYOUTS)} small synthetic datasets in {folder} (once)")
    with progress("building synthetic data") as show:
        return tuple(table.folder for table in default_tables(engine, show, tell=note))
