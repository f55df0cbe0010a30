"""Find EgoAllo's outputs and its body model."""

from __future__ import annotations

import os
import zipfile
import zlib
from pathlib import Path

import numpy as np

from prbench.limits import LARGEST_UNPACKED_FOR_ITS_END
from prbench.readers.egoallo import format as ego
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present

OUTPUT_ROLE = "egoallo/"
"""Roles of output files are this and the file's name."""
_OPTIONS_ROLE = "egoallo options/"
"""Roles of the options beside them, likewise."""
MODEL_ROLE = "smplh_model"
_MODEL_VARIABLE = "PRBENCH_SMPLH_MODEL"


def poses_folder(root: Path, recording_id: str, poses_root: Path | None = None) -> Path:
    """Return the folder of a recording's outputs: below ``poses_root``, else ``root/egoallo``."""
    base = root / ego.POSES_FOLDER if poses_root is None else poses_root.expanduser()
    return base / recording_id / ego.OUTPUT_FOLDER


def find_outputs(
    root: Path,
    folder: Path | None,
    recording_id: str,
    poses_root: Path | None = None,
    *,
    smplh_model: Path | None = None,
) -> tuple[InputFile, ...]:
    """Output files of one recording, and the body model where there is one; nothing where there are no outputs.

    Of several places the first with outputs counts: the recording's folder in ``poses_root`` if that is given, the
    recording's own folder, the recording's folder in ``root/egoallo``.

    Args:
        root: The dataset's folder.
        folder: The recording's own folder; None where it has none (archives).
        recording_id: Name of the recording.
        poses_root: Where the user keeps poses.
        smplh_model: The body model; the environment's or the one below ``root`` by default.

    Returns:
        Files with the roles ``egoallo/<file name>``, ``egoallo options/<file name>`` and ``smplh_model``.
    """
    places = [poses_folder(root, recording_id, poses_root)] if poses_root is not None else []
    places += [folder / ego.OUTPUT_FOLDER] if folder is not None else []
    places.append(poses_folder(root, recording_id))
    for place in places:
        outputs = _outputs(place)
        if outputs:
            model = find_model(root, smplh_model)
            files = [input_file(f"{OUTPUT_ROLE}{path.name}", path) for path in outputs]
            options = [path.with_name(f"{path.stem}{ego.ARGUMENTS_SUFFIX}") for path in outputs]
            files += [input_file(f"{_OPTIONS_ROLE}{path.name}", path) for path in options if is_present(path)]
            return (*files, *([input_file(MODEL_ROLE, model)] if model is not None and is_present(model) else []))
    return ()


def _outputs(folder: Path) -> list[Path]:
    """The output files of a folder; where options outnumber them, the missing ones too, and reading them says so."""
    found = {path for path in folder.glob("*.npz") if not path.name.startswith(".")}
    options = [path for path in folder.glob(f"*{ego.ARGUMENTS_SUFFIX}") if not path.name.startswith(".")]
    if not found or len(options) <= len(found):
        return sorted(found)
    return sorted(found | {path.with_name(f"{path.name.removesuffix(ego.ARGUMENTS_SUFFIX)}.npz") for path in options})


def find_model(root: Path, smplh_model: Path | None = None) -> Path | None:
    """The body model: the given one, else that of ``PRBENCH_SMPLH_MODEL``, else ``root/smplh/neutral/model.npz``.

    Returns:
        A path that the user named, whether it exists or not; of the place below ``root`` only an existing file.
    """
    named = smplh_model or (Path(os.environ[_MODEL_VARIABLE]) if os.environ.get(_MODEL_VARIABLE) else None)
    if named is not None:
        return named.expanduser()
    beside = root / ego.MODEL_FILE
    return beside if is_present(beside) else None


def body_extent(found: RecordingFiles) -> Extent | None:
    """All outputs of a recording together, on the device clock; None without outputs that can be read."""
    times = {file.path: _times(file.path) for file in found.files if file.role.startswith(OUTPUT_ROLE)}
    known = [each for each in times.values() if each.size]
    if not known:
        return None
    first = min(float(each.min()) for each in known)
    latest = max((path for path in times if times[path].size), key=lambda path: float(times[path].max()))
    return Extent(
        "body by EgoAllo",
        latest.name,
        first / 1e9,
        float(times[latest].max()) / 1e9,
        tells_span=False,
        slack=SEVERAL_SENSORS,
    )


def _times(path: Path) -> np.ndarray:
    """Times of one output, nanoseconds; none of a damaged one, which is told by whoever reads it."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{ego.TIMES}.npy") as member:
            if archive.getinfo(f"{ego.TIMES}.npy").file_size > LARGEST_UNPACKED_FOR_ITS_END:
                return np.zeros(0)
            return np.lib.format.read_array(member, allow_pickle=False)  # type: ignore[arg-type] - any file works
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return np.zeros(0)
