"""Names and states of the files of a run, how a folder is opened for a run or refused, and a merge's ``folds.json``."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import pyarrow as pa

from prbench.engine import shards
from prbench.errors import InputFileError, RunError
from prbench.files import arrays, bounded, storage
from prbench.harness.run_folder import record, summary
from prbench.harness.run_folder.record import RunRecord, read_record
from prbench.protocol.manifests import BenchmarkProtocol, default_benchmark
from prbench.protocol.own_protocol import FILE_NAME as PROTOCOL_FILE
from prbench.protocol.own_protocol import protocol_beside, write_protocol
from prbench.sequences.dataset_info import NOTICE_FILE
from prbench.shown import quoted

# A dataset's folder holds one of these as soon as it holds anything.
_FIRST_FILES = ("predictions", ".costs", "scores.parquet", summary.FILE_NAME)


@dataclass(frozen=True)
class DatasetFolder:
    """The files of one dataset's part of a run: ``<run>/<dataset>``."""

    path: Path

    @property
    def predictions(self) -> Path:
        """Folder of the parts, one a planned batch."""
        return self.path / "predictions"

    @property
    def scores(self) -> Path:
        """Long form."""
        return self.path / "scores.parquet"

    @property
    def cost(self) -> Path:
        """Seconds and memory."""
        return self.path / "cost.json"

    @property
    def agreement(self) -> Path:
        """Agreement with recorded people, and rates by the goal's place; absent in runs of earlier versions."""
        return self.path / summary.AGREEMENT_FILE

    @property
    def notice(self) -> Path:
        """Notice that the dataset's terms ask for; absent where they ask for none."""
        return self.path / NOTICE_FILE

    @property
    def finished(self) -> bool:
        """Everything is there, and the scores are whole at their end; the summary is written last."""
        # Reading a pipe in place of a file would never end.
        if not all(path.is_file() for path in (self.cost, self.path / summary.FILE_NAME, self.scores)):
            return False
        try:
            arrays.open_parquet(self.scores).close()
        except (pa.ArrowInvalid, OSError, InputFileError):
            return False
        return True

    def part(self, batch: int) -> Path:
        """Predictions of one batch."""
        return self.predictions / f"part-{batch:05d}.parquet"

    def batch_cost(self, batch: int) -> Path:
        """Measurement of one batch, until the run is finished."""
        return self.path / ".costs" / f"batch-{batch:05d}.json"

    def batch_costs(self) -> list[Path]:
        """All measurements, in order."""
        return sorted((self.path / ".costs").glob("batch-*.json"))

    def has_part(self, batch: int, sequence_ids: Iterable[str], samples: int) -> bool:
        """Return True if a batch is there, whole, with exactly these sequences; every checksum is verified."""
        try:
            rows = arrays.read_parquet(self.part(batch), verify=True)
        except (FileNotFoundError, pa.ArrowInvalid, OSError, InputFileError):
            return False
        if not {"sequence_id", "sample"} <= set(rows.column_names):
            return False
        # A part of another plan could have the same name, so the ids themselves are compared.
        ids = list(sequence_ids)
        expected = [(name, sample) for sample in range(samples) for name in ids]
        return list(zip(rows["sequence_id"].to_pylist(), rows["sample"].to_pylist())) == expected

    def require_no_other_parts(self, batches: int) -> None:
        """Refuse files among the predictions that are no part of the plan; they would be scored too.

        Raises:
            RunError: naming the first one.
        """
        planned = {self.part(batch) for batch in range(batches)}
        unplanned = sorted(path for path in self.predictions.glob("*.parquet") if path not in planned)
        unplanned = [path for path in unplanned if not path.name.startswith(".")]
        if unplanned:
            problem = f"expected the {batches} parts of this run only, found another file. Move it elsewhere."
            raise RunError(f"{unplanned[0]}: {problem}")

    def forget_batch_costs(self) -> None:
        """Remove the measurements of single batches."""
        shutil.rmtree(self.path / ".costs", ignore_errors=True)


@dataclass(frozen=True)
class RunFolder:
    """A run on disk."""

    path: Path
    record: RunRecord

    @classmethod
    def prepare(cls, path: Path, wanted: RunRecord, protocol: BenchmarkProtocol | None = None) -> RunFolder:
        """Make the folder, or go on in one that belongs to the very same run.

        Args:
            path: The folder.
            wanted: Everything that decides the run.
            protocol: Rules by which it is scored; a copy of a user's own ones lies in the folder.

        Raises:
            RunError: if the folder belongs to other inputs; names the key that differs.
            StorageError: if it holds something else, or cannot be written.
        """
        path = run_folder_of(path)
        storage.remove_leftovers(path / record.FILE_NAME)  # of a process that was killed before the file stood there
        storage.require_replaceable(path, record.FILE_NAME, kind="run folder")
        if (path / record.FILE_NAME).is_file():
            wanted.require_same(RunRecord.read(path), path)
            storage.remove_half_written(path)
        else:
            wanted.write(path)
        if protocol is not None:
            write_protocol(path, protocol)
        return cls(path, wanted)

    @classmethod
    @bounded.foreign_input()
    def open(cls, path: Path | str, *, any_benchmark: bool = False) -> RunFolder:
        """Open a run for reading.

        Args:
            path: The folder, or the folder in it of one of the run's datasets.
            any_benchmark: The caller works on runs of every benchmark; without it, those of the default one alone.

        Raises:
            RunError: if the folder holds no run, or one of a benchmark that the caller does not know.
        """
        path = run_folder_of(Path(path))
        if (path / shards.FILE_NAME).is_file():
            raise RunError(f"{path}: is a shard of a run; `prbench merge` puts all of them together.")
        record = RunRecord.read(path)
        if not any_benchmark and record.benchmark != default_benchmark().name:
            problem = f"which this command does not know; it works on runs of {default_benchmark().name}"
            remedy = "`prbench run` and `prbench leaderboard` know both."
            raise RunError(f"{path}: is a run of the benchmark {quoted(record.benchmark)}, {problem}. {remedy}")
        return cls(path, record)

    @property
    def protocol(self) -> BenchmarkProtocol | None:
        """The rules by which it was scored; None for prbench's own of another version.

        Raises:
            RunError: if the copy in the folder is not the protocol that ``run.json`` records.
            InputFileError: if the copy is no protocol.
        """
        return protocol_beside(self.path, digest=self.record.protocol_digest, wrong=RunError)

    def dataset(self, name: str) -> DatasetFolder:
        """Return the part of one dataset.

        Raises:
            RunError: if the run did not include it.
            InputFileError: if its name leads out of the run folder.
        """
        known = [table.dataset for table in self.record.tables]
        if name not in known:
            raise RunError(f"{self.path}: the run is of {', '.join(known)}, not of {name}.")
        storage.inside(self.path, name)
        own = self.path / name
        # Up to 0.10 the files of a run's only dataset lay beside run.json. Such a run is read and resumed as it lies.
        if len(known) == 1 and not own.is_dir() and any((self.path / file).exists() for file in _FIRST_FILES):
            return DatasetFolder(self.path)
        return DatasetFolder(own)

    @property
    def files(self) -> list[Path]:
        """All files of a finished run on which a board depends, as far as they are there."""
        files = [self.path / name for name in (record.FILE_NAME, PROTOCOL_FILE, FOLDS_FILE)]
        for table in self.record.tables:
            own = self.dataset(table.dataset)
            files += [own.path / summary.FILE_NAME, own.scores, own.cost, own.agreement]
            files += sorted(own.predictions.glob("*.parquet"))
        return [path for path in files if path.is_file()]

    def discard_if_empty(self) -> None:
        """Remove the folder if not a single batch was finished, so that a failed first step leaves nothing behind."""
        folders = [self.dataset(table.dataset) for table in self.record.tables]
        if any(any(folder.predictions.glob("part-*.parquet")) for folder in folders):
            return
        for folder in folders:
            folder.forget_batch_costs()
            for left in (folder.predictions, folder.path):
                if left != self.path and left.is_dir() and not any(left.iterdir()):
                    left.rmdir()
        (self.path / PROTOCOL_FILE).unlink(missing_ok=True)
        (self.path / record.FILE_NAME).unlink(missing_ok=True)
        if self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()


def run_folder_of(path: Path) -> Path:
    """Return the run folder that a path means: it itself, the merged run in it, or the parent of a dataset's folder.

    Raises:
        RunError: if the parent's ``run.json`` is damaged.
    """
    parent = path.parent if path.name else path.absolute().parent
    if not (path / record.FILE_NAME).is_file() and (path / MERGED / FOLDS_FILE).is_file():
        return path / MERGED  # of a run on all folds
    if (path / record.FILE_NAME).is_file() or not (parent / record.FILE_NAME).is_file():
        return path
    datasets = [table.dataset for table in RunRecord.read(parent).tables]
    return parent if path.absolute().name in datasets else path


FOLDS_FILE = "folds.json"
# Merged run in the folder of a run on all folds.
MERGED = "merged"


class FoldRun(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The run on one fold.

    Attributes:
        fold: Such as ``2/6``.
        run: Name of its folder, for people.
        record_sha256: Digest of its ``run.json``.
        scores_sha256: Digest of its ``scores.parquet``.
    """

    fold: str
    run: str
    record_sha256: str
    scores_sha256: str

    @classmethod
    def of(cls, run: RunFolder) -> FoldRun:
        """Describe a finished run on one dataset."""
        table = run.record.tables[0]
        made = storage.file_digest(run.path / record.FILE_NAME)
        scores = storage.file_digest(run.dataset(table.dataset).scores)
        return cls(fold=table.fold or "", run=run.path.resolve().name, record_sha256=made, scores_sha256=scores)

    @property
    def key(self) -> tuple[str, str]:
        """Both digests, by which the run is found again."""
        return self.record_sha256, self.scores_sha256


@bounded.foreign_input()
def read_folds(folder: Path) -> tuple[FoldRun, ...]:
    """Read ``folds.json``.

    Raises:
        RunError: if it is missing or damaged.
    """
    path = folder / FOLDS_FILE
    kind = dict[Literal["folds"], tuple[FoldRun, ...]]
    missing = f"{path}: expected the runs that were merged, found no file."
    return read_record(path, kind, missing=missing, remedy="Merge the runs of the folds again.").get("folds", ())
