"""A run in shards: each makes some batches on a machine of its own; the merge puts them together and scores them.

What comes out has the bytes of one run in one folder, but for ``cost.json``. Source: docs/cluster.md.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from prbench.engine import Engine, InProcess
from prbench.engine.shards import FILE_NAME, Shard, ShardRecord, begin_shard, require_settings
from prbench.errors import ShardError
from prbench.files.bounded import copy_file
from prbench.files.storage import atomic_path, remove_half_written, remove_leftovers, require_replaceable, sole_writer
from prbench.harness import preparation, results, run, run_folder
from prbench.harness.request import ProgressCallback, RunRequest, silent
from prbench.object_stores.inputs import fetched
from prbench.object_stores.store import is_url
from prbench.protocol.own_protocol import write_protocol


@dataclass(frozen=True)
class RunShardReport:
    """The result of one shard of a run.

    Attributes:
        record: Record of the whole run.
        planned: Batches of all shards.
        batches_found: Batches that an earlier call has left.
    """

    folder: Path
    shard: Shard
    record: run_folder.RunRecord
    planned: int
    batches_made: int
    batches_found: int


def run_shard(
    request: RunRequest,
    shard: Shard,
    *,
    tables_at: Sequence[str] = (),
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> RunShardReport:
    """Make the batches of one shard of a run, for :func:`merge_run_shards`; goes on where it was interrupted.

    Args:
        request: The whole run, apart from its folder, which is that of the shard.
        shard: Which one it is.
        tables_at: Paths or URLs at which the merge finds the tables; by default their folders on this machine.
        engine: See :func:`prbench.harness.run.run_method`, whose errors these are.
        progress: See :func:`prbench.harness.run.run_method`.

    Raises:
        ShardError: if the folder holds another shard.
    """
    engine = engine or InProcess()
    with contextlib.ExitStack() as held:
        with run.tidied(request):
            prepared = preparation.prepare_run(request)
            named = _named_batches(prepared)
            out = prepared.out
            if request.out is None:  # beside the folder of the whole run
                out = out.with_name(f"{out.name}-shard-{shard.number}-of-{shard.count}")
            held.enter_context(sole_writer(out))
            # The whole tables of a fold, which the merge makes again: the fold itself lies in this machine's cache.
            whole = list(tables_at) or [str(folder.absolute()) for folder in request.data]
            about = {"settings": prepared.record.written, "plan": tuple(named)}
            places = {"data": whole, "fold": request.fold}
            record = ShardRecord(kind="run", number=shard.number, count=shard.count, places=places, **about)
            # Make the folder of the shard, or go on in it.
            remove_leftovers(out / FILE_NAME)
            require_replaceable(out, FILE_NAME, kind="shard")
            begin_shard(out, record)
            remove_half_written(out)
            protocol = prepared.benchmark.copied_rules(prepared.rules)
            if protocol is not None:
                write_protocol(out, protocol)
            folder = run_folder.RunFolder(out, prepared.record)
            mine = [named[name] for name in _batches_of(record)]
            parts = []
            for one in prepared.datasets:
                chosen = frozenset(index for dataset, index in mine if dataset == one.name)
                parts.append(run.RunPart(prepared, one, folder.dataset(one.name), engine, progress, chosen))
            try:
                made = run.generate_all(parts, folder, engine)
            except Exception:
                # Remove what is left of a shard whose first batch has failed.
                left = {path.name for path in out.iterdir()} if out.is_dir() else {FILE_NAME, "more"}
                if left == {FILE_NAME}:
                    (out / FILE_NAME).unlink()
                    out.rmdir()
                raise
        for part in parts:
            if part.chosen:
                part.write_notice()
    return RunShardReport(out, shard, prepared.record, len(named), made, len(mine) - made)


def merge_run_shards(
    shards: Sequence[tuple[Path, ShardRecord]],
    out: Path,
    *,
    data: Sequence[Path] = (),
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> run.RunReport:
    """Put the batches of all shards into one run folder, and score them; goes on where it was interrupted.

    The method is not needed.

    Args:
        shards: All of them (:func:`prbench.engine.shards.require_whole`).
        out: The run folder.
        data: The tables of the run; by default where the shards found them.
        engine: Processes or cluster that scores.
        progress: Called after every scored window.

    Raises:
        ShardError: if a shard is unfinished or damaged, or the tables are other ones.
        RunError: if ``out`` belongs to another run.
        StorageError: if ``out`` cannot be written, or another process writes there.
        TableError: if a table is missing or changed.
    """
    folder, shard = shards[0]
    record = shard.setting(folder, run_folder.RunRecord)
    data = tuple(data) or tuple(fetched(at) if is_url(at) else Path(at) for at in shard.places.get("data", ()))
    request = results.request_of(record, data, folder=folder, fold=shard.places.get("fold"), out=out)
    prepared = preparation.prepare_run(request, earlier=record)
    remedy = "Name the tables of the shards with --data, and merge in the environment that made them."
    require_settings(folder, shard, prepared.record.written, remedy=remedy)
    # Every batch is found in its shard before the first is copied.
    found = {batch: place for place in shards for batch in _batches_of(place[1])}
    for name, (dataset, index) in _named_batches(prepared).items():
        folder, shard = found[name]
        part = run_folder.RunFolder(folder, prepared.record).dataset(dataset).part(index)
        if not part.is_file():
            problem = f"expected {part.name} of {dataset}, found no file."
            advice = f"Run its command (--shard {shard.shard}) again."
            raise ShardError(f"{folder}: shard {shard.shard} is not finished: {problem} {advice}")
    with sole_writer(prepared.out):
        merged = run.prepared_folder(prepared)
        parts = [
            run.RunPart(prepared, one, merged.dataset(one.name), engine or InProcess(), progress)
            for one in prepared.datasets
        ]
        missing = [(part, index) for part in parts for index in part.missing()]
        for part, index in missing:
            folder, shard = found[f"{part.dataset.name} batch {index}"]
            files = run_folder.RunFolder(folder, part.prepared.record).dataset(part.dataset.name)
            if not part.has(index, files):
                told = f"expected a whole batch of shard {shard.shard}, found a damaged file or other sequences"
                why = f"Copy the shard again, or delete the file; then: Run its command (--shard {shard.shard}) again."
                raise ShardError(f"{files.part(index)}: {told}. {why}")
            # The measurement first, so that a batch is never without it.
            for place in (run_folder.DatasetFolder.batch_cost, run_folder.DatasetFolder.part):
                if place(files, index).is_file():
                    with atomic_path(place(part.files, index)) as temporary:
                        copy_file(place(files, index), temporary)
        summaries = run.scored_parts(parts)
    return run.RunReport(merged, summaries, batches_made=len(missing), batches_found=len(found) - len(missing))


def _named_batches(prepared: preparation.PreparedRun) -> dict[str, tuple[str, int]]:
    """Name the batches of all datasets, in order: dataset and number of each."""
    return {
        f"{dataset.name} batch {index}": (dataset.name, index)
        for dataset in prepared.datasets
        for index in range(len(dataset.work.plan))
    }


def _batches_of(record: ShardRecord) -> list[str]:
    return [record.plan[place] for place in record.shard.places(len(record.plan))]
