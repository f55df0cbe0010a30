"""Find out from a file's ends alone if it is whole: an interrupted download or a full disk leaves it cut off.

None of this parses a file; a file that passes may still be refused when it is read.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import msgspec

from prbench.errors import InputFileError
from prbench.files.arrays import map_array, read_header
from prbench.files.bounded import foreign_input, read_end, read_whole, require_size
from prbench.limits import LARGEST_UNPACKED, LONGEST_LINE
from prbench.readers.found import InputFile

_TAIL = 65536  # bytes; longer than any line of the formats that are read


def damage(file: InputFile) -> str:
    """Say in a few words what is wrong with an input file; empty if nothing seems to be."""
    try:
        with foreign_input(file.path):
            return _damage(file)
    except InputFileError as error:
        return f"cannot be read ({error.found})"


def _damage(file: InputFile) -> str:
    require_size(file.path, largest=LARGEST_UNPACKED)
    if file.path.stat().st_size == 0:
        return "empty"
    if file.member or zipfile.is_zipfile(file.path) or file.path.suffix in (".zip", ".npz"):
        return _damaged_archive(file)
    check = _CHECKS.get(file.path.suffix.lower())
    return "" if check is None else check(file.path)


def _damaged_archive(file: InputFile) -> str:
    """The table of contents stands at the end of a zip file, so a cut one has none."""
    try:
        with zipfile.ZipFile(file.path) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile:
        return "cut off: an archive without table of contents"
    return f"holds no '{file.member}'" if file.member and file.member not in names else ""


def _damaged_csv(path: Path) -> str:
    with open(path, "rb") as lines:
        columns = lines.readline(LONGEST_LINE).count(b",")
    last = _last_line(path)
    if last.endswith((b"\n", b"\r")) or last.count(b",") == columns:
        return ""
    return f"cut off: its last line has {last.count(b',') + 1} of {columns + 1} values"


def _damaged_json(path: Path) -> str:
    end = read_end(path, _TAIL).rstrip()[-1:]
    return "" if end in (b"}", b"]") else "cut off: it does not end with a closing bracket"


def _damaged_json_lines(path: Path) -> str:
    try:
        msgspec.json.decode(_last_line(path))
    except (msgspec.DecodeError, UnicodeDecodeError):
        return "cut off: its last line is no JSON"
    return ""


def _damaged_hdf5(path: Path) -> str:
    try:
        with h5py.File(path, "r"):
            return ""
    except OSError as error:
        return "cut off" if "truncated" in str(error) else "no HDF5 file"


def _damaged_npy(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            map_array(path, read_header(file, path, ""))
    except InputFileError as error:
        return f"cut off or no array ({error.found})"
    return ""


def _damaged_glb(path: Path) -> str:
    with open(path, "rb") as file:
        start = file.read(12)
    if start[:4] != b"glTF":
        return "no binary glTF file"
    length = int.from_bytes(start[8:12], "little")
    return "" if length == path.stat().st_size else f"cut off: {path.stat().st_size} of {length} bytes"


def _damaged_bvh(path: Path) -> str:
    """The motion part says how many frames follow."""
    hierarchy, _, motion = read_whole(path).partition(b"MOTION")
    lines = motion.splitlines()[1:]
    promised = next((line.split()[-1] for line in lines if line.startswith(b"Frames:")), b"")
    # The first byte of an empty line, which is none, is "in" any text; hence the second test.
    frames = sum(1 for line in lines if line[:1] in b"-0123456789 " and line.strip())
    if not hierarchy or not promised.isdigit():
        return "cut off: it has no motion"
    return "" if frames >= int(promised) else f"cut off: {frames} of {int(promised)} frames"


def _damaged_pickle(path: Path) -> str:
    return "" if read_end(path, _TAIL).endswith(b".") else "cut off: it does not end with a stop mark"


def _last_line(path: Path) -> bytes:
    lines = read_end(path, _TAIL).splitlines(keepends=True)
    return lines[-1] if lines else b""


_CHECKS: dict[str, Callable[[Path], str]] = {
    ".csv": _damaged_csv,
    ".json": _damaged_json,
    ".jsonl": _damaged_json_lines,
    ".hdf5": _damaged_hdf5,
    ".h5": _damaged_hdf5,
    ".npy": _damaged_npy,
    ".glb": _damaged_glb,
    ".bvh": _damaged_bvh,
    ".pkl": _damaged_pickle,
}
