"""``prbench export-motion``: the motions of a run or a table, one file each, whole or not at all."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from prbench.errors import UsageError
from prbench.files.storage import atomic_folder, require_replaceable, sole_file, sole_writer, text_digest, write_json
from prbench.geometry.skeleton import Joint
from prbench.sequences.dataset_info import may_pass_on, require_may_pass_on
from prbench.viewing.replay.scene import Progress, Scene
from prbench.viewing.view import ViewRequest, file_kind, scenes_of

# Maps each format to the suffix of its files. Its module of this package has the same name and a function ``write``.
SUFFIXES = {"bvh": ".bvh", "glb": ".glb", "npz": ".npz", "smpl": ".npz", "rrd": ".rrd", "mp4": ".mp4"}
_SHOWS_SEVERAL = ("rrd", "mp4")  # motions beside one another
MANIFEST = "motions.json"
_LONGEST_NAME = 60  # letters of an id in the name of a file


@dataclass(frozen=True, kw_only=True)
class ExportRequest(ViewRequest):
    """The motions that a user wants: of one run, or of a table the recorded ones.

    Attributes:
        out: The file; a folder where several are written.
        form: Format, a key of :data:`SUFFIXES`.
        recorded: The recorded motion of a run's sequences, too.
        unit: Unit of BVH, a key of :data:`prbench.viewing.exporting.bvh.UNITS`.
        body_model: The user's SMPL, SMPL-H or SMPL-X, for the format ``smpl``.
        recordings: Those that the table was built from, whose streams an ``rrd`` holds, too.
        video: An egocentric video onto which ``mp4`` draws gaze and goal.
        calibration: Its camera, in the layout of HD-EPIC's ``device_calibration.json``.
    """

    out: Path  # pyright: ignore[reportGeneralTypeIssues] # nothing stands for it, unlike in a view
    form: str
    recorded: bool = False
    unit: str = "m"
    body_model: Path | None = None
    recordings: Path | None = None
    video: Path | None = None
    calibration: Path | None = None


class ExportedMotion(msgspec.Struct, frozen=True, kw_only=True):
    """One file that was written.

    Attributes:
        file: Its name.
        sequence_id: Id of the sequence.
        dataset: Name of the dataset.
        motion: The method and its condition, or ``ground truth``.
        fps: Frames a second.
        n_frames: Number of frames.
        error_mm: Mean distance of each joint in the file from the motion, millimetres; not 0 where bones change their
            length, or a body model has others. Empty for formats that hold positions.
        largest_error_mm: The largest of any joint and frame.
        notice: Sentence that the dataset's terms ask for.
        licence: Licence of the dataset.
        citation: BibTeX of what is to be cited.
    """

    file: str
    sequence_id: str
    dataset: str
    motion: str
    fps: float
    n_frames: int
    error_mm: dict[str, float] = {}
    largest_error_mm: float = 0.0
    notice: str
    licence: str
    citation: str


class ExportReport(msgspec.Struct, frozen=True, kw_only=True):
    """The files that were written.

    Attributes:
        out: The file, or the folder with them and ``motions.json``, which lists them as this report does.
        motions: One entry a file.
        left_out: Datasets whose recorded motion and goals their licence keeps, and which are not in the files.
    """

    out: Path
    motions: list[ExportedMotion]
    left_out: list[str]


def export_motion(request: ExportRequest, progress: Progress = lambda *_: None) -> ExportReport:
    """Write motions, one file each.

    Raises:
        UsageError: if options do not fit together, or a sequence is unknown or left out by the run.
        InputFileError: if the body model or a recording cannot be read.
        RunError: if the run has no predictions, was made on another table, or its scores are not those of its motions.
        RedistributionError: if a licence keeps what would be written.
        MissingExtraError: if the format needs a package that is not installed.
        StorageError: if the output cannot be written or holds something else.
    """
    form = request.form
    for option, value, needed in (
        ("--body-model", request.body_model, "smpl"),
        ("--root", request.recordings, "mp4" if request.video else "rrd"),
        ("--video", request.video, "mp4"),
    ):
        if value is not None and form != needed:
            raise UsageError(f"{option}: belongs to --format {needed}; leave it out for {form}.")
    if form == "mp4":
        file_kind(Path("film.mp4"))  # says what to install before minutes of reading
    work = []
    kept = set()
    for scene in scenes_of(request):
        info: Any = scene.info
        # A file is made to be passed on, so that terms such as non-commercial need the user's word, too.
        terms: dict[str, Any] = {"permitted": request.permitted, "published": True}
        if not may_pass_on(info, **terms):
            methods = tuple(motion for motion in scene.motions if motion.kind == "method")
            if not methods or request.recorded or request.recordings is not None:
                require_may_pass_on(info, "the files", **terms)
            kept.add(scene.dataset)
            scene = replace(scene, motions=methods, goal=None)
        # Recorded motion gets a file of its own where it is asked for, or where there is no other.
        generated = tuple(motion for motion in scene.motions if motion.kind != "recorded")
        motions = scene.motions if request.recorded or not generated else generated
        parts = [motions] if form in _SHOWS_SEVERAL else [(motion,) for motion in motions]
        work += [replace(scene, motions=part) for part in parts]
    left_out = sorted(kept)
    out = request.out
    suffix = SUFFIXES[form]
    if (out.suffix.lower() == suffix) != (len(work) == 1):
        wanted = f"a file that ends in {suffix}" if len(work) == 1 else f"a folder for {len(work)} files"
        raise UsageError(f"{out}: expected {wanted}, found '{out.suffix or 'no suffix'}'.")
    if len(work) == 1:
        with sole_file(out) as temporary:
            motions = [_write(request, work[0], temporary, out.name)]
        return ExportReport(out=out, motions=motions, left_out=left_out)
    require_replaceable(out, MANIFEST, kind="export of motions")
    motions = []
    with sole_writer(out), atomic_folder(out) as folder:
        for scene in work:
            name = file_name(scene.sequence_id, suffix, recorded=scene.shows_recorded and request.recorded)
            motions.append(_write(request, scene, folder / name, name))
            progress(len(motions), len(work), scene.sequence_id)
        write_json(folder / MANIFEST, {"motions": msgspec.to_builtins(motions), "left_out": left_out})
    return ExportReport(out=out, motions=motions, left_out=left_out)


def file_name(sequence_id: str, suffix: str, *, recorded: bool = False) -> str:
    """Return a name that every file system takes: the id's letters and digits, and eight of its digest."""
    words = re.sub(r"[^A-Za-z0-9]+", "-", sequence_id)[:_LONGEST_NAME].strip("-")
    return f"{words}-{text_digest(sequence_id)[:8]}{'-recorded' if recorded else ''}{suffix}"


def _write(request: ExportRequest, scene: Scene, path: Path, name: str) -> ExportedMotion:
    """Write one file, and say what is in it."""
    info: Any = scene.info
    about: dict[str, Any] = {"sequence_id": scene.sequence_id, "dataset": scene.dataset}
    about |= {"motion": ", ".join(motion.label for motion in scene.motions), "fps": scene.fps}
    about |= {"n_frames": scene.n_frames, "notice": scene.notice, "licence": info.licence, "citation": info.citation}
    said = ExportedMotion(file=name, **about)
    about |= {"prime_time": scene.prime_time, "event_time": scene.event_time, "homepage": info.homepage}
    # Imported here, because torch and rerun take seconds.
    error = import_module(f"prbench.viewing.exporting.{request.form}").write(scene, path, about, request)
    if error is None:
        return said
    means = (1000 * error.mean(axis=0)).round(3).tolist()
    per_joint = dict(zip((joint.name.lower() for joint in Joint), means, strict=True))
    return msgspec.structs.replace(said, error_mm=per_joint, largest_error_mm=round(1000 * float(error.max()), 3))
