"""``folds.json``: the runs that a merged run was put together from (``prbench merge RUN … --out``)."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.files.bounded import foreign_input
from prbench.files.storage import file_digest, write_json
from prbench.harness.run_folder import record
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import read_record

FILE_NAME = "folds.json"


class FoldRun(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The run on one fold."""

    fold: str
    """Such as ``2/6``."""
    run: str
    """Name of its folder, for people."""
    record_sha256: str
    """Digest of its ``run.json``."""
    scores_sha256: str
    """Digest of its ``scores.parquet``."""

    @classmethod
    def of(cls, run: RunFolder) -> FoldRun:
        """Describe a finished run on one dataset."""
        table = run.record.tables[0]
        return cls(
            fold=table.fold or "",
            run=run.path.resolve().name,
            record_sha256=file_digest(run.path / record.FILE_NAME),
            scores_sha256=file_digest(run.dataset(table.dataset).scores),
        )

    @property
    def key(self) -> tuple[str, str]:
        """Both digests, by which the run is found again."""
        return self.record_sha256, self.scores_sha256


class MergedFrom(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole of ``folds.json``."""

    folds: tuple[FoldRun, ...]

    def write(self, folder: Path) -> None:
        """Write ``folds.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> MergedFrom:
        """Read ``folds.json``.

        Raises:
            RunError: if it is missing or damaged.
        """
        path = folder / FILE_NAME
        return read_record(
            path,
            cls,
            missing=f"{path}: expected the runs that were merged, found no file.",
            remedy="Merge the runs of the folds again.",
        )
