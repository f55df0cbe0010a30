"""Find the files of the Machine Perception Services: by name, below a folder or in archives.

Source: docs/specification/aria-mps.md#folder-tree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import msgspec

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.files import decode_json
from prbench.readers.found import InputFile, input_file, is_present
from prbench.readers.zipped import Source, archive_members, shown

_ROLES: dict[str, tuple[str, ...]] = {
    mps.TRAJECTORY: (mps.TRAJECTORY_FILE,),
    mps.GAZE: mps.GAZE_FILES,
    mps.CALIBRATION: (mps.CALIBRATION_FILE,),
    mps.WRISTS: (mps.WRISTS_FILE,),
    mps.HAND_TRACKING: (mps.HAND_TRACKING_FILE,),
}
_SUMMARIES = {
    mps.SLAM_SUMMARY: (mps.TRAJECTORY, mps.CALIBRATION),
    mps.GAZE_SUMMARY: (mps.GAZE,),
    mps.HAND_SUMMARY: (mps.WRISTS, mps.HAND_TRACKING),
}
"""A summary lies beside one of the files that it speaks of."""
UNREADABLE = "unreadable archive: "
"""Role of an archive that cannot be opened: this and its name."""
_USUAL_FOLDERS = ("slam", "trajectory", "eye_gaze", "hand_tracking")


def find_mps_files(root: Path) -> tuple[InputFile, ...]:
    """The files of one recording, under their present or old names.

    Args:
        root: The folder of one recording's outputs, or a zip archive of it; in a folder, archives are looked into too.

    Returns:
        At most one file a role: of several with the best name that in one of the usual folders, then the one that lies
        highest, plain before archived. Nothing is required here.

    Raises:
        InputFileError: if ``root`` is an archive and damaged.
    """
    present = _files_of_archive(root) if root.is_file() else _files_below(root)
    found = {role: file for role, names in _ROLES.items() if (file := _best(present, names, role))}
    for role, companions in _SUMMARIES.items():
        beside = [_folder(found[companion]) for companion in companions if companion in found]
        summaries = [file for file in present if _name(file) == mps.SUMMARY_FILE and _folder(file) in beside]
        if summaries:
            found[role] = InputFile(role, summaries[0].path, summaries[0].size, summaries[0].member)
    unreadable = (file.path for file in present if file.role == UNREADABLE)
    return (*found.values(), *(input_file(f"{UNREADABLE}{path.name}", path) for path in unreadable))


def find_gaze_file(folder: Path) -> Path | None:
    """The preferred gaze file of a folder, under its new or an old name; None if there is none."""
    return next((folder / name for name in mps.GAZE_FILES if is_present(folder / name)), None)


def is_personalized(file: InputFile) -> bool:
    """Return True where a gaze file was made with the wearer's own calibration."""
    return _name(file) in mps.PERSONALIZED_GAZE_FILES


def _files_below(root: Path) -> list[InputFile]:
    wanted = {name for names in _ROLES.values() for name in names} | {mps.SUMMARY_FILE}
    files = []
    for path in sorted(root.rglob("*")):
        if path.name in wanted:
            files.append(input_file("", path))
        elif path.suffix == ".zip" and path.is_file():
            files += _files_of_archive_if_whole(path)
    return files


def _files_of_archive_if_whole(archive: Path) -> list[InputFile]:
    """One damaged archive does not hide the files beside it; reading names it where something is missing."""
    try:
        return _files_of_archive(archive)
    except InputFileError:
        return [input_file(UNREADABLE, archive)]


def _files_of_archive(archive: Path) -> list[InputFile]:
    return [InputFile("", archive, size, member) for member, size in sorted(archive_members(archive).items())]


def _best(present: Sequence[InputFile], names: Sequence[str], role: str) -> InputFile | None:
    candidates = [file for file in present if _name(file) in names]
    if not candidates:
        return None
    best = min(candidates, key=lambda file: _rank(file, names))
    return InputFile(role, best.path, best.size, best.member)


def _rank(file: InputFile, names: Sequence[str]) -> tuple[int, bool, int, bool, str]:
    folder = _folder(file)
    unusual = folder.name not in _USUAL_FOLDERS
    return names.index(_name(file)), unusual, len(folder.parts), bool(file.member), str(folder)


def _name(file: InputFile) -> str:
    return PurePosixPath(file.member).name if file.member else file.path.name


def _folder(file: InputFile) -> PurePosixPath:
    """The folder of a file; an archive counts as one."""
    path = file.path / file.member if file.member else file.path
    return PurePosixPath(path.as_posix()).parent


_ANYTHING = msgspec.json.Decoder()


def read_warnings(path: Source) -> tuple[str, ...]:
    """Read what the operators of a stream warn of; their names vary between versions, and none is required.

    Returns:
        One remark for each operator with the status WARNING.

    Raises:
        InputFileError: if the file is damaged, or an operator reports an ERROR: the stream is then not to be used.
    """
    warnings = []
    for operator, report in _reports(decode_json(path, _ANYTHING)):
        if report["status"] == "ERROR":
            raise InputFileError(
                shown(path),
                operator,
                expected="no operator with the status ERROR",
                found=f"ERROR{_reason(report)}",
                remedy="The services could not compute this stream; leave the recording out, or request it again.",
            )
        if report["status"] == "WARNING":
            warnings.append(f"{shown(path).parent.name}: {operator} warns{_reason(report)}")
    return tuple(warnings)


def _reports(summary: object) -> Iterator[tuple[str, dict]]:
    """Every entry that has a status, with the name of its operator; some operators hold a list of them."""
    if not isinstance(summary, dict):
        return
    for operator, value in summary.items():
        for report in value if isinstance(value, list) else [value]:
            if isinstance(report, dict) and "status" in report:
                yield str(operator), report


def _reason(report: dict) -> str:
    details = [report.get("message"), *report.get("errors", []), *report.get("warnings", [])]
    said = "; ".join(str(detail) for detail in details if detail)
    return f" ({said[:160]})" if said else ""
