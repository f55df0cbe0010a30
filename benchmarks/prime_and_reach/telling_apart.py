"""``prbench analyse pairs`` and ``tell-apart``: can people, or a small classifier, tell a method from recorded people?

Source: docs/specification/metrics.md#telling-apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

from prbench.errors import UsageError
from prbench.harness.first_run import tables_of_runs
from prbench.harness.run_folder import RunFolder
from prbench.sequences.dataset_info import require_may_pass_on
from prbench.viewing.pairs import PairsKey, write_pairs
from prbench.viewing.replay.scene import RECORDED
from prbench.viewing.view import ViewRequest, scenes_of

QUESTION = "Which of the two is the recorded motion?"


def write_pairs_of_run(
    run: Path, data: Sequence[Path], out: Path, *, pairs: int, seed: int = 0, permitted: Collection[str] = ()
) -> PairsKey:
    """Write a page on which people tell the motions of a run from recorded ones, and its key.

    Args:
        run: Finished run folder of a method.
        data: Tables of the run; the embedded ones are known.
        out: Folder that gets ``pairs.html`` and ``key.json``.
        pairs: Most pairs; each table has an equal share, as far as it goes.
        seed: Decides which pairs there are, their order and sides.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        UsageError: if the run's motions are recorded ones, or were given other sequences' goals.
        RedistributionError: if a table's recorded motion must not be passed on.
        StorageError: if a file cannot be written.
    """
    opened = require_generated(run)
    tables = tables_of_runs([opened], data)
    for table in tables:
        require_may_pass_on(table.info, "the page", permitted)
    each = -(-pairs // len(tables))
    scenes = scenes_of(ViewRequest(runs=(run,), data=tuple(data), limit=each, permitted=permitted))
    # What is too much is left out evenly: of every table the last ones.
    turns: Counter[str] = Counter()
    ranked = []
    for scene in scenes:
        ranked.append((turns[scene.dataset], scene.dataset, scene))
        turns[scene.dataset] += 1
    chosen = [scene for _, _, scene in sorted(ranked, key=lambda turn: turn[:2])]
    return write_pairs(chosen[:pairs], out, question=QUESTION, right=RECORDED, seed=seed)


def require_generated(run: Path) -> RunFolder:
    """Open a run whose motions a method made for the goals of their sequences.

    Raises:
        UsageError: for a control.
    """
    opened = RunFolder.open(run)
    if opened.record.method.kind == "control" or opened.record.control is not None:
        raise UsageError(
            f"{run}: its motions are a control's, not a method's for these goals. Name the run of a method."
        )
    return opened
