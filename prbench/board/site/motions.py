"""Motions of a site: one classic script a motion, read when somebody looks at it; what a licence keeps stays out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import msgspec

from prbench.board.site.numbers import SiteRow, failures_of
from prbench.errors import PredictionsError, RunError
from prbench.harness.run_folder.record import CONTROL
from prbench.sequences.dataset_info import may_pass_on
from prbench.sequences.table import SequenceTable, by_share
from prbench.shown import clean
from prbench.viewing.player.document import Score, player_sequence, scores_of
from prbench.viewing.replay.read import RunMotions, scene_of
from prbench.viewing.replay.scene import METHOD_COLOURS, ShownMotion


class ShownSequence(msgspec.Struct, frozen=True, kw_only=True):
    """A sequence whose motions can be looked at.

    Attributes:
        file: Name of its scripts, without suffix: ``FILE.js`` holds what is known of the sequence, ``FILE-RUN.js`` the
            motion of a run.
        sequence_id: Its id.
        title: Action, object, hand and split in words.
        prime: Recorded prime, seconds after the first frame.
        event: Event, seconds after the first frame.
        runs: Maps the runs whose motions are there to their scores.
    """

    file: str
    sequence_id: str
    title: str
    prime: float
    event: float
    runs: dict[str, list[Score]]


def script(key: str, value: object) -> bytes:
    """Return a classic script that hands a value to the page that asked for it; no text in it ends a script."""
    return b"prbench.arrived(" + json(key) + b"," + json(value) + b");\n"


def json(value: object) -> bytes:
    """Return JSON that may stand in a script element; characters that steer or hide text are spelt out."""
    return msgspec.json.encode(_cleaned(msgspec.to_builtins(value))).replace(b"<", b"\\u003c")


def _cleaned(value: object) -> object:
    if isinstance(value, dict):
        return {clean(key): _cleaned(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_cleaned(each) for each in value]
    return clean(value) if isinstance(value, str) else value


def write_motions(
    folder: Path, table: SequenceTable, rows: Mapping[str, SiteRow], most: int | None, permitted: Collection[str]
) -> tuple[list[ShownSequence], list[str]]:
    """Write motions of one table: of the same sequences of every run, and of the worst failures of each.

    Args:
        folder: Folder of the table's scripts; a list of them is written beside it.
        table: The table.
        rows: The runs on it, by the key of each run.
        most: Number of sequences of either kind; None for all.
        permitted: Datasets that the user has permission to publish.

    Returns:
        What was written, and sentences on what was left out.
    """
    recordings = table.scalars(columns=["sequence_id", "recording_id"]).to_pydict()
    recording_of = dict(zip(recordings["sequence_id"], recordings["recording_id"], strict=True))
    known = sorted(recording_of.keys() & {name for row in rows.values() for name in row.worst})
    shared = by_share(known, [recording_of[name] for name in known])[:most]
    wanted = {name: set(rows) for name in shared}
    for key, row in rows.items():
        for failure in failures_of(row)[:most]:
            wanted.setdefault(failure["sequence_id"], set()).add(key)
    shown = may_pass_on(table.info, permitted, published=True)
    left_out = []
    if not shown:
        told = f"{table.info.title} ({table.info.dataset}): recorded motion, gaze and goals are left out, and the"
        told += f" motions of controls, which are made of them: its licence ({table.info.redistribution}) asks for"
        left_out.append(f"{told} permission (--permission {table.info.dataset}).")
    opened = {}
    for key, row in rows.items():
        scored = row.entry.sequences
        copies = row.entry.record.method.kind == CONTROL or row.entry.summary.recorded_motions > 0
        if scored is not None and (shown or not copies):
            try:
                opened[key] = RunMotions.open(scored.run, table.info.dataset, label=key)
            except (RunError, PredictionsError) as error:
                left_out.append(f"Motions of {key} on {table.info.dataset}: {error}")
    scores = {key: run.scores(list(wanted)) for key, run in opened.items()}
    # Without the right to show it, nothing recorded is read into the scene.
    info = table.info if shown else msgspec.structs.replace(table.info, redistribution="none")
    constants = next((run.run.protocol.metrics for run in opened.values() if run.run.protocol), None)
    folder.mkdir()
    found = []
    for number, chunk in enumerate(table.chunks(ids=frozenset(wanted), rows=1)):
        name = chunk.sequence_ids[0]
        motions = []
        for key in sorted(wanted[name] & opened.keys()):
            run = opened[key]
            if name in run:
                joints = run.joints(name, int(chunk.n_frames[0]))
                motions.append(ShownMotion(key, METHOD_COLOURS[0], joints, scores[key][name], run.gaze(name), run.kind))
        scene = scene_of(chunk, info, motions, permitted=permitted, constants=constants)
        document = player_sequence(scene)
        own = [motion for motion in document.motions if motion.kind == "recorded"]
        file = f"{folder.name}/{number}"
        of_sequence = msgspec.structs.replace(document, motions=own)
        (folder / f"{number}.js").write_bytes(script(file, of_sequence))
        for motion in document.motions[len(own) :]:
            (folder / f"{number}-{motion.label}.js").write_bytes(script(f"{file}-{motion.label}", motion))
        scored = {motion.label: scores_of(scene, motion) for motion in motions}
        moments = {"prime": document.prime_time, "event": document.event_time}
        found.append(ShownSequence(file=file, sequence_id=name, title=document.title, **moments, runs=scored))
    folder.with_name(f"{folder.name}.js").write_bytes(script(folder.name, found))
    return found, left_out
