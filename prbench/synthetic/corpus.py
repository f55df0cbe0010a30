"""Invented people as a corpus: acted out when they are read, without native files.

They wear the suit of the Nymeria layout, so that a corpus built here and one built from written files hold the same
joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.corpora.nymeria.body import suit_motion
from prbench.corpora.nymeria.clock import ClockOffset
from prbench.corpora.nymeria.format import SUIT_RATE
from prbench.corpora.nymeria.source import NymeriaOptions, recording_clips
from prbench.corpora.nymeria.suit import clean_suit
from prbench.corpora.options import ClipLimits, CorpusOptions
from prbench.corpora.sources import Belonging, Cost, ReadRecording
from prbench.errors import UsageError
from prbench.manifests import Manifest, load_manifest
from prbench.readers import SYNTHETIC_PREFIX, described_options
from prbench.readers.options import ReaderOptions, parse_options
from prbench.storage import text_digest
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities import cast_of, narrated_recording
from prbench.synthetic.sensors.nymeria import sense_nymeria

DATASET = f"{SYNTHETIC_PREFIX}corpus"
_COST = Cost(0, 1.2, 0.5e6)
POSE_SOURCE = "invented-xsens"


class SyntheticOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to invent."""

    recordings: int = 40
    """How many; about 13 atomic actions each."""
    seed: int = 0
    """Of everything; recording i depends on it and on i alone."""
    noise: float = 1.0
    """Multiplies every sensor error."""
    kinds: str = "atomic_action,motion_narration"
    """Which texts become clips."""


@dataclass(frozen=True)
class SyntheticSource:
    """One recording that is acted out when it is read (see :class:`prbench.corpora.sources.CorpusRecording`)."""

    index: int
    belonging: Belonging
    options: SyntheticOptions
    limits: ClipLimits
    skip_reason: None = None
    cost: Cost = _COST

    def input_digest(self) -> str:
        """Of what the recording is made from."""
        return text_digest("corpus", str(GENERATOR_VERSION), str(self.options.seed), str(self.index))

    def without_places(self, message: str) -> str:
        """Nothing of this machine is in the messages."""
        return message

    def read(self) -> ReadRecording:
        """Act it out, and cut the clips that its texts describe."""
        motion = narrated_recording(self.options.seed, self.index)
        readings = sense_nymeria(motion, seed=self.options.seed, noise=self.options.noise)
        manifest, kinds = load_manifest("nymeria"), NymeriaOptions(kinds=self.options.kinds).chosen_kinds
        clean = clean_suit(readings.recording.suit, manifest.thresholds, path=motion.recording_id)
        body = suit_motion(
            clean,
            manifest.body.joint_mapping,
            POSE_SOURCE,
            manifest.body.head_tilt_deg,
            manifest.thresholds,
            path=motion.recording_id,
        )
        texts = tuple(row for row in readings.recording.narrations if row.kind in kinds)
        offset = ClockOffset("known", readings.offset)
        return recording_clips(self.belonging, body, texts, offset, self.limits, manifest.thresholds)


class SyntheticCorpus:
    """See :class:`prbench.corpora.sources.Corpus`."""

    @property
    def manifest(self) -> Manifest | None:
        """Nobody's licence: invented by prbench."""
        return None

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """Rate, lengths, seed and generator."""
        limits, chosen = self._limits(options), self._options(options)
        return {
            "fps": f"{limits.fps:g}",
            "max_frames": str(limits.longest),
            "generator": str(GENERATOR_VERSION),
            **{f"reader.{name}": text for name, text in described_options(chosen).items()},
        }

    def find(self, root: Path | None, options: CorpusOptions) -> tuple[SyntheticSource, ...]:
        """As many recordings as were asked for."""
        if root is not None:
            raise UsageError("a synthetic corpus reads no files; leave --root away, or name the corpus of the files.")
        chosen, limits = self._options(options), self._limits(options)
        sources = []
        for index in range(chosen.recordings):
            cast = cast_of(chosen.seed, index)
            belonging = Belonging(DATASET, cast.recording_id, cast.participant_id, cast.split, cast.participant_id)
            sources.append(SyntheticSource(index, belonging, chosen, limits))
        return tuple(sources)

    def group_of(self, recording_id: str) -> str:
        """Every recording is worked on alone."""
        return recording_id

    def _options(self, options: CorpusOptions) -> SyntheticOptions:
        chosen = parse_options(SyntheticOptions, dict(options.source), dataset="the synthetic corpus")
        if chosen.recordings < 1:
            raise UsageError(f"a synthetic corpus needs at least one recording, not {chosen.recordings}.")
        _ = NymeriaOptions(kinds=chosen.kinds).chosen_kinds
        return chosen

    def _limits(self, options: CorpusOptions) -> ClipLimits:
        if (SUIT_RATE / options.rate) % 1.0 > 1e-9:
            raise UsageError(f"--fps must divide the suit's 240 Hz (20, 24, 30, 40 …), found {options.rate:g}.")
        return ClipLimits.of(options, load_manifest("nymeria").thresholds)


CORPUS = SyntheticCorpus()
