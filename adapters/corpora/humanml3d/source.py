"""HumanML3D as a corpus: its groups of motions, and captioned parts as clips, each placed or left out with a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input, read_text, require
from prbench.files.storage import file_digest, text_digest
from prbench.limits import HARMLESS_SIZE, LARGEST_ARRAYS
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_PREFIX, read_synthetic_tree
from prbench.sequences.corpus import Annotation, Caption, Clip
from prbench_adapters.corpora import sources as corpora
from prbench_adapters.corpora.humanml3d import files as layout
from prbench_adapters.corpora.humanml3d.files import TextLine, read_joints, read_texts, remark_on

_SAME_CLOCK = {"clock_method": "same", "clock_offset": 0.0, "clock_quality": None, "approximate": False}


_UNKNOWN_PERSON = "unknown"
_FILES_OF_A_GROUP = 2  # last digits that the names of a group do not share: a hundred motions
_MAKE_JOINTS = (
    "The notebooks of the dataset's repository write new_joints beside new_joint_vecs; run them again."
    " Turning features into joints is no part of this command."
)


@dataclass(frozen=True)
class HumanML3DSource(corpora.CorpusRecording):
    """One motion.

    Attributes:
        joints: File of the joints; None where there are features only.
    """

    joints: Path | None
    texts: Path
    bytes_a_second = 3.6e6
    table_share = 2.7

    @property
    def _used(self) -> list[Path]:
        """Files that a clip depends on."""
        return [path for path in (self.joints, self.texts) if path is not None and path.exists()]

    @property
    def input_bytes(self) -> int:
        """Bytes of all input files."""
        return sum(path.stat().st_size for path in self._used)

    @foreign_input()
    def input_digest(self) -> str:
        """Names and contents of the files."""
        texts = (text for path in self._used for text in (path.name, file_digest(path, largest=LARGEST_ARRAYS)))
        return text_digest(self.identity.recording_id, *texts)

    @foreign_input()
    def read(self) -> corpora.ReadRecording:
        """Read joints and captions, and cut the clips that the captions describe.

        Raises:
            InputFileError: if a file is missing or does not hold what its format promises.
        """
        if self.joints is None:
            name = f"{self.identity.recording_id}.npy"
            assert self.root is not None  # of files
            found = "its 263 features only" if (self.root / layout.FEATURES_FOLDER / name).exists() else "no such file"
            path = self.root / layout.JOINTS_FOLDER / name
            raise InputFileError(path, "", expected="the joints of this motion", found=found, remedy=_MAKE_JOINTS)
        joints = read_joints(self.joints)
        lines = read_texts(self.texts)
        clips, annotations = self._clips(joints, lines)
        return corpora.ReadRecording(clips, annotations, len(joints) / layout.RATE, message=remark_on(joints, lines))

    def _clips(
        self, joints: Float[np.ndarray, "frames 22 3"], lines: Sequence[TextLine]
    ) -> tuple[tuple[Clip, ...], tuple[Annotation, ...]]:
        """Clips of the motion, and what became of every caption.

        Captions of the same part of the motion share a clip; parts are cut at 20 frames a second as the official loader
        does, ``motion[int(from * 20) : int(to * 20)]``.

        Args:
            joints: Joint positions of the whole motion, metres, Y up.
            lines: Captions in file order.
        """
        about = load_manifest("humanml3d").body
        clips = []
        annotations = []
        # Lines of one span together, whole motions first.
        spans: dict[tuple[float, float], list[tuple[int, Caption]]] = {}
        numbered = [(number, *line) for number, line in enumerate(lines, start=1)]
        for number, caption, start, end in sorted(numbered, key=lambda item: (item[1].kind != layout.WHOLE, item[0])):
            span = (0.0, len(joints) / layout.RATE) if caption.kind == layout.WHOLE else (start, end)
            spans.setdefault(span, []).append((number, caption))
        for (start, end), members in spans.items():
            kind = members[0][1].kind
            recording = f"{self.identity.dataset}/{self.identity.recording_id}"
            sequence_id = f"{recording}/{kind}/{round(start * 1e6)}-{round(end * 1e6)}/{about.pose_source}"
            captions = tuple(dict.fromkeys(replace(caption, kind=kind) for _, caption in members if caption.text))
            first = int(start * layout.RATE)
            available = min(int(end * layout.RATE), len(joints)) - first
            # The outcome, the number that decided, and the threshold that it was compared with.
            fate: tuple[str, float | None, float | None] = ("clip", None, None)
            if not captions:
                fate = ("no_text", None, None)
            elif end <= start:
                fate = ("end_before_start", end - start, 0.0)
            elif available <= 0 or start < 0.0:
                fate = ("outside_motion", available / self.limits.fps, 0.0)
            elif available < self.limits.shortest:
                fate = ("too_short", available / self.limits.fps, self.limits.shortest / self.limits.fps)
            outcome, value, threshold = fate
            if outcome == "clip":
                n_frames = min(available, self.limits.longest)
                clip = corpora.cut_clip(
                    joints,
                    first,
                    1,
                    n_frames,
                    fps=self.limits.fps,
                    start=first / layout.RATE,
                    sequence_id=sequence_id,
                    **vars(self.identity),
                    kind=kind,
                    captions=captions,
                    text_start=start,
                    text_end=end,
                    # Cut only where a whole frame more was described; less than one is lost by rounding down.
                    cut=end * layout.RATE - first >= n_frames + 1,
                    mirrored=self.identity.recording_id.startswith(layout.MIRROR_PREFIX),
                    **_SAME_CLOCK,
                    pose_source=about.pose_source,
                    head_tilt_deg=about.head_tilt_deg,
                )
                outcome = "no_heading" if clip is None else "clip"
                clips += [] if clip is None else [clip]
            seen: set[str] = set()
            for number, caption in members:
                own = outcome
                if not caption.text:
                    own = "no_text"
                elif caption.text in seen:
                    own = "duplicate"
                seen.add(caption.text)
                whose = (f"{recording}/{number}", self.identity.recording_id, sequence_id if own == "clip" else None)
                decisive = (value, threshold) if own == outcome else (None, None)
                annotations.append(Annotation(*whose, kind, caption.text, start, end, own, *decisive))
        return tuple(clips), tuple(annotations)


class HumanML3DCorpus(corpora.Corpus):
    """See :class:`prbench_adapters.corpora.sources.Corpus`."""

    name = "humanml3d"
    native_rate = layout.RATE

    def limits(self, options: corpora.CorpusOptions) -> corpora.ClipLimits:
        """See :class:`prbench_adapters.corpora.sources.Corpus`."""
        if options.rate != layout.RATE:
            raise UsageError(f"HumanML3D has 20 frames a second; --fps {options.rate:g} cannot be made from them.")
        return super().limits(options)

    @foreign_input()
    def find(self, root: Path | None, options: corpora.CorpusOptions) -> tuple[HumanML3DSource, ...]:
        """Find all motions with joints, features or texts."""
        if root is None:
            raise UsageError("--root DIR is needed: the folder HumanML3D with new_joints, texts and train.txt.")
        root = root.expanduser().resolve()
        self.chosen(options)
        limits = self.limits(options)
        # Every motion by name.
        endings = {layout.JOINTS_FOLDER: ".npy", layout.FEATURES_FOLDER: ".npy", layout.TEXTS_FOLDER: ".txt"}
        joints, features, texts = (
            {path.stem: path for path in sorted((root / folder).glob(f"[!.]*{suffix}"))}
            for folder, suffix in endings.items()
        )
        held = f"{len(features)} files of features" if features else "no motions at all"
        packed = f"{layout.TEXTS_ARCHIVE}, not unpacked" if (root / layout.TEXTS_ARCHIVE).is_file() else "none"
        unpack = "Unpack texts.zip of the dataset's repository here."
        require(root, (joints, f"{layout.JOINTS_FOLDER}/", "joint files of HumanML3D", held, _MAKE_JOINTS))
        require(root, (texts, f"{layout.TEXTS_FOLDER}/", "text files of HumanML3D", packed, unpack))
        # The official lists.
        splits: dict[str, str] = {}
        for split, file in layout.SPLIT_FILES.items():
            path = root / file
            for name in read_text(path, largest=HARMLESS_SIZE).split() if path.is_file() else ():
                if splits.setdefault(name, split) != split:
                    raise InputFileError(path, name, expected="motions of one split", found=f"also in {splits[name]}")
        remedy = "Copy them from the dataset's repository."
        require(root, (splits, "train.txt, val.txt, test.txt", "the official lists", "none of them", remedy))
        dataset = f"{SYNTHETIC_PREFIX}humanml3d" if read_synthetic_tree(root) else "humanml3d"
        sources = []
        for name in sorted(joints.keys() | features.keys() | texts.keys()):
            listed = splits.get(name)
            reason = None if listed else "not listed in train.txt, val.txt or test.txt"
            group = name.removeprefix(layout.MIRROR_PREFIX)
            identity = corpora.RecordingIdentity(dataset, name, _UNKNOWN_PERSON, listed or "train", group)
            text = texts.get(name, root / layout.TEXTS_FOLDER / f"{name}.txt")
            sources.append(HumanML3DSource(identity, limits, root, reason, joints.get(name), text))
        return tuple(sources)

    def group_of(self, recording_id: str) -> str:
        """Group a hundred motions: the dataset has tens of thousands, of a few kilobytes each."""
        return f"{recording_id[:-_FILES_OF_A_GROUP]}xx"


CORPUS = HumanML3DCorpus()
