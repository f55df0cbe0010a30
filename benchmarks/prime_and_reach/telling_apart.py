"""``prbench analyse causes``, ``pairs`` and ``tell-apart``: what tells the motions of methods from people's.

The limits of Plausible tell, people who look at pairs, and a small classifier.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import UsageError
from prbench.files.storage import text_digest
from prbench.geometry.skeleton import BONES, Joint
from prbench.harness.first_run import tables_of_runs
from prbench.harness.intervals import Estimate, clustered, mean_interval, rate_interval
from prbench.harness.prime_and_reach import has_given_pose
from prbench.harness.run_folder import CONTROL, RunFolder
from prbench.metrics import UNKNOWN_HAND, MotionBatch, ScoringTargets
from prbench.metrics.batch import ScoringPair
from prbench.metrics.plausible import body_numbers, broken_limits
from prbench.protocol.manifests import load_protocol
from prbench.sequences.dataset_info import require_may_pass_on
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench.viewing.pairs import BlindPair, PairsKey, Question, write_pairs
from prbench.viewing.replay.read import run_labels
from prbench.viewing.replay.scene import RECORDED
from prbench.viewing.view import ViewRequest, scenes_of
from prbench_benchmarks.prime_and_reach.diversity import Progress, beside_people

_FOLDS = 5
_RIDGE = 0.1  # added to the variances of standardised features
_SMALL = 0.01  # degrees, or per second and second squared: keeps logarithms of still bones finite
_STATISTICS = ("mean", "deviation", "speed", "acceleration")


def write_pairs_of_run(
    run: Path, data: Sequence[Path], out: Path, *, pairs: int = 60, seed: int = 0, permitted: Collection[str] = ()
) -> PairsKey:
    """Write a page on which people tell the motions of a run from recorded ones, and its key.

    Args:
        run: Finished run folder of a method.
        data: Tables of the run; the embedded ones are known.
        out: Folder that gets ``pairs.html`` and ``key.json``.
        pairs: Most pairs, of each table as many.
        seed: Decides their order and sides.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        UsageError: if the run's motions are recorded ones, or were given other sequences' goals.
        RedistributionError: if a table's recorded motion must not be passed on.
        StorageError: if a file cannot be written.
    """
    tables = tables_of_runs(_opened([run])[1], data)
    for table in tables:
        require_may_pass_on(table.info, "the page", permitted)
    limit = max(1, pairs // len(tables))
    scenes = scenes_of(ViewRequest(runs=(run,), data=tuple(data), limit=limit, permitted=permitted))
    asked = [Question(name="right", text="Which of the two is the recorded motion?")]
    return write_pairs([BlindPair.of(scene) for scene in scenes], out, questions=asked, counted=(RECORDED,), seed=seed)


def causes_tables(
    runs: Sequence[Path],
    data: Sequence[Path] = (),
    *,
    by: Literal["layout", "limit"] | None = None,
    progress: Progress = lambda *_: None,
) -> list[Table]:
    """Lay out how many motions of each run are plausible, and what the others break, by the limits of this version.

    Source: docs/specification/metrics.md#plausible.

    Args:
        runs: Run folders, a column each.
        data: Their tables; the embedded ones are known.
        by: None for a row a flag; ``layout`` for the same on each table; ``limit`` for a row a limit.
        progress: Called after each sequence.

    Returns:
        One table. Shares are in %; in brackets stands the share that breaks nothing else.

    Raises:
        UsageError: for a run of shuffled goals.
        RunError: if motions are missing, or a table is another one than the run's.
        TableError: if a table cannot be found.
    """
    constants = load_protocol().metrics
    limits = dict(constants.plausible)
    for name, limit in limits.items() if by == "limit" else ():
        flag = f"{name}, at {limit.bound} {limit.value:g} {limit.unit}".rstrip()
        limits[name] = msgspec.structs.replace(limit, flag=flag)
    # The recording of each sequence, and whether its motions break each limit; by layout and run.
    found: dict[str, dict[str, list[tuple[str, dict[str, np.ndarray]]]]] = {}
    notes = ["In brackets: motions that break nothing else, which mending this alone would free."]
    labels, opened = _opened(runs, controls=True)
    for label, run in zip(labels, opened, strict=True):
        pose_given = has_given_pose(run.record.method, run.record.condition)
        for table in tables_of_runs([run], data):
            notes += [ON_SYNTHETIC_DATA] if table.info.synthetic else []
            of_run = found.setdefault(table.info.dataset if by == "layout" else "", {}).setdefault(label, [])
            for _, recording, motions, _ in beside_people(run, table, progress):
                people, *generated = motions.joints
                one = np.ones(len(generated))
                goals = np.tile(motions.goal, (len(one), 1))
                about = (goals, one, np.full(len(one), UNKNOWN_HAND), one * motions.head_tilt_deg, motions.fps)
                predicted, recorded = (MotionBatch.from_motions(each) for each in (generated, [people] * len(one)))
                pair = ScoringPair(predicted, recorded, ScoringTargets(*about, pose_given=pose_given))
                broken = broken_limits(body_numbers(pair, constants), limits, constants.threshold_tolerance)
                of_run.append((f"{table.info.dataset}/{recording}", broken))
    blocks = []
    for layout, columns in found.items():
        rows: dict[str, tuple[dict[str, str], list[Cell]]] = {}
        for label, motions in columns.items():
            recordings = [recording for recording, _ in motions]
            masks = {cause: np.stack([broken[cause] for _, broken in motions]) for cause in motions[0][1]}
            count = np.sum(list(masks.values()), axis=0)
            for cause, mask in {"plausible": count == 0, **masks}.items():
                text, cells = rows.setdefault(cause, ({"cause": cause.replace("_", " ")}, []))
                kinds = {label: mask} | ({f"{label}, alone": mask & (count == 1)} if cause in masks else {})
                for metric, some in kinds.items():
                    share = rate_interval(clustered(some.mean(axis=1), recordings))
                    about = {"method": label, "variant": cause, "dataset": layout, "recordings": share.n_recordings}
                    cells.append(metric_cell(metric, "rate", share.mean, share.low, share.high, **about))
                if cause in masks:
                    text[label] = f"{cells[-2].value:.1f} ({cells[-1].value:.1f})"
        kept = [row for cause, row in rows.items() if cause == "plausible" or any(cell.value for cell in row[1])]
        blocks.append(Block(title=layout, rows=tuple(Row(text=text, cells=tuple(cells)) for text, cells in kept)))
    heads = [Column(key="cause", title="", text=True)]
    heads += [Column(key=label, title=label, unit="%", digits=1) for label in labels]
    title = "Motions that are plausible, and what the others break"
    return [Table(title=title, columns=tuple(heads), blocks=tuple(blocks), notes=tuple(dict.fromkeys(notes)))]


def _opened(runs: Sequence[Path], *, controls: bool = False) -> tuple[list[str], list[RunFolder]]:
    """Open runs of methods, and of controls where these will do, and name them.

    Raises:
        UsageError: for a run of shuffled goals, or a control.
    """
    opened = [RunFolder.open(path) for path in runs]
    for run in opened:
        if run.record.control is not None or (run.record.method.kind == CONTROL and not controls):
            raise UsageError(f"{run.path}: holds motions of a control. Name the run of a method for its own goals.")
    return run_labels(runs, [run.record for run in opened]), opened


def held_out_features(joints: Float[np.ndarray, "k frames 22 3"], fps: float) -> Float[np.ndarray, "k features"]:
    """Measure what no method was tuned on: how the tilt of each bone varies.

    Args:
        joints: k motions of three frames or more; canonical frame, metres, which are rounded to millimetres.
        fps: Frames per second.

    Returns:
        Mean, and logarithms of deviation, mean speed and mean acceleration, of the angle of each bone with the
        vertical; degrees and seconds.
    """
    ends = np.round(joints.astype(np.float64), 3)[:, :, np.array(BONES)]
    bones = ends[..., 1, :] - ends[..., 0, :]
    upright = bones[..., 1] / np.maximum(np.linalg.norm(bones, axis=-1), 1e-9)
    tilt = np.rad2deg(np.arccos(np.clip(upright, -1.0, 1.0)))
    speed = np.diff(tilt, axis=1) * fps
    varied = [tilt.std(axis=1), np.abs(speed).mean(axis=1), np.abs(np.diff(speed, axis=1)).mean(axis=1) * fps]
    return np.concatenate([tilt.mean(axis=1), *(np.log(each + _SMALL) for each in varied)], axis=1)


def tell_apart_table(
    runs: Sequence[Path], data: Sequence[Path] = (), *, progress: Progress = lambda *_: None
) -> list[Table]:
    """Measure how well a linear discriminant tells the first sample of each run from recorded people.

    It learns from four fifths of the recordings and judges the motions of the others.

    Args:
        runs: Run folders of methods.
        data: Their tables; the embedded ones are known.
        progress: Called after each sequence.

    Returns:
        A row a run: the area under the curve with its interval over recordings, that of every second
        recorded motion, recording after recording, against the others, and the features that tell most by themselves.

    Raises:
        UsageError: for a control, or fewer than ten recordings.
        RunError: if motions are missing, or a table is another one than the run's.
    """
    labels, opened = _opened(runs)
    names = [f"{kind} of {Joint(parent).name}-{Joint(child).name}" for kind in _STATISTICS for parent, child in BONES]
    rows = []
    notes = ["0.5 is chance. People: every second recorded motion, recording after recording, against the others."]
    for label, run in zip(labels, opened, strict=True):
        recordings: list[str] = []
        values = []
        for table in tables_of_runs([run], data):
            notes += [ON_SYNTHETIC_DATA] if table.info.synthetic else []
            for _, recording, motions, _ in beside_people(run, table, progress):
                recordings.append(f"{table.info.dataset}/{recording}")
                values.append(held_out_features(motions.joints[:2], motions.fps))
        units = sorted(set(recordings), key=text_digest)
        if len(units) < 2 * _FOLDS:
            raise UsageError(f"{run.path}: expected {2 * _FOLDS} recordings or more to learn from, found {len(units)}.")
        place = np.array([units.index(name) for name in recordings])
        every_other = np.zeros(len(place), dtype=bool)
        every_other[np.argsort(place, kind="stable")[1::2]] = True  # recording after recording
        both = np.stack(values)
        alone = [abs(_above(each[:, 1], each[:, 0]).mean() - 0.5) for each in np.moveaxis(both, 2, 0)]
        telling = "; ".join(names[number].lower() for number in np.argsort(alone)[:-4:-1])
        everybody = (both.reshape(-1, len(names)), np.tile([False, True], len(both)), np.repeat(place, 2))
        cells = []
        for metric, told in (("area", everybody), ("people", (both[:, 0], every_other, place))):
            area = _area(*told)
            about: dict[str, Any] = {"low": area.low, "high": area.high, "recordings": area.n_recordings}
            cells.append(Cell(metric=metric, value=area.mean, method=label, sequences=len(both), **about))
        rows.append(Row(text={"method": label, "telling": telling}, cells=tuple(cells)))
    heads = {"method": "method", "area": "area", "people": "people", "telling": "what tells most"}
    columns = tuple(Column(key=key, title=title, digits=3, text=key in rows[0].text) for key, title in heads.items())
    title = "Area under the curve of a classifier that tells motions from recorded people's"
    return [Table(title=title, columns=columns, blocks=(Block(rows=tuple(rows)),), notes=tuple(dict.fromkeys(notes)))]


def _above(second: Float[np.ndarray, " n"], first: Float[np.ndarray, " m"]) -> Float[np.ndarray, "n m"]:
    """Return 1 where one of the second kind is above one of the first, 0.5 where they are equal."""
    return (second[:, None] > first) + 0.5 * (second[:, None] == first)


def _area(
    features: Float[np.ndarray, "n features"], second: Bool[np.ndarray, " n"], unit: Int[np.ndarray, " n"]
) -> Estimate:
    """Return the area under the curve of a discriminant that judges the units of one fold and learns from the others.

    The interval is that of its parts by unit (Obuchowski 1997).
    """
    decisions = np.zeros(len(features))
    for fold in range(_FOLDS):
        learnt = unit % _FOLDS != fold
        known = (features - features[learnt].mean(axis=0)) / np.maximum(features[learnt].std(axis=0), 1e-9)
        means = [known[learnt & side].mean(axis=0) for side in (~second, second)]
        within = known[learnt] - np.where(second[learnt, None], means[1], means[0])
        spread = within.T @ within / learnt.sum() + _RIDGE * np.eye(features.shape[1])
        decisions[~learnt] = (known[~learnt] - np.mean(means, axis=0)) @ np.linalg.solve(spread, means[1] - means[0])
    above = _above(decisions[second], decisions[~second])
    parts = np.full(len(decisions), above.mean())
    parts[second] += (above.mean(axis=1) - above.mean()) * len(parts) / second.sum()
    parts[~second] += (above.mean(axis=0) - above.mean()) * len(parts) / (~second).sum()
    found = mean_interval(clustered(parts, unit.astype(str)), nonnegative=True)
    return found if found.high is None else replace(found, high=min(found.high, 1.0))
