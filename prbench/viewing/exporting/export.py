"""``prbench export-motion``: the motions of a run or a table, one file each, whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import msgspec

from prbench.errors import RedistributionError, StorageError, UsageError
from prbench.files.storage import atomic_folder, require_replaceable, sole_file, sole_writer, text_digest, write_json
from prbench.geometry.skeleton import Joint
from prbench.harness.run_folder import RunFolder
from prbench.progress_bar import ProgressCallback
from prbench.sequences.dataset_info import FILE_NAME
from prbench.viewing.exporting.skeleton import pose_skeleton
from prbench.viewing.replay.scene import RECORDED, Scene, ShownMotion
from prbench.viewing.view import ViewRequest, scenes_of

Form = Literal["bvh", "glb", "npz"]
MANIFEST = "motions.json"
_LONGEST_NAME = 60  # letters of an id in the name of a file


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """The motions that a user wants, and the form.

    Attributes:
        source: A run, or a table, whose recorded motion is meant.
        out: The file; a folder where there are several.
        form: Format, which is the suffix of the files, too.
        data: Tables of the run.
        sequences: Ids, or parts of ids that fit one sequence only.
        limit: Largest number of sequences of each dataset where none is named.
        sample: Number of the motion, for runs that drew several.
        recorded: The recorded motion, too, in a second file.
        unit: Unit of BVH, a key of :data:`prbench.viewing.exporting.bvh.UNITS`.
        permitted: Datasets for which the user has permission to pass recorded motion on.
    """

    source: Path
    out: Path
    form: Form
    data: tuple[Path, ...] = ()
    sequences: tuple[str, ...] = ()
    limit: int | None = None
    sample: int = 0
    recorded: bool = False
    unit: str = "m"
    permitted: Collection[str] = ()


class ExportedMotion(msgspec.Struct, frozen=True, kw_only=True):
    """One file that was written.

    Attributes:
        file: Its name.
        sequence_id: Id of the sequence.
        dataset: Name of the dataset.
        motion: The method and its condition, or ``ground truth``.
        fps: Frames a second.
        n_frames: Number of frames.
        error_mm: Mean distance of each joint in the file from the motion, where bones have a constant length in the
            file and not in the motion; millimetres.
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
        left_out: Datasets whose recorded motion, gaze and goals their licence keeps, and which are not in the files.
    """

    out: Path
    motions: list[ExportedMotion]
    left_out: list[str]


def export_motion(request: ExportRequest, progress: ProgressCallback = lambda *_: None) -> ExportReport:
    """Write motions, one file each.

    Raises:
        UsageError: if the output's name does not fit, or a sequence is unknown or left out by the run.
        RunError: if the run has no predictions, was made on another table, or its scores are not those of its motions.
        RedistributionError: if a licence keeps all that would be written.
        StorageError: if the output cannot be written or holds something else.
    """
    scenes, left_out = _scenes(request)
    work = [(scene, motion) for scene in scenes for motion in _wanted(request, scene)]
    _require_fitting_name(request.out, request.form, len(work))
    motions = []

    def write_all(place: Path, names: list[str]) -> None:
        for (scene, motion), name in zip(work, names, strict=True):
            path = place / name if len(work) > 1 else place
            motions.append(_write(request, scene, motion, path, name))
            progress(len(motions), len(work), scene.sequence_id)

    if len(work) == 1:
        with sole_file(request.out) as temporary:
            write_all(temporary, [request.out.name])
        return ExportReport(out=request.out, motions=motions, left_out=left_out)
    names = [file_name(scene.sequence_id, motion.label == RECORDED, request) for scene, motion in work]
    with sole_writer(request.out), atomic_folder(request.out) as folder:
        write_all(folder, names)
        write_json(folder / MANIFEST, {"motions": msgspec.to_builtins(motions), "left_out": left_out})
    return ExportReport(out=request.out, motions=motions, left_out=left_out)


def _scenes(request: ExportRequest) -> tuple[list[Scene], list[str]]:
    """Read the sequences without what their licences keep, and name the datasets of which something is left out."""
    run = None if (request.source / FILE_NAME).is_file() else RunFolder.open(request.source)
    data = (request.source,) if run is None else request.data
    view = ViewRequest(
        out=request.out, runs=() if run is None else (request.source,), data=data, sequences=request.sequences,
        limit=request.limit, sample=request.sample, permitted=request.permitted,
    )  # fmt: skip
    scenes = []
    left_out = set()
    for scene in scenes_of(view):
        assert scene.info is not None, "read from a table"
        if scene.info.redistribution == "yes" or scene.dataset in request.permitted:
            scenes.append(scene)
            continue
        # A file is made to be passed on, so that terms such as non-commercial need the user's word, too. Controls are
        # made of recorded motion.
        generated = tuple(motion for motion in scene.motions if motion.label != RECORDED)
        if not generated or request.recorded or run is None or run.record.method.kind == "control":
            raise RedistributionError(
                f"{scene.info.title} ({scene.dataset}): its licence ({scene.info.licence}) restricts who may be given"
                " recorded motion and goals, and the files would hold them. If you keep to it, or have the licensor's"
                f" permission, say so: --permission {scene.dataset}"
            )
        left_out.add(scene.dataset)
        scenes.append(replace(scene, motions=generated, goal=None))
    return scenes, sorted(left_out)


def _wanted(request: ExportRequest, scene: Scene) -> tuple[ShownMotion, ...]:
    """Return the motions that get a file: the generated ones, and the recorded one where it is asked for or alone."""
    generated = tuple(motion for motion in scene.motions if motion.label != RECORDED)
    return scene.motions if request.recorded or not generated else generated


def _require_fitting_name(out: Path, form: str, n_files: int) -> None:
    """Refuse, before anything is written, an output that is no file, or no folder, where one is needed."""
    is_file = out.suffix.lower() == f".{form}"
    if n_files == 1 and not is_file:
        raise UsageError(f"{out}: expected a file that ends in .{form}, found '{out.suffix or 'no suffix'}'.")
    if n_files == 1 and out.is_dir():
        raise StorageError(f"{out}: is a folder. Choose a file for --out.")
    if n_files > 1 and is_file:
        raise UsageError(f"{out}: expected a folder for {n_files} motions, found a file's name. Leave .{form} out.")
    if n_files > 1:
        require_replaceable(out, MANIFEST, kind="export of motions")


def file_name(sequence_id: str, recorded: bool, request: ExportRequest) -> str:
    """Return a name that every file system takes: the id's letters and digits, and eight of its digest."""
    words = re.sub(r"[^A-Za-z0-9]+", "-", sequence_id).strip("-")[:_LONGEST_NAME]
    which = "-recorded" if recorded and request.recorded else ""
    return f"{words}-{text_digest(sequence_id)[:8]}{which}.{request.form}"


def _write(request: ExportRequest, scene: Scene, motion: ShownMotion, path: Path, name: str) -> ExportedMotion:
    """Write one file, and say what is in it."""
    assert scene.info is not None, "read from a table"
    said = ExportedMotion(
        file=name, sequence_id=scene.sequence_id, dataset=scene.dataset, motion=motion.label, fps=scene.fps,
        n_frames=scene.n_frames, notice=scene.notice, licence=scene.info.licence, citation=scene.info.citation,
    )  # fmt: skip
    about: dict[str, Any] = msgspec.to_builtins(said)
    about |= {"prime_time": scene.prime_time, "event_time": scene.event_time, "homepage": scene.info.homepage}
    if request.form == "npz":
        from prbench.viewing.exporting.arrays import write_arrays

        write_arrays(scene, motion, path, about)
        return said
    posed = pose_skeleton(motion.joints)
    millimetres = 1000 * posed.error
    if request.form == "bvh":
        from prbench.viewing.exporting.bvh import write_motion_bvh

        write_motion_bvh(posed, path, fps=scene.fps, unit=request.unit)
    else:
        from prbench.viewing.exporting.glb import write_glb

        write_glb(scene, motion, posed, path, about)
    per_joint = dict(zip((joint.name.lower() for joint in Joint), millimetres.mean(axis=0).round(3).tolist()))
    largest = round(float(millimetres.max()), 3)
    return msgspec.structs.replace(said, error_mm=per_joint, largest_error_mm=largest)
