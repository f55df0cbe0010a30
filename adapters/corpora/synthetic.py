"""Synthetic people as text-motion corpora: in the layouts of Nymeria and HumanML3D, or generated when they are read.

Those that are acted out wear the suit of the Nymeria layout, so that a corpus built here and one built from written
files hold the same joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from prbench.engine import engine_for
from prbench.errors import UsageError
from prbench.files.storage import atomic_folder, sole_writer, text_digest, write_json, write_text
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_PREFIX, ReaderOptions
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities import identity_of, narrated_recording
from prbench.synthetic.write_tree import WrittenRecording, WrittenTree, require_free, write_mark
from prbench_adapters.corpora.humanml3d import synthetic as humanml3d
from prbench_adapters.corpora.humanml3d.files import MIRROR_PREFIX, SPLIT_FILES
from prbench_adapters.corpora.nymeria import synthetic as nymeria
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.format import SUIT_RATE
from prbench_adapters.corpora.nymeria.source import NymeriaCorpus, NymeriaOptions, recording_clips
from prbench_adapters.corpora.nymeria.suit import clean_suit
from prbench_adapters.corpora.nymeria.synthetic import sense_nymeria
from prbench_adapters.corpora.sources import Corpus, CorpusOptions, CorpusRecording, ReadRecording, RecordingIdentity

DATASET = f"{SYNTHETIC_PREFIX}corpus"
_GENERATOR = str(GENERATOR_VERSION)
POSE_SOURCE = "invented-xsens"


class SyntheticOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of a corpus that is generated when it is read.

    Attributes:
        recordings: How many; about 13 atomic actions each.
        seed: Seed of everything; recording i depends on it and on i alone.
        noise: Multiplies every sensor error.
        kinds: Which texts become clips.
    """

    recordings: int = 40
    seed: int = 0
    noise: float = 1.0
    kinds: str = "atomic_action,motion_narration"


@dataclass(frozen=True)
class SyntheticSource(CorpusRecording):
    """One recording that is acted out when it is read."""

    index: int
    options: SyntheticOptions

    @property
    def input_bytes(self) -> int:
        """Zero, as there are no files."""
        return 0

    @property
    def cost(self) -> tuple[float, float]:
        """Return the cost of one recording, which is the same for each: seconds, and bytes on the disk."""
        return 1.2, 0.5e6

    def input_digest(self) -> str:
        """Return the digest of what the recording is made from."""
        return text_digest("corpus", str(GENERATOR_VERSION), str(self.options.seed), str(self.index))

    def read(self) -> ReadRecording:
        """Act it out, and cut the clips that its texts describe."""
        motion = narrated_recording(self.options.seed, self.index)
        readings = sense_nymeria(motion, seed=self.options.seed, noise=self.options.noise)
        kinds = NymeriaOptions(kinds=self.options.kinds).chosen_kinds
        body = clean_suit(readings.suit, load_manifest("nymeria"), path=motion.recording_id, pose_source=POSE_SOURCE)
        texts = tuple(row for row in readings.narrations if row.kind in kinds)
        return recording_clips(self.identity, body, texts, ClockOffset("known", readings.offset), self.limits)


class SyntheticCorpus(Corpus):
    """See :class:`prbench_adapters.corpora.sources.Corpus`."""

    name = "synthetic"
    options = SyntheticOptions
    native_rate = SUIT_RATE
    rates = NymeriaCorpus.rates

    @property
    def manifest(self) -> None:
        """Nothing, as prbench itself invents it."""

    def chosen(self, options: CorpusOptions) -> SyntheticOptions:
        """See :class:`prbench_adapters.corpora.sources.Corpus`."""
        chosen = super().chosen(options)
        if chosen.recordings < 1:
            raise UsageError(f"a synthetic corpus needs at least one recording, not {chosen.recordings}.")
        _ = NymeriaOptions(kinds=chosen.kinds).chosen_kinds  # refuses an unknown kind before anything is generated
        return chosen

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """See :class:`prbench_adapters.corpora.sources.Corpus`; the generator, too."""
        described = super().described(options)
        return {"fps": described["fps"], "max_frames": described["max_frames"], "generator": _GENERATOR, **described}

    def find(self, root: Path | None, options: CorpusOptions) -> tuple[SyntheticSource, ...]:
        """Return as many recordings as were asked for."""
        if root is not None:
            raise UsageError("a synthetic corpus reads no files; leave --root away, or name the corpus of the files.")
        chosen = self.chosen(options)
        limits = self.limits(options)
        sources = []
        for index in range(chosen.recordings):
            who = identity_of(chosen.seed, index)
            identity = RecordingIdentity(DATASET, who.recording_id, who.participant_id, who.split, who.participant_id)
            sources.append(SyntheticSource(identity, limits, None, None, index, chosen))
        return tuple(sources)


CORPUS = SyntheticCorpus()


_LAYOUTS = ("nymeria", "humanml3d")  # Those that can be written.
_TRUTH_FILE = "truth/clock_offsets.json"  # Holds TIME_CODE minus device time of each sequence. Readers never open it.
_WITHOUT_TRAJECTORY = 3  # Every so many-th sequence comes without the glasses' trajectory.


# A recording, its clocks' offset, and the names under which it was written with their splits.
_Done = tuple[WrittenRecording, float, tuple[tuple[str, str], ...]]


def synthesize_corpus_tree(
    layout: str,
    out: Path,
    *,
    recordings: int,
    seed: int = 0,
    workers: int = 1,
    noise: float = 1.0,
    on_written: Callable[[WrittenRecording], None] | None = None,
) -> WrittenTree:
    """Write native files of narrated recordings, complete or not at all; bytes depend on layout, seed and index alone.

    Args:
        layout: ``nymeria`` or ``humanml3d``.
        out: Folder of the tree; an older synthetic tree there is replaced.
        recordings: How many.
        seed: The tree's seed; recording i depends on it and on i alone.
        workers: Processes.
        noise: Multiplies every sensor error.
        on_written: Called after each recording, in their order.

    Raises:
        UsageError: for an unknown layout, or a folder that holds something else.
        StorageError: if the disk is full or the folder cannot be written.
    """
    if layout not in _LAYOUTS:
        raise UsageError(f"unknown corpus layout '{layout}'; known ones are: {', '.join(_LAYOUTS)}.")
    require_free(out)
    with sole_writer(out), atomic_folder(out) as root:
        done: list[_Done] = []
        write_one = partial(_write, layout=layout, root=root, seed=seed, noise=noise)
        for result in engine_for(workers).map(write_one, range(recordings)):
            done.append(result)
            if on_written:
                on_written(result[0])
        splits = dict(item for _, _, names in done for item in names)
        if layout == "humanml3d":
            for split, name in SPLIT_FILES.items():
                members = "".join(f"{motion}\n" for motion, chosen in sorted(splits.items()) if chosen == split)
                write_text(root / name, members)
        else:
            write_json(root / _TRUTH_FILE, {recording.recording_id: offset for recording, offset, _ in done})
        write_mark(root, layout, seed, "default", splits)
    return WrittenTree(out, tuple(recording for recording, _, _ in done))


def _write(index: int, *, layout: str, root: Path, seed: int, noise: float) -> _Done:
    motion = narrated_recording(seed, index)
    n_texts = sum(row.kind == "atomic_action" for row in motion.narrations)
    recording = WrittenRecording(motion.recording_id, motion.split, motion.duration, n_texts, 0)
    if layout == "nymeria":
        readings = sense_nymeria(motion, seed=seed, noise=noise)
        nymeria.write_nymeria(readings, root, trajectory=index % _WITHOUT_TRAJECTORY != _WITHOUT_TRAJECTORY - 1)
        return recording, readings.offset, ((motion.recording_id, motion.split),)
    splits = []
    for number, captioned in enumerate(humanml3d.captioned_motions(motion)):
        name = f"{index * 100 + number:06d}"
        humanml3d.write_motion(root, name, captioned)
        humanml3d.write_motion(root, f"{MIRROR_PREFIX}{name}", humanml3d.mirrored(captioned))
        splits += [(name, motion.split), (f"{MIRROR_PREFIX}{name}", motion.split)]
    return recording, 0.0, tuple(splits)
