"""The outputs of one recording as one body: read, checked against the recording, joined.

Joints are computed once: later reads take them from the user's cache and need no body model.
"""

from __future__ import annotations

import contextlib
import io
import re
import zipfile
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError, StorageError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, read_whole, require_regular
from prbench.files.storage import bytes_digest, cache_folder, sole_file
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import covered
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.files import MODEL_ROLE, OUTPUT_ROLE, parse_output, read_output
from prbench.readers.egoallo.to_recording import joined_windows, window_joints
from prbench.readers.found import RecordingFiles, is_present
from prbench.recording.streams import PoseStream

HOW_TO_GET = (
    "Download the 'Extended SMPL+H model' (16 shape parameters) from https://mano.is.tue.mpg.de/ (free registration)"
    " and give its smplh/neutral/model.npz with --option smplh_model=FILE, in the environment variable"
    " PRBENCH_SMPLH_MODEL, or as smplh/neutral/model.npz below the dataset's root. It is needed once: the joints are"
    " kept."
)
_CONVERT = (
    "Some copies hold Python objects, which prbench never unpickles. If yours is from the official site, convert it"
    " once: python -c \"import numpy as np; m = np.load('model.npz', allow_pickle=True);"
    " np.savez('plain.npz', **{k: np.asarray(m[k].todense() if hasattr(m[k], 'todense') else m[k])"
    " for k in ('J_regressor', 'v_template', 'shapedirs')})\""
)
_KEYS = (ego.REGRESSOR, ego.TEMPLATE, ego.SHAPES)
_GUIDANCE = re.compile(r"^guidance_mode:[ ]*['\"]?(\w+)['\"]?[ ]*$", re.MULTILINE)
_OPTIONS_BYTES = 65536
_VERSION = 1  # of what is kept; raise it when the arithmetic changes


def read_window(path: Path, model: Path | None) -> tuple[ego.BodyWindow, Float[np.ndarray, "t 3"] | None]:
    """Joints of one output file, and the head positions that it was made from (None in files with joints only).

    Args:
        path: The output.
        model: SMPL-H model; None is enough where the joints of exactly these bytes were computed before.

    Raises:
        InputFileError: if the output is damaged (docs/specification/egoallo.md#bad-input), or the model is needed and
        missing or damaged.
    """
    try:
        content = read_whole(path)
    except FileNotFoundError as error:
        raise InputFileError(
            path, "", expected="an output of EgoAllo", found="no such file", remedy="Run `prbench poses egoallo`."
        ) from error
    output = parse_output(path, content)
    if isinstance(output, ego.BodyWindow):
        return output, None
    guidance = _read_guidance(path)
    head = output.world_from_cpf[:, 4:].astype(np.float64)
    samples = len(output.world_from_root)
    kept = cache_folder() / "egoallo" / f"{bytes_digest(content)}.npz"
    wanted = None if model is None else _model_digest(model)
    joints = _kept_joints(kept, wanted, frames=len(output.time_ns))
    if joints is None:
        if model is None or wanted is None:
            raise InputFileError(
                path,
                "",
                expected="the SMPL-H body model, from which joints are computed",
                found="no model, and no joints of this file from an earlier run",
                remedy=HOW_TO_GET,
            )
        joints = window_joints(output, read_smplh_rest(model)).joints
        with contextlib.suppress(StorageError), sole_file(kept) as temporary:  # a full cache costs time, not the build
            np.savez(temporary, version=_VERSION, model=wanted, joints=joints)
    return ego.BodyWindow(path.name, output.time_ns, joints, samples, guidance), head


def _read_guidance(path: Path) -> str:
    """``guidance_mode`` of an output, from the options beside it; empty where they are missing or say nothing.

    The file is YAML that may name Python objects: it is looked at as text and never loaded.
    """
    options = path.with_name(f"{path.stem}{ego.ARGUMENTS_SUFFIX}")
    if not is_present(options):
        return ""
    require_regular(options)
    with open(options, "rb") as file:
        text = file.read(_OPTIONS_BYTES).decode("utf-8", errors="replace")
    found = _GUIDANCE.search(text)
    return found[1] if found else ""


def _model_digest(path: Path) -> str:
    """SHA-256 of the rest joints' template and directions, which tells two models apart.

    Raises:
        InputFileError: see :func:`read_smplh_rest`.
    """
    rest = read_smplh_rest(path)
    return bytes_digest(np.ascontiguousarray(rest.template).tobytes() + np.ascontiguousarray(rest.directions).tobytes())


@foreign_input()
def read_smplh_rest(path: Path) -> ego.SmplhRest:
    """Rest joints of the model, linear in the shape; of its 52 joints the first 22.

    Raises:
        InputFileError: if the file is missing, damaged, lacks a key, or holds arrays of other shapes or objects.
    """
    path = path.expanduser()
    try:
        state = path.stat()
    except OSError as error:
        raise InputFileError(
            path, "", expected="the SMPL-H body model", found="no such file", remedy=HOW_TO_GET
        ) from error
    return _read((path, state.st_size, state.st_mtime_ns))


@lru_cache(maxsize=4)
def _read(state: tuple[Path, int, int]) -> ego.SmplhRest:
    """Read once a process; size and time of change make a changed file another one."""
    path = state[0]
    archive = Archive(path, remedy=f"Copy or download it again. {_CONVERT}")
    missing = [key for key in _KEYS if key not in archive.members]
    if missing:
        raise InputFileError(
            path,
            "",
            expected=f"an array '{missing[0]}'",
            found=", ".join(archive.members) or "nothing",
            remedy=f"This is no SMPL-H model. {HOW_TO_GET}",
        )
    arrays = archive.load(_KEYS)
    for key, axes in zip(_KEYS, (2, 2, 3), strict=True):
        if arrays[key].ndim != axes or arrays[key].dtype.kind not in "fiu":
            found = f"shape {arrays[key].shape} of {arrays[key].dtype}"
            raise InputFileError(path, key, expected=f"numbers with {axes} axes", found=found, remedy=HOW_TO_GET)
    regressor, template, shapes = (arrays[key].astype(np.float64) for key in _KEYS)
    points = regressor.shape[1]
    for key, array, shape in (
        (ego.REGRESSOR, regressor, (ego.N_MODEL_JOINTS, points)),
        (ego.TEMPLATE, template, (points, 3)),
        (ego.SHAPES, shapes[..., : ego.N_BETAS], (points, 3, ego.N_BETAS)),
    ):
        if array.shape != shape or not np.isfinite(array).all():
            raise InputFileError(
                path,
                key,
                expected="52 joints, as many points everywhere, at least 16 shapes, finite numbers (SMPL-H, extended)",
                found=f"the shape {arrays[key].shape}",
                remedy=HOW_TO_GET,
            )
    # The first 22 of the 52 joints are those of the body; the others are fingers.
    body = regressor[:22]
    return ego.SmplhRest(body @ template, np.einsum("jv,vkb->jkb", body, shapes[:, :, : ego.N_BETAS]))


def _kept_joints(kept: Path, wanted: str | None, *, frames: int) -> np.ndarray | None:
    """Joints from the cache, if they are whole and of the wanted model (of any model where none is given)."""
    try:
        with np.load(io.BytesIO(kept.read_bytes()), allow_pickle=False) as file:
            version = int(file["version"])
            model = str(file["model"])
            joints = file["joints"]
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        if not isinstance(error, FileNotFoundError):
            with contextlib.suppress(OSError):  # a damaged entry is dropped where that is possible, and made again
                kept.unlink(missing_ok=True)
        return None
    fits = version == _VERSION and joints.shape == (frames, 22, 3) and joints.dtype == np.float32
    return joints if fits and wanted in (None, model) else None


_MARGIN = 1.0  # seconds
_REMEDY = "Move it to the recording it was made from, or delete it and run `prbench poses egoallo` again."


def check_output(path: Path, cpf: PoseStream) -> Int[np.ndarray, " t"]:
    """Read an output and check that it belongs to a recording; no body model is needed.

    Args:
        path: The output.
        cpf: See :func:`_require_belongs`.

    Returns:
        Its times, nanoseconds on the device clock.

    Raises:
        InputFileError: if the output is damaged, or belongs to another recording.
    """
    output = read_output(path)
    if isinstance(output, ego.BodyWindow):
        _require_belongs(path, output.time_ns, output.joints[:, Joint.HEAD].astype(np.float64), cpf, exact=False)
    else:
        _require_belongs(path, output.time_ns, output.world_from_cpf[:, 4:].astype(np.float64), cpf, exact=True)
    return output.time_ns


def _require_belongs(
    path: Path, time_ns: Int[np.ndarray, " t"], points: Float[np.ndarray, "t 3"], cpf: PoseStream, *, exact: bool
) -> None:
    """Refuse an output of another recording: the head pose is an input of EgoAllo and must come back.

    Args:
        path: The output, for the message.
        time_ns: Its times on the device clock.
        points: The central pupil frame in the output, or its head joint.
        cpf: The recording's central pupil frame, in the world that the output is in, device seconds.
        exact: Whether ``points`` are the central pupil frame; the limit for head joints is wider.

    Raises:
        InputFileError: if no frame falls into the recording's time, or the median distance is above 5 cm.
    """
    times = time_ns / 1e9
    whole = cpf
    # The part of a trajectory that can matter for some times: a recording has hundreds of outputs to compare.
    first, last = np.searchsorted(cpf.times, [times[0] - _MARGIN, times[-1] + _MARGIN])
    rows = slice(max(int(first) - 1, 0), int(last) + 1)
    cpf = PoseStream(cpf.times[rows], cpf.position[rows], cpf.rotation[rows], cpf.valid[rows])
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP)
    during = (times >= whole.times[0]) & (times <= whole.times[-1])
    if during.any() and not posed.any():
        return  # all of it lies in a gap of the trajectory: nothing tells, and its frames become invalid
    if not posed.any():
        raise InputFileError(
            path,
            ego.TIMES,
            expected=f"times of this recording, {whole.times[0]:.3f} … {whole.times[-1]:.3f} s on the device clock",
            found=f"{times[0]:.3f} … {times[-1]:.3f} s: the output belongs to another recording",
            remedy=_REMEDY,
        )
    expected, _ = cpf.pose_at(times[posed])
    limit = ego.LARGEST_CPF_ERROR if exact else ego.LARGEST_HEAD_ERROR
    distance = float(np.median(np.linalg.norm(points[posed] - expected, axis=1)))
    if not distance <= limit:
        raise InputFileError(
            path,
            ego.WORLD_FROM_CPF if exact else ego.JOINTS,
            expected=f"head poses of this recording at the same times, to {limit * 100:.0f} cm",
            found=f"a median distance of {distance * 100:.1f} cm: the output belongs to another recording or world",
            remedy=_REMEDY,
        )


def read_bodies(found: RecordingFiles, *, cpf: PoseStream) -> ego.EgoAlloBody | None:
    """The body of one recording from its output files (:func:`find_outputs` put them into ``found``).

    Args:
        found: The recording's files.
        cpf: Poses of the glasses' central pupil frame in the *source* world (that of the trajectory which EgoAllo was
            given, Z up), times in device seconds.

    Returns:
        Joints in the source world, on the device clock; None where there are no outputs.

    Raises:
        InputFileError: if an output is damaged, or belongs to another recording; or if joints must be computed and the
            body model is missing or damaged.
    """
    outputs = [file.path for file in found.files if file.role.startswith(OUTPUT_ROLE)]
    model = found.path(MODEL_ROLE)
    windows = []
    for path in outputs:
        window, head = read_window(path, model)
        points = window.joints[:, Joint.HEAD].astype(np.float64) if head is None else head
        _require_belongs(path, window.time_ns, points, cpf, exact=head is not None)
        windows.append(window)
    return joined_windows(windows)
