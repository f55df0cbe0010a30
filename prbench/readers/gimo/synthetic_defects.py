"""Defects of copies of GIMO (docs/specification/gimo.md#bad-input)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from prbench.readers.gimo import format as gimo
from prbench.synthetic.layouts import Defect, removed

_SHORT_GAP = 3  # frames
_LONG_GAP = 15
_FOREIGN_PICKLE = b"cbuiltins\nprint\n(S'a pickle can call anything'\ntR."


def _sequence(root: Path, name: str) -> Path:
    """Return the sequence's folder, in whichever scene it lies."""
    return next(path for path in sorted(root.glob(f"*/{name}")) if path.is_dir())


def _skeleton(root: Path, name: str) -> Path:
    return _sequence(root, name) / gimo.SKELETON_FILE


def _poses(root: Path, name: str) -> list[Path]:
    return sorted((_sequence(root, name) / gimo.POSE_FOLDER).glob("*.pkl"), key=lambda path: int(path.stem))


def _remove_sequence(root: Path, name: str) -> None:
    shutil.rmtree(_sequence(root, name))


def _remove_poses(count: int) -> Callable[[Path, str], None]:
    def apply(root: Path, name: str) -> None:
        poses = _poses(root, name)
        for path in poses[len(poses) // 2 :][:count]:
            path.unlink()

    return apply


def _foreign_pickle(root: Path, name: str) -> None:
    _poses(root, name)[1].write_bytes(_FOREIGN_PICKLE)


def _no_scale(root: Path, name: str) -> None:
    for path in sorted(_sequence(root, name).glob("transform_info*.json")):
        content = json.loads(path.read_text("utf-8"))
        del content["scale"]
        path.write_text(json.dumps(content), encoding="utf-8")


def _cut_norm(root: Path, name: str) -> None:
    path = _sequence(root, name).parent / gimo.SCENE_FOLDER / gimo.NORM_FILE
    path.write_text("\n".join(path.read_text("utf-8").splitlines()[:3]) + "\n", encoding="utf-8")


def _cut_gaze(root: Path, name: str) -> None:
    centres = (_sequence(root, name) / gimo.GAZE_FOLDER).glob(f"*{gimo.GAZE_CENTRE_SUFFIX}.ply")
    for path in sorted(centres, key=lambda path: int(path.name.partition("_")[0]))[::10]:
        path.write_bytes(path.read_bytes()[:-60])


def _cut_skeleton(root: Path, name: str) -> None:
    path = _skeleton(root, name)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])


def _renamed_joints(root: Path, name: str) -> None:
    path = _skeleton(root, name)
    path.write_text(path.read_text("utf-8").replace("LeftForeArm", "Unterarm_links"), encoding="utf-8")


def _other_skeleton(root: Path, name: str) -> None:
    """Give the suit the hips of another walk: the same one, played backwards."""
    path = _skeleton(root, name)
    head, _, motion = path.read_text("utf-8").partition("Frame Time:")
    seconds, *rows = motion.strip().splitlines()
    path.write_text("\n".join([f"{head}Frame Time: {seconds.strip()}", *rows[::-1]]) + "\n", encoding="utf-8")


def _not_annotated(root: Path, name: str) -> None:
    _edit_lines(root / gimo.EVENTS_FILE, lambda line: None if name in line else line)
    _edit_lines(root / gimo.TABLE_FILE, lambda line: _without_hint(line) if name in line else line)


def _without_hint(line: str) -> str:
    cells = line.split(",")
    cells[gimo.HINT_INDEX] = ""
    return ",".join(cells)


def _edit_lines(path: Path, change: Callable[[str], str | None]) -> None:
    lines = [change(line) for line in path.read_text("utf-8").splitlines()]
    path.write_text("\n".join(line for line in lines if line is not None) + "\n", encoding="utf-8")


DEFECTS: tuple[Defect, ...] = (
    Defect("missing-sequence", "the sequence is not unpacked", _remove_sequence, "skipped", "its folder is missing"),
    Defect("not-annotated", "nobody annotated a pick", _not_annotated, "skipped", "no event is annotated"),
    Defect("few-missing-poses", "three frames without pose", _remove_poses(_SHORT_GAP), "read", "3 of"),
    Defect(
        "many-missing-poses", "half a second without poses", _remove_poses(_LONG_GAP), "read", "15 in gaps too long"
    ),
    Defect("foreign-pickle", "a pose that calls a function", _foreign_pickle, "failed", "the name 'builtins.print'"),
    Defect("no-scale", "transform_info without scale", _no_scale, "failed", "missing required field `scale`"),
    Defect("cut-norm", "transform_norm with three rows", _cut_norm, "failed", "expected a 4x4 matrix"),
    Defect("cut-gaze", "cut gaze files", _cut_gaze, "read", "damaged gaze files are left out"),
    Defect("no-skeleton", "no way to the joints", removed(_skeleton), "failed", "bvh lacks skeleton.bvh"),
    Defect("cut-skeleton", "a cut BVH file", _cut_skeleton, "failed", "MOTION"),
    Defect(
        "renamed-joints", "joints under unknown names", _renamed_joints, "failed", "unmatched names: Unterarm_links"
    ),
    Defect("other-skeleton", "the skeleton of another walk", _other_skeleton, "failed", "of the fitted pelvis"),
)
