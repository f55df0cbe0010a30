"""``prbench build-windows nymeria``: windows of a corpus that has recordings as well as texts."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from prbench.curation.windows import JointChoice, WindowsPlan, runs_of_recording
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import text_digest
from prbench.prediction.joint_sets import SMPL22
from prbench.prediction.protocol import PredictionProtocol
from prbench.prediction.table import CutRun
from prbench.protocol.manifests import digest_of
from prbench.readers import described_options
from prbench_adapters.corpora.nymeria.recording import SuitRecording
from prbench_adapters.corpora.nymeria.source import CORPUS, NymeriaSource
from prbench_adapters.corpora.sources import CorpusOptions


@dataclass(frozen=True)
class NymeriaWindows:
    """One sequence of Nymeria (see :class:`prbench.curation.windows.WindowSource`)."""

    source: NymeriaSource

    @property
    def recording_id(self) -> str:
        """See :class:`prbench.curation.windows.WindowSource`."""
        return self.source.identity.recording_id

    @property
    def skip_reason(self) -> str | None:
        """Sequences that are known for bad texts have sound bodies: nothing is left out."""
        return None

    @property
    def joint_set(self) -> str:
        """See :class:`prbench.curation.windows.WindowSource`."""
        return SMPL22.name

    @property
    def settings(self) -> str:
        """See :class:`prbench.curation.windows.WindowSource`."""
        options = described_options(self.source.options)
        return text_digest(digest_of(CORPUS.manifest), self.source.identity.split, *map(str, options.items()))

    def input_digest(self) -> str:
        """See :class:`prbench.curation.windows.WindowSource`."""
        return SuitRecording(self.source).input_digest()

    def without_places(self, message: str) -> str:
        """See :class:`prbench.curation.windows.WindowSource`."""
        return self.source.without_places(message)

    def cut(self, protocol: PredictionProtocol) -> Iterator[CutRun]:
        """See :class:`prbench.curation.windows.WindowSource`."""
        recording = SuitRecording(self.source).read()
        yield from runs_of_recording(recording, protocol.windows, split=self.source.identity.split)


def plan_windows(
    dataset: str,
    root: Path,
    *,
    joints: JointChoice | None,
    recordings: str,
    limit: int | None,
    reader: tuple[tuple[str, str], ...],
) -> WindowsPlan:
    """See :func:`prbench.curation.windows.plan_windows`; Nymeria's joints are the 22.

    Raises:
        UsageError: as there, and for native joints.
        InputFileError: as there.
    """
    if joints == "native":
        raise UsageError(
            f"--joints native: no study of prediction published joints of {dataset}; leave the option out."
        )
    found = CORPUS.find(root, CorpusOptions(source=reader))
    chosen = [each for each in found if fnmatch.fnmatchcase(each.identity.recording_id, recordings)]
    if not chosen:
        raise InputFileError(
            root,
            "",
            expected=f"recordings whose name matches '{recordings}'",
            found=f"{len(found)} others",
            remedy="Change the glob of --recordings.",
        )
    chosen = sorted(chosen, key=lambda each: f"{each.identity.recording_id}/")[:limit]
    options = {"joints": SMPL22.name, "recordings": recordings, "limit": str(limit or "all")}
    options |= {f"reader.{name}": text for name, text in described_options(chosen[0].options).items()}
    return WindowsPlan(chosen[0].identity.dataset, tuple(map(NymeriaWindows, chosen)), options)
