"""What a run says about itself, held against its table, its stored questions and the installed methods.

A run folder is a user's: whoever edits ``run.json`` can put any method's name there. What table, motions and installed
methods contradict is refused. What they cannot show is called *declared* wherever runs are shown.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import prbench
from prbench.errors import AdapterError, PrbenchError, RunError
from prbench.harness.benchmark import Benchmark, Cases, CaseTable, CaseWork, load_benchmark
from prbench.harness.methods.installed import METHOD_CONTROLS
from prbench.harness.methods.loading import load_adapter, weights_digest
from prbench.harness.methods.motions import Declared
from prbench.harness.preparation import table_record
from prbench.harness.run_folder.folder import DatasetFolder, RunFolder
from prbench.harness.run_folder.predictions import QUESTION, Predictions, open_part
from prbench.harness.run_folder.record import BUILT_IN, CONTROL, FILE, FILE_NAME, RunRecord, TableRecord
from prbench.harness.run_folder.scores import GAZE_COLUMNS, CodedScores
from prbench.shown import clean, quoted

# What neither table, motions nor installed methods can show; of a control its motions show all but the effort.
METHOD = "method"
_EFFORT = ("device", "packages", "cost")
DECLARED = (METHOD, "kind", "weights", "training", "options", "isolation", "condition", "control", "seed", *_EFFORT)
_MOVED = 1e-4  # metres by which other processors may make a control's motion otherwise
_DRIFTED = 1e-2  # metres by which other values of the same recordings may


def origin_of(record: RunRecord) -> str:
    """Return the origin of a run's method in words; a record that claims one for prbench without right is not believed.

    The version of prbench is named where it is another one, whose methods are not here to be compared.
    """
    method = record.method
    ours = {BUILT_IN: load_benchmark(record.benchmark).about.methods, CONTROL: METHOD_CONTROLS}.get(method.kind)
    if ours is None or (method.name in ours and method.version == prbench.__version__):
        return method.origin
    return f"{method.origin}, prbench {clean(method.version)}" if method.name in ours else "unknown kind"


def require_own_method(run: RunFolder, table: CaseTable | None) -> None:
    """Hold a run that calls its method one of prbench's own against the installed method and its bundled weights.

    Another version's methods are not here: boards name that version.

    Args:
        run: The run.
        table: Its table, which has to be one of its benchmark; None where it is not at hand.

    Raises:
        RunError: naming the key that differs.
    """
    record = run.record
    method = record.method
    benchmark = load_benchmark(record.benchmark)
    fits = table is None or (table.folder / benchmark.table_file).is_file()
    _require(run, "benchmark", fits, "the benchmark of its table", record.benchmark)
    names = {BUILT_IN: benchmark.about.methods, CONTROL: METHOD_CONTROLS}.get(method.kind)
    if names is None or method.version != prbench.__version__:
        return
    _require(run, "method.name", method.name in names, f"one of prbench's own, {', '.join(names)}", method.name)
    if method.kind == CONTROL:
        return
    # The options of a user's file may name other files, so they are not handed on.
    load = partial(load_adapter, method.name, options={}, device="cpu", group=benchmark.methods)
    try:
        adapter = load(None)
    except AdapterError:
        return  # not installed with all that it needs
    taken = sorted(condition.value for condition in adapter.conditions)
    _require(run, "condition", record.condition in taken, f"one that {method.name} takes, {taken}", record.condition)
    condition = benchmark.condition(record.condition)
    default = adapter.weights_for(condition) if hasattr(adapter, "weights_for") else None
    keys = ["motionless", "gaze", "one_design"]
    if default is not None:
        _require(run, "method.weights", bool(method.weights and method.weights_digest), default.name, method.weights)
        # A name that differs in case or suffix alone reads as the bundled one.
        named = Path(method.weights or "").stem.casefold()
        for path in (path for path in default.parent.glob("*.safetensors") if path.stem.casefold() == named):
            digest = weights_digest(path)
            found = method.weights_digest
            _require(run, "method.weights_digest", found == digest, f"{digest}, as the bundled {path.name}", found)
            keys += ["max_frames", "native_fps"]
            try:
                adapter = adapter if path == default else load(path)
                adapter.weights_for(condition)
            except PrbenchError as error:
                expected = f"weights for '{record.condition}', such as {default.name}"
                _require(run, "method.weights", False, expected, f"{path.name} ({error})")
    declared = Declared.by(adapter, origin=method.name, conditions=benchmark.methods.conditions)
    for key in keys:
        expected = getattr(declared, key)
        found = getattr(method, key)
        _require(run, f"method.{key}", found == expected, f"{expected}, as {method.name} has it", found)


def require_table(
    run: RunFolder, stated: TableRecord, chosen: Cases, cases: Cases, work: CaseWork, rules: Any, *, exact: bool = True
) -> None:
    """Hold what a run says of its table against the table.

    Args:
        run: The run.
        stated: What it says.
        chosen: The cases of split and limit, chosen anew.
        cases: Those of them that the method can answer.
        work: The work on them.
        rules: The protocol that it follows.
        exact: The table holds the values that the run was made on, not only its sequences.

    Raises:
        RunError: naming the key that differs.
    """
    version = run.record.protocol_version
    _require(run, "protocol_version", version == rules.version, rules.version, version)
    wanted = run.record.sequences
    _require(run, "sequences", not wanted or set(chosen.sequence_ids) <= set(wanted), "those that were run", wanted)
    plan = stated.batch_plan
    made = msgspec.to_builtins(table_record(chosen, cases, work.plan if plan.batches else (), plan.batch_size))
    found = msgspec.to_builtins(stated)
    # Folds of two counts may test on the same people, and are one table then.
    other = {"fold"} if exact else {"fold", "content_digest", "whole_table"}
    made |= {key: found[key] for key in made.keys() & found.keys() & other}
    for key in made | found:
        same = made.get(key) == found.get(key)
        _require(run, f"tables.{stated.dataset}.{key}", same, f"{made.get(key)}, as the table says", found.get(key))


def require_questions(
    run: RunFolder, files: DatasetFolder, cases: Cases, work: CaseWork, *, exact: bool = True
) -> tuple[str, ...]:
    """Hold condition, control and seed against the questions whose digests stand beside the motions.

    Motions of this version's controls are made again.

    Args:
        run: The run.
        files: The files of one dataset, with motions.
        cases: The cases that were answered.
        work: The work on them.
        exact: The table holds the values that the run was made on; digests of other values say nothing.

    Returns:
        What remains declared.

    Raises:
        RunError: naming the key that differs.
    """
    method = run.record.method
    if method.kind == FILE:
        return DECLARED  # prbench asked nobody
    made_again = method.kind == CONTROL and method.version == prbench.__version__
    files.require_no_other_parts(len(work.plan))
    for index, question in work.questions(frozenset(range(len(work.plan)))):
        part = files.part(index)
        schema = open_part(part).schema_arrow
        gaze = GAZE_COLUMNS[0] in schema.names
        _require(run, "method.gaze", method.gaze == gaze, f"{gaze}, as the motions say", method.gaze)
        stored = (schema.metadata or {}).get(QUESTION.encode(), b"").decode()
        if not stored:
            return DECLARED  # of an earlier version
        expected = f"those of the question that {part.name} in {files.predictions} answers"
        found = f"{run.record.condition}, {run.record.control}, {run.record.seed}"
        same = stored == question.digest or not exact
        _require(run, "condition, control, seed", same, expected, found)
        if not made_again:
            continue
        ids = tuple(cases.sequence_ids[row] for row in work.plan[index])
        predictions = Predictions.open(part)
        for sample, made in enumerate(question.ask(None, seed=run.record.seed, sequence_ids=ids).samples):
            moved = float(np.abs(predictions.motions(ids, sample).values - made.values).max())
            most = _MOVED if exact else _DRIFTED
            _require(run, "method.name", moved < most, f"{method.name}'s motions", f"others, {moved:.3g} m off")
    return _EFFORT if made_again and exact else DECLARED


def require_still(run: RunFolder, scores: CodedScores, benchmark: Benchmark) -> None:
    """Refuse motions that move but are said to stand still, so that their Foot Skating would not be shown.

    Raises:
        RunError: naming the key.
    """
    for info in benchmark.metrics if run.record.method.motionless else ():
        if info.irrelevant_if_motionless and info.id in scores.metrics:
            largest = float(np.abs(scores.value[scores.rows_of(info.id)]).max(initial=0.0))
            _require(run, "method.motionless", largest < _MOVED, f"false for a {info.title} of {largest:.3g}", True)


_EDITED = "The run's files were edited, or put together from several runs: run the method again into another folder."


def _require(run: RunFolder, key: str, holds: bool, expected: object, found: object) -> None:
    """Refuse a record of which one key is contradicted."""
    if not holds:
        raise RunError(f"{run.path / FILE_NAME}, {key}: expected {quoted(expected)}, found {quoted(found)}. {_EDITED}")
