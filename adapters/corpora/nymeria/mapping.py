"""Tells how well the suit's 23 segments serve as 22 joints: ``prbench study nymeria-mapping``.

Bone lengths, sides and floor need the suit alone. Where the Plus release's SMPL fit lies beside it, the distance of the
fit's joints decides between the two ways to map the trunk (docs/specification/nymeria.md#the-22-joints).
"""

from __future__ import annotations

from dataclasses import dataclass, field
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
_SMPL_SIZES = {"global_orient": 3, "body_pose": 69, "transl": 3, "betas": 10}
_FEET = [XSENS_SEGMENTS.index(name) for name in ("L_Foot", "L_Toe", "R_Foot", "R_Toe")]
_HEAD = XSENS_SEGMENTS.index("Head")
_SHARES = {"p50": 50.0, "p95": 95.0}

_NUMBERS = {
    "bone": ("bone off by", "mm"),
    "sides": ("left - right", "mm"),
    "floor": ("floor", "m"),
    "drift": ("drift", "cm"),
    "head": ("head above foot", "m"),
}
_WORDS = ("recording", "mapping", "worst bone", "joint")
_TEXT = {name: Column(key=name, title=name, text=True) for name in _WORDS}


@dataclass
class SuitMeasures:
    """Numbers of one suit file; positions in metres, Y up.

    Attributes:
        kept: Segments in the frames that were asked for; NaN where the suit had none.
        lengths: Maps each variant to the length of each bone, the median of the first ten seconds with positions.
        worst: Maps each variant to the largest distance of any bone from that length, the bone, and the file's frame.
        floor: Height of the lowest foot in each ten seconds.
        heights: Median height of the head above the lowest foot in each of them.
        remarks: Sentences about what is missing in the file.
    """

    kept: Float[np.ndarray, "k 23 3"]
    lengths: dict[str, Float[np.ndarray, "21"]] = field(default_factory=dict)
    worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)
    floor: list[float] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def measure_suit(path: Path, frames: Int[np.ndarray, " k"]) -> SuitMeasures:
    """Measure a suit's bones, floor and height in blocks, so that memory does not grow with the recording.

    Args:
        path: ``xdata.npz``.
        frames: Frames whose segments are kept.

    Raises:
        InputFileError: see :func:`open_suit`; also if no frame has positions, or the head is below the feet.
    """
    archive, _ = open_suit(path)
    found = SuitMeasures(np.full((len(frames), N_SEGMENTS, 3), np.nan))
    lost = 0
    for number, block in enumerate(archive.blocks("segment_tXYZ", _BLOCK)):
        first = number * _BLOCK
        points = y_up(block.reshape(len(block), N_SEGMENTS, 3).astype(np.float64))
        inside = (frames >= first) & (frames < first + len(points))
        found.kept[inside] = points[frames[inside] - first]
        there = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
        lost += len(points) - len(there)
        if not len(there):
            continue
        points = points[there]
        for name, rows in _VARIANTS.items():
            lengths = bone_lengths(points[:, rows])
            away = np.abs(lengths - found.lengths.setdefault(name, np.median(lengths, axis=0)))
            frame, bone = np.unravel_index(away.argmax(), away.shape)
            worst = (float(away[frame, bone]), Joint(BONES[bone][1]).name.lower(), int(first + there[frame]))
            found.worst[name] = max(found.worst.get(name, worst), worst)
        lowest = points[:, _FEET, 1].min(axis=1)
        found.floor.append(float(lowest.min()))
        found.heights.append(float(np.median(points[:, _HEAD, 1] - lowest)))
    require(path, (found.floor, "segment_tXYZ", "positions", "none that are finite", "Leave the recording out."))
    height = float(np.median(found.heights))
    remedy = "Other axes than the suit's own are not supported."
    says = f"the head {height:.2f} m above the feet in z"
    require(path, (height > 0.0, "segment_tXYZ", "Z up: the head above the feet", says, remedy))
    least = load_manifest("nymeria").thresholds["smallest_quaternion"]
    turned = (block.reshape(len(block), N_SEGMENTS, 4) for block in archive.blocks("segment_qWXYZ", _BLOCK))
    unturned = sum(int((~(np.linalg.norm(block, axis=-1) >= least)).any(axis=1).sum()) for block in turned)
    for count, what in ((lost, "without a position"), (unturned, "with a segment without rotation")):
        found.remarks += [f"{count} frames {what}"] if count else []
    return found


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
    ordered = len(times) >= 2 and bool((np.diff(times) > 0).all())
    require(path, (ordered, "timestamps", "increasing times in microseconds", f"{len(times)} others", ""))
    every = max(round(1e5 / float(np.median(np.diff(times)))), 1)
    parts = {}
    for key, size in _SMPL_SIZES.items():
        shape = archive.header(key).shape
        fits = shape == (len(times), size)
        require(path, (fits, key, f"the shape {(len(times), size)}", shape, "Lengths are mixed; download it again."))
        step = every * (_BLOCK // every + 1)  # whole numbers of samples, so that each block begins with one
        parts[key] = np.concatenate([block[::every].astype(np.float64) for block in archive.blocks(key, step)])
    return times[::every], smpl_joints(SmplParameters.from_arrays(**parts, source=path), rest)


def fit_distances(
    kept: Float[np.ndarray, "k 23 3"], joints: Float[np.ndarray, "k 22 3"], path: Path
) -> dict[str, Float[np.ndarray, "k 22"]]:
    """Distance of the SMPL fit's joints from the suit's, metres, after one rigid alignment of the whole recording.

    The alignment uses the 18 joints that both variants share, so that it favours neither.

    Args:
        kept: The suit's segments, metres, Y up.
        joints: The fit's joints at the same times, in any world.
        path: The fit, for messages.

    Raises:
        InputFileError: if the two are no two views of one motion.
    """
    suit = kept[:, _VARIANTS["anatomical"]][:, _SHARED].reshape(-1, 3)
    fit = joints[:, _SHARED].reshape(-1, 3)
    turn = Rotation.align_vectors(suit - suit.mean(axis=0), fit - fit.mean(axis=0))[0]
    moved = turn.apply((joints - fit.mean(axis=0)).reshape(-1, 3)).reshape(joints.shape) + suit.mean(axis=0)
    found = {name: np.linalg.norm(moved - kept[:, rows], axis=-1) for name, rows in _VARIANTS.items()}
    away = float(np.median(found["anatomical"][:, _SHARED]))
    expected = f"joints within {_FARTHEST:g} m of the suit's"
    remedy = "It is of another recording, or not in metres."
    require(path, (away <= _FARTHEST, "", expected, f"a median distance of {away:.2f} m", remedy))
    return found


@foreign_input()
def _measure(path: Path, model: RestJoints | None) -> tuple[SuitMeasures, dict[str, Float[np.ndarray, "k 22"]]]:
    """Measure one suit, and its distance from the SMPL fit beside it where there are fit and model."""
    beside = path.with_name(SMPL_FILE)
    if model is None or not beside.exists():
        return measure_suit(path, np.zeros(0, dtype=np.int64)), {}
    times, joints = read_smpl_fit(beside, model)
    clock, frames = np.unique(open_suit(path)[1], return_index=True)  # clocks of damaged files jump back
    nearest = nearest_index(clock.astype(float), times)
    common = np.abs(clock[nearest] - times) <= 0.5e6 / SUIT_RATE
    expected = f"{_FEWEST} or more samples at times of the suit"
    remedy = "It is of another recording."
    require(beside, (common.sum() >= _FEWEST, "timestamps", expected, int(common.sum()), remedy))
    measures = measure_suit(path, frames[nearest[common]])
    seen = np.isfinite(measures.kept).all(axis=(1, 2))
    return measures, fit_distances(measures.kept[seen], joints[common][seen], beside)


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
    suits: list[Row] = []
    fits: list[Row] = []
    notes: list[str] = []
    paths = {each.recording_id: path for each in find_sequences(root) if (path := each.path(SUIT)) is not None}
    require(root, (paths, "", f"sequences with body/{SUIT_FILE}", "none", ""))
    for recording, path in paths.items():
        try:
            measures, distances = _measure(path, model)
        except InputFileError as error:
            failed[recording] = str(error)
            continue
        notes += [f"{recording}: {remark}" for remark in measures.remarks]
        off, bone, frame = measures.worst["anatomical"]  # "named" leaves a segment out of the trunk
        if off > _CONSTANT:
            failed[recording] = f"corrupt: {bone} is {off * 1e3:.1f} mm off its length in frame {frame}"
        suits += [_suit_row(recording, variant, measures) for variant in _VARIANTS]
        fits += _fit_rows(recording, distances)
    numbers = [Column(key=key, title=title, unit=unit) for key, (title, unit) in _NUMBERS.items()]
    columns = (_TEXT["recording"], _TEXT["mapping"], *numbers, _TEXT["worst bone"])
    tables = [
        Table(title="Suits on 22 joints", columns=columns, blocks=(Block(rows=tuple(suits)),), notes=tuple(notes))
    ]
    if fits:
        keys = [f"{variant} {share}" for variant in _VARIANTS for share in _SHARES]
        columns = (_TEXT["recording"], _TEXT["joint"], *(Column(key=key, title=key, unit="cm") for key in keys))
        title = "Distance of the SMPL fit from the suit's joints"
        tables.append(Table(title=title, columns=columns, blocks=(Block(rows=tuple(fits)),)))
    return tables, failed


def _suit_row(recording: str, variant: str, measures: SuitMeasures) -> Row:
    off, bone, frame = measures.worst[variant]
    lengths = dict(zip(BONES, measures.lengths[variant], strict=True))
    # Of a left joint, the right one follows; a parent in the middle is the parent of both.
    mirror = [(lengths[pair], lengths[BONES[pair[1]]]) for pair in BONES if Joint(pair[1]).name.startswith("LEFT_")]
    third = max(len(measures.floor) // 3, 1)
    numbers = {
        "bone": off * 1e3,
        "sides": max(abs(left - right) for left, right in mirror) * 1e3,
        "floor": np.median(measures.floor),
        "drift": 1e2 * (np.median(measures.floor[-third:]) - np.median(measures.floor[:third])),
        "head": np.median(measures.heights),
    }
    cells = [
        Cell(dataset=recording, variant=variant, metric=name, value=float(value), unit=_NUMBERS[name][1])
        for name, value in numbers.items()
    ]
    text = {"recording": recording, "mapping": variant, "worst bone": f"{bone}, frame {frame}"}
    return Row(text=text, cells=tuple(cells))


def _fit_rows(recording: str, distances: dict[str, Float[np.ndarray, "k 22"]]) -> list[Row]:
    """Return a row a joint, and one of the mean of the joints on which the variants differ."""
    groups = {joint.name.lower(): [joint] for joint in Joint if distances}
    if distances:
        groups["pelvis and spine, mean"] = _TRUNK
    rows = []
    for name, joints in groups.items():
        cells = []
        for variant, away in distances.items():
            for share, percent in _SHARES.items():
                value = float(np.percentile(away[:, joints], percent, axis=0).mean()) * 1e2
                about = {"dataset": recording, "variant": name}
                cells.append(Cell(metric=f"{variant} {share}", value=value, unit="cm", **about))
        rows.append(Row(text={"recording": recording, "joint": name}, cells=tuple(cells)))
    return rows
