"""HumanML3D as a corpus: its groups of motions, and captioned parts as clips, each placed or left out with a reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input, read_text
from prbench.files.storage import file_digest, text_digest
from prbench.protocol.manifests import Manifest, load_manifest
from prbench.readers import SYNTHETIC_PREFIX, ReaderOptions, parse_options, read_synthetic_tree
from prbench.sequences.corpus import Annotation, Caption, Clip
from prbench_adapters.corpora.humanml3d import files as layout
from prbench_adapters.corpora.humanml3d.files import TextLine, read_joints, read_texts
from prbench_adapters.corpora.sources import (
    ClipLimits,
    CorpusOptions,
    Cost,
    ReadRecording,
    RecordingIdentity,
    cut_motion,
    without_folders,
)

_WHOLE = "caption"
_PART = "sub_caption"


def clips_of(
    identity: RecordingIdentity,
    joints: Float[np.ndarray, "frames 22 3"],
    lines: Sequence[TextLine],
    limits: ClipLimits,
    manifest: Manifest,
) -> tuple[tuple[Clip, ...], tuple[Annotation, ...]]:
    """Clips of one motion, and what became of every caption.

    Captions of the same part of the motion share a clip; parts are cut at 20 frames a second as the official loader
    does, ``motion[int(from * 20) : int(to * 20)]``.

    Args:
        identity: Whose clips they are.
        joints: Of the whole motion, metres, Y up.
        lines: Captions in file order.
        limits: Lengths of clips.
        manifest: Of the dataset.
    """
    clips = []
    annotations = []
    for (start, end), members in _by_span(lines, len(joints) / layout.RATE).items():
        kind = _WHOLE if members[0][1].is_whole else _PART
        name = f"{identity.dataset}/{identity.recording_id}/{kind}/{round(start * 1e6)}-{round(end * 1e6)}"
        sequence_id = f"{name}/{manifest.body.pose_source}"
        captions = tuple(dict.fromkeys(Caption(line.text, kind, line.tokens) for _, line in members if line.text))
        first = int(start * layout.RATE)
        available = min(int(end * layout.RATE), len(joints)) - first
        outcome, value, threshold = _fate(captions, start, end, available, limits)
        if outcome == "clip":
            n_frames = min(available, limits.longest)
            clip = _clip(sequence_id, identity, kind, captions, joints, first, n_frames, (start, end), limits, manifest)
            outcome = "no_heading" if clip is None else "clip"
            clips += [] if clip is None else [clip]
        seen: set[str] = set()
        for number, line in members:
            if not line.text:
                own = "no_text"
            elif line.text in seen:
                own = "duplicate"
            else:
                own = outcome
            seen.add(line.text)
            decided = own == outcome
            annotations.append(
                Annotation(
                    annotation_id=f"{identity.dataset}/{identity.recording_id}/{number}",
                    recording_id=identity.recording_id,
                    sequence_id=sequence_id if own == "clip" else None,
                    kind=kind,
                    text=line.text,
                    text_start=start,
                    text_end=end,
                    outcome=own,
                    value=value if decided else None,
                    threshold=threshold if decided else None,
                )
            )
    return tuple(clips), tuple(annotations)


def _by_span(lines: Sequence[TextLine], duration: float) -> dict[tuple[float, float], list[tuple[int, TextLine]]]:
    """Lines of one span together, whole motions first."""
    spans: dict[tuple[float, float], list[tuple[int, TextLine]]] = {}
    for number, line in sorted(enumerate(lines, start=1), key=lambda item: (not item[1].is_whole, item[0])):
        spans.setdefault((0.0, duration) if line.is_whole else (line.start, line.end), []).append((number, line))
    return spans


def _fate(
    captions: tuple[Caption, ...], start: float, end: float, available: int, limits: ClipLimits
) -> tuple[str, float | None, float | None]:
    if not captions:
        return "no_text", None, None
    if end <= start:
        return "end_before_start", end - start, 0.0
    if available <= 0 or start < 0.0:
        return "outside_motion", float(available) / limits.fps, 0.0
    if available < limits.shortest:
        return "too_short", available / limits.fps, limits.shortest / limits.fps
    return "clip", None, None


def _clip(
    sequence_id: str,
    identity: RecordingIdentity,
    kind: str,
    captions: tuple[Caption, ...],
    joints: np.ndarray,
    first: int,
    n_frames: int,
    span: tuple[float, float],
    limits: ClipLimits,
    manifest: Manifest,
) -> Clip | None:
    try:
        motion = cut_motion(joints, first, 1, n_frames)
    except ValueError:
        return None
    start = first / layout.RATE
    return Clip(
        sequence_id=sequence_id,
        **vars(identity),
        kind=kind,
        captions=captions,
        fps=limits.fps,
        n_frames=n_frames,
        start_time=start,
        end_time=start + n_frames / limits.fps,
        text_start=span[0],
        text_end=span[1],
        # Cut only where a whole frame more was described; less than one is lost by rounding down.
        cut=span[1] * layout.RATE - first >= n_frames + 1,
        mirrored=identity.recording_id.startswith(layout.MIRROR_PREFIX),
        clock_method="same",
        clock_offset=0.0,
        clock_quality=None,
        approximate=False,
        pose_source=manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        **vars(motion),
    )


_BYTES_A_SECOND = 3.6e6
_TABLE_SHARE = 2.7
_UNKNOWN_PERSON = "unknown"
_FILES_OF_A_GROUP = 2  # last digits that the names of a group do not share: a hundred motions
_MAKE_JOINTS = (
    "The notebooks of the dataset's repository write new_joints beside new_joint_vecs; run them again."
    " Turning features into joints is no part of this command."
)
Split = Literal["train", "validation", "test"]


@dataclass(frozen=True)
class MotionFiles:
    """The files of one motion; None where one is missing."""

    name: str
    joints: Path | None
    features: Path | None
    texts: Path | None

    @property
    def used(self) -> tuple[Path, ...]:
        """Files that a clip depends on."""
        return tuple(path for path in (self.joints, self.texts) if path is not None)


@dataclass(frozen=True)
class HumanML3DSource:
    """One motion (see :class:`prbench_adapters.corpora.sources.CorpusRecording`)."""

    root: Path
    files: MotionFiles
    identity: RecordingIdentity
    skip_reason: str | None
    limits: ClipLimits

    @property
    def cost(self) -> Cost:
        """Estimate from the bytes of all input files."""
        size = sum(path.stat().st_size for path in self.files.used)
        return Cost(size, size / _BYTES_A_SECOND, size * _TABLE_SHARE)

    @foreign_input()
    def input_digest(self) -> str:
        """Names and contents of the files."""
        return text_digest(
            self.files.name, *(text for path in self.files.used for text in (path.name, file_digest(path)))
        )

    def without_places(self, message: str) -> str:
        """A message without the folders of this machine."""
        return without_folders(message, self.root)

    @foreign_input()
    def read(self) -> ReadRecording:
        """Read joints and captions, and cut the clips that the captions describe.

        Raises:
            InputFileError: if a file is missing or does not hold what its format promises.
        """
        files = self.files
        if files.joints is None:
            raise InputFileError(
                self.root / layout.JOINTS_FOLDER / f"{files.name}.npy",
                "",
                expected="the joints of this motion",
                found="no such file" if files.features is None else "its 263 features only",
                remedy=_MAKE_JOINTS,
            )
        joints = read_joints(files.joints)
        lines = read_texts(files.texts or self.root / layout.TEXTS_FOLDER / f"{files.name}.txt")
        clips, annotations = clips_of(self.identity, joints, lines, self.limits, load_manifest("humanml3d"))
        return ReadRecording(clips, annotations, len(joints) / layout.RATE)


class HumanML3DCorpus:
    """See :class:`prbench_adapters.corpora.sources.Corpus`."""

    @property
    def manifest(self) -> Manifest:
        """HumanML3D's manifest."""
        return load_manifest("humanml3d")

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """Rate and lengths."""
        limits = self._limits(options)
        return {"fps": f"{limits.fps:g}", "max_frames": str(limits.longest)}

    @foreign_input()
    def find(self, root: Path | None, options: CorpusOptions) -> tuple[HumanML3DSource, ...]:
        """Find all motions with joints, features or texts."""
        if root is None:
            raise UsageError("--root DIR is needed: the folder HumanML3D with new_joints, texts and train.txt.")
        root = root.expanduser().resolve()
        limits = self._limits(options)
        # Every motion by name.
        joints = _by_stem(root / layout.JOINTS_FOLDER, ".npy")
        features = _by_stem(root / layout.FEATURES_FOLDER, ".npy")
        texts = _by_stem(root / layout.TEXTS_FOLDER, ".txt")
        if not joints:
            found = f"{len(features)} files of features" if features else "no motions at all"
            raise InputFileError(
                root, f"{layout.JOINTS_FOLDER}/", expected="joint files of HumanML3D", found=found, remedy=_MAKE_JOINTS
            )
        if not texts:
            packed = (root / layout.TEXTS_ARCHIVE).is_file()
            raise InputFileError(
                root,
                f"{layout.TEXTS_FOLDER}/",
                expected="text files of HumanML3D",
                found=f"{layout.TEXTS_ARCHIVE}, not unpacked" if packed else "none",
                remedy="Unpack texts.zip of the dataset's repository here.",
            )
        names = joints.keys() | features.keys() | texts.keys()
        motions = {name: MotionFiles(name, joints.get(name), features.get(name), texts.get(name)) for name in names}
        splits = _splits(root)
        dataset = f"{SYNTHETIC_PREFIX}humanml3d" if read_synthetic_tree(root) else "humanml3d"
        sources = []
        for name, files in sorted(motions.items()):
            group = name.removeprefix(layout.MIRROR_PREFIX)
            split = splits.get(name)
            reason = None if split else "not listed in train.txt, val.txt or test.txt"
            identity = RecordingIdentity(dataset, name, _UNKNOWN_PERSON, split or "train", group)
            sources.append(HumanML3DSource(root, files, identity, reason, limits))
        return tuple(sources)

    def group_of(self, recording_id: str) -> str:
        """A hundred motions together: the dataset has tens of thousands, of a few kilobytes each."""
        return f"{recording_id[:-_FILES_OF_A_GROUP]}xx"

    def _limits(self, options: CorpusOptions) -> ClipLimits:
        parse_options(ReaderOptions, dict(options.source), dataset="humanml3d")
        if abs(options.rate - layout.RATE) > 1e-9:
            raise UsageError(f"HumanML3D has 20 frames a second; --fps {options.rate:g} cannot be made from them.")
        return ClipLimits.of(options, self.manifest.thresholds)


def _by_stem(folder: Path, suffix: str) -> Mapping[str, Path]:
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in folder.iterdir() if path.suffix == suffix and not path.name.startswith(".")}


def _splits(root: Path) -> dict[str, Split]:
    """The official lists.

    Raises:
        InputFileError: if none of them is there, or one motion stands in two.
    """
    splits: dict[str, Split] = {}
    split: Split
    for split in ("train", "validation", "test"):
        path = root / layout.SPLIT_FILES[split]
        names = read_text(path).split() if path.is_file() else []
        for name in names:
            if splits.get(name, split) != split:
                raise InputFileError(path, name, expected="motions of one split", found=f"also in {splits[name]}")
            splits[name] = split
    if not splits:
        raise InputFileError(
            root, "train.txt, val.txt, test.txt", expected="the official lists", found="none of them",
            remedy="Copy them from the dataset's repository.",
        )  # fmt: skip
    return splits


CORPUS = HumanML3DCorpus()
