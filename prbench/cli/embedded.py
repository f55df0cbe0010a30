"""The embedded synthetic dataset, which commands take that are given no other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.commands import note
from prbench.cli.progress import progress

if TYPE_CHECKING:
    from prbench.engine import Engine


def embedded_table(engine: Engine) -> Path:
    """Return the folder of the embedded synthetic dataset, which is built on the first call."""
    from prbench.workflows.first_run import RECORDINGS, default_table, default_table_folder

    folder = default_table_folder()
    if (folder / "dataset.json").is_file():
        note(f"no --data given: using the embedded synthetic dataset in {folder}")
    else:
        note(f"no --data given: building a synthetic dataset of {RECORDINGS} recordings in {folder} (once)")
    with progress("building synthetic data") as show:
        return default_table(engine, show, tell=note).folder
