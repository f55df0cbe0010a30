"""Tells how well the suit's 23 segments serve as 22 joints: ``prbench study nymeria-mapping``.

Bone lengths, sides and floor need the suit alone. Where the Plus release's SMPL fit lies beside it, the distance of the
fit's joints decides between the two ways to map the trunk (docs/specification/nymeria.md#the-22-joints).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, require
from prbench.geometry.skeleton import BONES, XSENS_SEGMENTS, Joint, bone_lengths, y_up
from prbench.geometry.timelines import nearest_index
from prbench.protocol.manifests import load_manifest
from prbench.representation.converters import RestJoints, read_rest_joints
from prbench.representation.converters.smpl import SmplParameters, smpl_joints
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_adapters.corpora.nymeria.files import SUIT, find_sequences
from prbench_adapters.corpora.nymeria.format import N_SEGMENTS, SMPL_FILE, SUIT_FILE, SUIT_RATE
from prbench_adapters.corpora.nymeria.suit import open_suit

_MAPPING = load_manifest("nymeria").body.joint_mapping
_ONE_LOWER = {"L5": "Pelvis", "L3": "L5", "T12": "L3", "T8": "T12"}
_TRUNK = [joint for joint in Joint if _MAPPING[joint] in _ONE_LOWER]  # where the two variants differ
_SHARED = [joint for joint in Joint if joint not in _TRUNK]
# Maps each variant to the segment of each joint.
_VARIANTS = {
    "anatomical": [XSENS_SEGMENTS.index(name) for name in _MAPPING],
    "named": [XSENS_SEGMENTS.index(_ONE_LOWER.get(name, name)) for name in _MAPPING],
}

_BLOCK = 2400  # frames that are in memory at once: the floor is told every ten seconds
_CONSTANT = 0.001  # m, a suit's bone is constant to this
_FEWEST = 100  # samples that suit and SMPL fit must have in common
_FARTHEST = 0.5  # m, median; a fit of another recording or in another unit lies further away
_OTHER = "It is of another recording, or not in metres."
_SMPL_SIZES = {"global_orient": 3, "body_pose": 69, "transl": 3, "betas": 10}
_FEET = [XSENS_SEGMENTS.index(name) for name in ("L_Foot", "L_Toe", "R_Foot", "R_Toe")]
_LEFT = [row for row, (_, child) in enumerate(BONES) if Joint(child).name.startswith("LEFT_")]  # the right one follows

_Numbers = dict[tuple[str, str], float]  # numbers of a row by their title and unit


def measure_suit(
    path: Path, frames: Int[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "k 23 3"], dict[str, tuple[tuple[float, str, int], _Numbers]], list[str]]:
    """Measure a suit's bones, floor and height in blocks, so that memory does not grow with the recording.

    A bone's length is its median in the first ten seconds; the floor is the lowest foot of each ten seconds.

    Args:
        path: ``xdata.npz``.
        frames: Frames whose segments are kept.

    Returns:
        These segments (metres, Y up; NaN where the suit had none); each variant's worst bone (distance from its length
        in metres, name, frame of the file) and numbers; and what is missing in the file.

    Raises:
        InputFileError: see :func:`open_suit`; also if no frame has positions, or the head is below the feet.
    """
    archive, _ = open_suit(path)
    kept = np.full((len(frames), N_SEGMENTS, 3), np.nan)
    usual: dict[str, np.ndarray] = {}
    worst: dict[str, tuple[float, str, int]] = dict.fromkeys(_VARIANTS, (-1.0, "", 0))
    floor = []
    heights = []
    lost = 0
    for number, block in enumerate(archive.blocks("segment_tXYZ", _BLOCK)):
        first = number * _BLOCK
        points = y_up(block.reshape(len(block), N_SEGMENTS, 3).astype(np.float64))
        inside = (frames >= first) & (frames < first + len(points))
        kept[inside] = points[frames[inside] - first]
        there = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
        lost += len(points) - len(there)
        if not len(there):
            continue
        points = points[there]
        for name, rows in _VARIANTS.items():
            lengths = bone_lengths(points[:, rows])
            away = np.abs(lengths - usual.setdefault(name, np.median(lengths, axis=0)))
            frame, bone = np.unravel_index(away.argmax(), away.shape)
            found = (float(away[frame, bone]), Joint(BONES[bone][1]).name.lower(), int(first + there[frame]))
            worst[name] = max(worst[name], found)
        lowest = points[:, _FEET, 1].min(axis=1)
        floor.append(lowest.min())
        heights.append(np.median(points[:, XSENS_SEGMENTS.index("Head"), 1] - lowest))
    require(path, (floor, "segment_tXYZ", "positions", "none that are finite", "Leave the recording out."))
    height = float(np.median(heights))
    require(path, (height > 0.0, "segment_tXYZ", "Z up: the head above the feet", f"it {height:.2f} m above them", ""))
    least = load_manifest("nymeria").thresholds["smallest_quaternion"]
    turned = (block.reshape(len(block), N_SEGMENTS, 4) for block in archive.blocks("segment_qWXYZ", _BLOCK))
    unturned = sum(int((~(np.linalg.norm(block, axis=-1) >= least)).any(axis=1).sum()) for block in turned)
    missing = {"without a position": lost, "with a segment without rotation": unturned}
    third = max(len(floor) // 3, 1)
    drift = np.median(floor[-third:]) - np.median(floor[:third])
    shared = {("floor", "m"): np.median(floor), ("drift", "cm"): drift * 1e2, ("head above foot", "m"): height}
    measures = {}
    for name, lengths in usual.items():
        sides = np.abs(lengths[_LEFT] - lengths[np.add(_LEFT, 1)]).max()
        numbers = {("bone off by", "mm"): worst[name][0] * 1e3, ("left - right", "mm"): sides * 1e3, **shared}
        measures[name] = (worst[name], numbers)
    return kept, measures, [f"{count} frames {what}" for what, count in missing.items() if count]


def read_smpl_fit(path: Path, rest: RestJoints) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 22 3"]]:
    """Read the SMPL fit of the Plus release about ten times a second.

    Returns:
        TIME_CODE, microseconds; and the 22 joints in the fit's own world, metres.

    Raises:
        InputFileError: if an array is missing, has another length than the times, or holds no rotations.
    """
    archive = Archive(path, remedy="Download it again.")
    archive.require(("timestamps", *_SMPL_SIZES))
    times = archive.load(["timestamps"])["timestamps"].ravel().astype(np.float64)
    require(
        path, (len(times) > 1 and (np.diff(times) > 0).all(), "timestamps", "increasing microseconds", "others", "")
    )
    every = max(round(1e5 / float(np.median(np.diff(times)))), 1)
    parts = {}
    for key, size in _SMPL_SIZES.items():
        shape = archive.header(key).shape
        wanted = (len(times), size)
        require(path, (shape == wanted, key, f"the shape {wanted}", shape, "Lengths are mixed; download it again."))
        step = every * (_BLOCK // every + 1)  # whole numbers of samples, so that each block begins with one
        parts[key] = np.concatenate([block[::every].astype(np.float64) for block in archive.blocks(key, step)])
    return times[::every], smpl_joints(SmplParameters.from_arrays(**parts, source=path), rest)


def fit_distances(
    path: Path, kept: Float[np.ndarray, "k 23 3"], joints: Float[np.ndarray, "k 22 3"]
) -> dict[str, _Numbers]:
    """Distances of the SMPL fit's joints from the suit's, after one rigid alignment of the whole recording.

    The alignment uses the 18 joints that both variants share, so that it favours neither.

    Args:
        path: The fit, for messages.
        kept: The suit's segments, metres, Y up.
        joints: The fit's joints at the same times, in any world.

    Returns:
        By joint, the median and 95th percentile under each variant, cm; last their means over those that differ.

    Raises:
        InputFileError: if the two are no two views of one motion.
    """
    suit = kept[:, _VARIANTS["anatomical"]][:, _SHARED].reshape(-1, 3)
    fit = joints[:, _SHARED].reshape(-1, 3)
    turn = Rotation.align_vectors(suit - suit.mean(axis=0), fit - fit.mean(axis=0))[0]
    moved = turn.apply((joints - fit.mean(axis=0)).reshape(-1, 3)).reshape(joints.shape) + suit.mean(axis=0)
    away = {name: np.linalg.norm(moved - kept[:, rows], axis=-1) for name, rows in _VARIANTS.items()}
    median = float(np.median(away["anatomical"][:, _SHARED]))
    require(path, (median <= _FARTHEST, "", f"joints within {_FARTHEST:g} m of the suit's", f"{median:.2f} m", _OTHER))
    found = {}
    for name, rows in {**{joint.name.lower(): [joint] for joint in Joint}, "pelvis and spine, mean": _TRUNK}.items():
        found[name] = {
            (f"{variant} p{percent}", "cm"): np.percentile(away[variant][:, rows], percent, axis=0).mean() * 1e2
            for variant in _VARIANTS
            for percent in (50, 95)
        }
    return found


@foreign_input()
def _measure(path: Path, model: RestJoints | None) -> tuple[dict, list[str], dict[str, _Numbers]]:
    """Return numbers and remarks of one suit, and of the SMPL fit beside it where there are fit and model."""
    beside = path.with_name(SMPL_FILE)
    if model is None or not beside.exists():
        return *measure_suit(path, np.zeros(0, dtype=np.int64))[1:], {}
    times, joints = read_smpl_fit(beside, model)
    clock, frames = np.unique(open_suit(path)[1], return_index=True)  # clocks of damaged files jump back
    nearest = nearest_index(clock.astype(float), times)
    common = np.abs(clock[nearest] - times) <= 0.5e6 / SUIT_RATE
    require(beside, (common.sum() >= _FEWEST, "timestamps", f"{_FEWEST} times of the suit", int(common.sum()), _OTHER))
    kept, measures, remarks = measure_suit(path, frames[nearest[common]])
    seen = np.isfinite(kept).all(axis=(1, 2))
    return measures, remarks, fit_distances(beside, kept[seen], joints[common][seen])


def mapping_tables(root: Path, smpl: Path | None) -> tuple[list[Table], dict[str, str]]:
    """Report on all suits below a folder, one after the other.

    Args:
        root: A copy of Nymeria or of one of its sequences.
        smpl: The user's own SMPL model (``.npz``), with which fits of the Plus release are posed.

    Returns:
        The table of suits and, where there are fits, that of their distances; and of each suit that is corrupt or
        cannot be read, why.

    Raises:
        InputFileError: if there is no suit, or the model cannot be read.
    """
    model = None if smpl is None else read_rest_joints(smpl, joints=24)
    failed = {}
    suits: list[tuple[dict[str, str], _Numbers]] = []
    fits: list[tuple[dict[str, str], _Numbers]] = []
    notes = []
    paths = {each.recording_id: path for each in find_sequences(root) if (path := each.path(SUIT)) is not None}
    require(root, (paths, "", f"sequences with body/{SUIT_FILE}", "none", ""))
    for recording, path in paths.items():
        try:
            measures, remarks, distances = _measure(path, model)
        except InputFileError as error:
            failed[recording] = str(error)
            continue
        notes += [f"{recording}: {remark}" for remark in remarks]
        for variant, ((off, bone, frame), numbers) in measures.items():
            if off > _CONSTANT and variant == "anatomical":  # "named" leaves a segment out of the trunk
                failed[recording] = f"corrupt: {bone} is {off * 1e3:.1f} mm off its length in frame {frame}"
            words = {"recording": recording, "mapping": variant, "worst bone": f"{bone}, frame {frame}"}
            suits.append((words, numbers))
        fits += [({"recording": recording, "joint": joint}, numbers) for joint, numbers in distances.items()]
    tables = []
    for title, rows, said in (("Suits on 22 joints", suits, notes), ("Distance of the SMPL fit from them", fits, ())):
        lines = []
        for words, row in rows:
            about = dict(zip(("dataset", "variant"), words.values(), strict=False))
            cells = [Cell(metric=name, value=float(value), unit=unit, **about) for (name, unit), value in row.items()]
            lines.append(Row(text=words, cells=tuple(cells)))
        if rows:
            columns = [Column(key=name, title=name, text=True) for name in rows[0][0]]
            columns += [Column(key=name, title=name, unit=unit) for name, unit in rows[0][1]]
            blocks = (Block(rows=tuple(lines)),)
            tables.append(Table(title=title, columns=tuple(columns), blocks=blocks, notes=tuple(said)))
    return tables, failed
