"""Motions of a site: one classic script a motion, read when somebody looks at it; what a licence keeps stays out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import msgspec

from prbench.board.collect import LeaderboardRow
from prbench.errors import PredictionsError, RunError
from prbench.harness.run_folder.record import CONTROL
from prbench.sequences.dataset_info import may_pass_on
from prbench.sequences.table import SequenceTable, by_share
from prbench.shown import clean
from prbench.viewing.player.document import Score, player_sequence, scores_of
from prbench.viewing.replay.read import RunMotions, scene_of
from prbench.viewing.replay.scene import METHOD_COLOURS, ShownMotion

FOLDER = "motions"


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


def chosen_sequences(
    table: SequenceTable, ids: Collection[str], worst: Mapping[str, Sequence[str]], most: int | None
) -> dict[str, set[str]]:
    """Choose the sequences of a table that are shown: the same ones of all runs, and the worst failures of each.

    Args:
        table: The table.
        ids: Ids of the scored sequences.
        worst: Failures of each run by its key, the worst first.
        most: Number of either kind; None for all sequences of every run.

    Returns:
        The keys of the runs whose motions are shown, by sequence.
    """
    recordings = table.scalars(columns=["sequence_id", "recording_id"]).to_pydict()
    recording_of = dict(zip(recordings["sequence_id"], recordings["recording_id"], strict=True))
    known = sorted(set(ids) & recording_of.keys())
    shared = by_share(known, [recording_of[name] for name in known])[:most]
    wanted = {name: set(worst) for name in shared}
    for run, names in worst.items():
        for name in names[:most]:
            wanted.setdefault(name, set()).add(run)
    return wanted


def write_motions(
    folder: Path,
    table: SequenceTable,
    entries: Mapping[str, LeaderboardRow],
    wanted: Mapping[str, Collection[str]],
    permitted: Collection[str],
) -> tuple[list[ShownSequence], list[str]]:
    """Write the motions of some sequences of one table.

    Args:
        folder: Folder of the table's scripts.
        table: The table.
        entries: Rows of the runs on it, by the key of each run.
        wanted: Keys of the runs whose motions are shown, by sequence.
        permitted: Datasets that the user has permission to publish.

    Returns:
        What was written, and sentences on what was left out.
    """
    shown = may_pass_on(table.info, permitted, published=True)
    left_out = []
    if not shown:
        left_out.append(
            f"{table.info.title} ({table.info.dataset}): recorded motion, gaze and goals are left out, and the motions"
            f" of controls, which are made of them: its licence ({table.info.redistribution}) asks for permission"
            f" (--permission {table.info.dataset})."
        )
    opened = {}
    for key, entry in entries.items():
        assert entry.sequences is not None
        copies = entry.record.method.kind == CONTROL or entry.summary.recorded_motions > 0
        try:
            if shown or not copies:
                opened[key] = RunMotions.open(entry.sequences.run, table.info.dataset, label=key)
        except (RunError, PredictionsError) as error:
            left_out.append(f"Motions of {entry.run} on {table.info.dataset}: {error}")
    scores = {key: run.scores(list(wanted)) for key, run in opened.items()}
    # Without the right to show it, nothing recorded is read into the scene.
    info = table.info if shown else msgspec.structs.replace(table.info, redistribution="none")
    found = []
    for number, chunk in enumerate(table.chunks(ids=frozenset(wanted), rows=1)):
        name = chunk.sequence_ids[0]
        motions = []
        for key in sorted(wanted[name] & opened.keys()):
            run = opened[key]
            if name in run:
                joints = run.joints(name, int(chunk.n_frames[0]))
                motions.append(ShownMotion(key, METHOD_COLOURS[0], joints, scores[key][name], run.gaze(name), run.kind))
        constants = next((run.run.protocol.metrics for run in opened.values() if run.run.protocol), None)
        scene = scene_of(chunk, info, motions, permitted=permitted, constants=constants)
        document = player_sequence(scene)
        own = [motion for motion in document.motions if motion.kind == "recorded"]
        file = f"{folder.name}/{number}"
        of_sequence = msgspec.structs.replace(document, motions=own)
        (folder / f"{number}.js").write_bytes(script(file, of_sequence))
        for motion in document.motions[len(own) :]:
            (folder / f"{number}-{motion.label}.js").write_bytes(script(f"{file}-{motion.label}", motion))
        one = ShownSequence(
            file=file,
            sequence_id=name,
            title=document.title,
            prime=document.prime_time,
            event=document.event_time,
            runs={motion.label: scores_of(scene, motion) for motion in motions},
        )
        found.append(one)
    return found, left_out
