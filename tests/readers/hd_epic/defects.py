"""Defects of real copies of HD-EPIC (docs/specification/hd-epic.md#pitfalls-and-bad-input)."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo import format as ego
from prbench.readers.hd_epic import format as hd_epic
from tests.readers.defects import Damage, Defect, Row, change_cells, change_json, changed_rows, cut_in_half, removed


def _only(root: Path, pattern: str) -> Path:
    found = sorted((root / hd_epic.DATA_FOLDER).glob(pattern))
    assert len(found) == 1, f"{pattern} matches {len(found)} files"
    return found[0]


def _time_file(root: Path, video: str) -> Path:
    return _only(root, f"{hd_epic.VIDEOS_FOLDER}/*/{video}{hd_epic.TIME_SUFFIX}")


def _gaze_archive(root: Path, video: str) -> Path:
    return _only(root, f"{hd_epic.MPS_FOLDER}/*/{hd_epic.GAZE_FOLDER}/mps_{video}_vrs.zip")


def _slam_archive(root: Path, video: str) -> Path:
    """Return the archive that the participant's map names."""
    for path in sorted((root / hd_epic.DATA_FOLDER).glob(f"{hd_epic.MPS_FOLDER}/*/*/*/{hd_epic.SLAM_MAP_FILE}")):
        for key, number in json.loads(path.read_text()).items():
            if key.endswith(f"/{video}.vrs"):
                return path.with_name(f"{number}.zip")
    raise AssertionError(f"no map names {video}")


def _rows_of(find: Callable[[Path, str], Path], name: str, change: Callable[[list[Row]], list[Row]]) -> Damage:
    """Return a damage that changes the rows of one CSV file inside the archive that ``find`` names."""

    def apply(root: Path, video: str) -> None:
        archive = find(root, video)
        with zipfile.ZipFile(archive) as opened:
            contents = {entry: opened.read(entry) for entry in opened.namelist()}
        member = next(entry for entry in contents if entry.endswith(f"/{name}"))
        text = changed_rows(contents[member].decode(), change)
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as written:
            # The entries carry the time of writing, so these bytes differ from run to run; what they hold does not.
            for entry, content in contents.items():
                written.writestr(entry, text.encode() if entry == member else content)

    return apply


def _time_rows(change: Callable[[list[list[str]]], Iterable[Iterable[str]]]) -> Damage:
    """Return a damage that changes the lines of the video's time file below its header."""
    return lambda root, video: change_cells(_time_file(root, video), change)


def _without_video(name: str) -> Damage:
    """Return a damage that removes the video from one file of annotations."""
    folder = Path(hd_epic.ANNOTATIONS_FOLDER, hd_epic.MOVEMENTS_FOLDER)
    return lambda root, video: change_json(root / folder / name, lambda content: content.pop(video))


def _missing_bodies(root: Path, video: str) -> None:
    shutil.rmtree(root / ego.POSES_FOLDER / video)


def _foreign_bodies(root: Path, video: str) -> None:
    """Copy another video's outputs here."""
    others = [path for path in sorted((root / ego.POSES_FOLDER).iterdir()) if path.name != video]
    _missing_bodies(root, video)
    shutil.copytree(others[0], root / ego.POSES_FOLDER / video)


def _other_alignment(root: Path, video: str) -> None:
    """Replace the multi-recording SLAM by an archive of an unknown layout."""
    path = _slam_archive(root, video)
    target = path.parents[2] / hd_epic.OTHER_SLAM_FOLDER / f"{video}.zip"
    target.parent.mkdir(parents=True, exist_ok=True)
    path.unlink()
    with zipfile.ZipFile(target, "w") as archive:
        archive.writestr(f"{video}/images.txt", "# Image list with two lines of data per image\n")
    key = f"{path.parents[2].name}/{video}.vrs"
    change_json(path.with_name(hd_epic.SLAM_MAP_FILE), lambda content: content.pop(key))


_HALF = _time_rows(lambda rows: rows[: (len(rows) + 1) // 2 - 1])  # half of the lines
_IN_MICROSECONDS = _time_rows(lambda rows: [[a, b, str(int(c) // 1000)] for a, b, c in rows])
_NO_ANGLES = dict.fromkeys((mps.LEFT_YAW, mps.RIGHT_YAW, mps.PITCH), "nan")
_NAN_GAZE = _rows_of(_gaze_archive, "general_eye_gaze.csv", lambda rows: [row | _NO_ANGLES for row in rows])
_UNSEEN = {f"{side}_tracking_confidence": "-1" for side in ("left", "right")}
_LOST_HANDS = _rows_of(_gaze_archive, mps.WRISTS_FILE, lambda rows: [row | _UNSEEN for row in rows])
_NO_WORLD = {mps.GRAPH_COLUMN: mps.UNDEFINED_GRAPH}
_LOST_POSES = _rows_of(
    _slam_archive,
    mps.TRAJECTORY_FILE,
    lambda rows: [row | (_NO_WORLD if number < len(rows) // 10 else {}) for number, row in enumerate(rows)],
)
_NO_TIME = removed(_time_file)
_NO_GAZE = removed(_gaze_archive)
_NO_TRACKS = _without_video(hd_epic.ASSOCIATIONS_FILE)
_NO_MASKS = _without_video(hd_epic.MASKS_FILE)

# What can be done to one video of a synthetic tree.
DEFECTS = (
    Defect("missing-time", "the time csv of the video is not there", _NO_TIME, "failed", hd_epic.TIME_SUFFIX),
    Defect("missing-slam", "a download by video: gaze without SLAM", removed(_slam_archive), "failed", "SLAM zip"),
    Defect("missing-gaze", "GAZE_HAND of the video is not there", _NO_GAZE, "failed", "Download GAZE_HAND"),
    Defect("truncated-archive", "the SLAM archive is cut off", cut_in_half(_slam_archive), "failed", "zip archive"),
    Defect("truncated-time", "the time csv ends in the middle", _HALF, "read", "it may be truncated"),
    Defect("swapped-clock", "device times in microseconds", _IN_MICROSECONDS, "failed", "streams do not overlap"),
    Defect("nan-gaze", "no gaze angle is a number", _NAN_GAZE, "read", "no valid gaze"),
    Defect("lost-hands", "no hand is ever tracked", _LOST_HANDS, "read", ""),
    Defect("lost-poses", "poses that belong to no world", _LOST_POSES, "read", "are left out"),
    Defect("missing-association", "assoc_info.json lacks the video", _NO_TRACKS, "failed", "no such key"),
    Defect("missing-masks", "mask_info.json lacks the video", _NO_MASKS, "read", "have no mask"),
    Defect("missing-bodies", "no EgoAllo outputs", _missing_bodies, "read", "no EgoAllo outputs"),
    Defect(
        "foreign-bodies", "EgoAllo outputs of another video", _foreign_bodies, "failed", "belongs to another recording"
    ),
    Defect("other-alignment", "aligned by other means than SLAM", _other_alignment, "skipped", "by other means"),
)
