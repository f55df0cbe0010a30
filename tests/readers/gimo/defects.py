"""Defects of copies of GIMO (docs/specification/gimo.md#bad-input)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from prbench.readers.gimo import format as gimo
from tests.readers.defects import Damage, Defect, removed

_SHORT_GAP = 3  # frames
_LONG_GAP = 15


def _sequence(root: Path, name: str) -> Path:
    """Return the sequence's folder, in whichever scene it lies."""
    return next(path for path in sorted(root.glob(f"*/{name}")) if path.is_dir())


def _skeleton(root: Path, name: str) -> Path:
    return _sequence(root, name) / gimo.SKELETON_FILE


def _poses(root: Path, name: str) -> list[Path]:
    return sorted((_sequence(root, name) / gimo.POSE_FOLDER).glob("*.pkl"), key=lambda path: int(path.stem))


def _remove_poses(count: int) -> Damage:
    def apply(root: Path, name: str) -> None:
        poses = _poses(root, name)
        for path in poses[len(poses) // 2 :][:count]:
            path.unlink()

    return apply


def _edit(find: Callable[[Path, str], Path], change: Callable[[str], str]) -> Damage:
    """Return a damage that changes the text of the file that ``find`` names."""

    def apply(root: Path, name: str) -> None:
        path = find(root, name)
        path.write_text(change(path.read_text("utf-8")), encoding="utf-8")

    return apply


def _not_unpacked(root: Path, name: str) -> None:
    shutil.rmtree(_sequence(root, name))


def _foreign_pickle(root: Path, name: str) -> None:
    _poses(root, name)[1].write_bytes(b"cbuiltins\nprint\n(S'a pickle can call anything'\ntR.")


def _no_scale(root: Path, name: str) -> None:
    for path in sorted(_sequence(root, name).glob("transform_info*.json")):
        content = json.loads(path.read_text("utf-8"))
        del content["scale"]
        path.write_text(json.dumps(content), encoding="utf-8")


def _cut_gaze(root: Path, name: str) -> None:
    centres = (_sequence(root, name) / gimo.GAZE_FOLDER).glob(f"*{gimo.GAZE_CENTRE_SUFFIX}.ply")
    for path in sorted(centres, key=lambda path: int(path.name.partition("_")[0]))[::10]:
        path.write_bytes(path.read_bytes()[:-60])


def _backwards(text: str) -> str:
    """Give the suit the hips of another walk: the same one, played backwards."""
    head, _, motion = text.partition("Frame Time:")
    seconds, *rows = motion.strip().splitlines()
    return "\n".join([f"{head}Frame Time: {seconds.strip()}", *rows[::-1]]) + "\n"


def _not_annotated(root: Path, name: str) -> None:
    """Remove the sequence's rows of the events, and its hints."""
    events = (root / gimo.EVENTS_FILE).read_text("utf-8").splitlines()
    kept = [line for line in events if name not in line]
    (root / gimo.EVENTS_FILE).write_text("\n".join(kept) + "\n", encoding="utf-8")
    lines = (root / gimo.TABLE_FILE).read_text("utf-8").splitlines()
    for number, line in enumerate(lines):
        if name in line:
            cells = line.split(",")
            cells[gimo.HINT_INDEX] = ""
            lines[number] = ",".join(cells)
    (root / gimo.TABLE_FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")


_CUT_NORM = _edit(
    lambda root, name: _sequence(root, name).parent / gimo.SCENE_FOLDER / gimo.NORM_FILE,
    lambda text: "\n".join(text.splitlines()[:3]) + "\n",
)
_CUT_SKELETON = _edit(_skeleton, lambda text: text[: len(text) * 2 // 3])
_RENAMED = _edit(_skeleton, lambda text: text.replace("LeftForeArm", "Unterarm_links"))
_OTHER_WALK = _edit(_skeleton, _backwards)
_SHORT = _remove_poses(_SHORT_GAP)
_LONG = _remove_poses(_LONG_GAP)

DEFECTS: tuple[Defect, ...] = (
    Defect("missing-sequence", "the sequence is not unpacked", _not_unpacked, "skipped", "its folder is missing"),
    Defect("not-annotated", "nobody annotated a pick", _not_annotated, "skipped", "no event is annotated"),
    Defect("few-missing-poses", "three frames without pose", _SHORT, "read", "3 of"),
    Defect("many-missing-poses", "half a second without poses", _LONG, "read", "15 in gaps too long"),
    Defect("foreign-pickle", "a pose that calls a function", _foreign_pickle, "failed", "the name 'builtins.print'"),
    Defect("no-scale", "transform_info without scale", _no_scale, "failed", "missing required field `scale`"),
    Defect("cut-norm", "transform_norm with three rows", _CUT_NORM, "failed", "expected a 4x4 matrix"),
    Defect("cut-gaze", "cut gaze files", _cut_gaze, "read", "damaged gaze files are left out"),
    Defect("no-skeleton", "no way to the joints", removed(_skeleton), "failed", "bvh lacks skeleton.bvh"),
    Defect("cut-skeleton", "a cut BVH file", _CUT_SKELETON, "failed", "MOTION"),
    Defect("renamed-joints", "joints under unknown names", _RENAMED, "failed", "unmatched names: Unterarm_links"),
    Defect("other-skeleton", "the skeleton of another walk", _OTHER_WALK, "failed", "of the fitted pelvis"),
)
