"""What an examination says is wrong: of motions (``prbench doctor``) and of recorded streams (``prbench inspect``)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Diagnosis:
    """One thing that is wrong with motions or streams, or may be.

    Attributes:
        kind: ``unit``, ``up-axis``, ``facing``, ``clock`` …: docs/doctor.md lists them all, those of streams
            docs/specification/curation.md#clocks-units-and-worlds.
        certain: True if they are wrong for sure, False if they are only suspicious.
        evidence: The measured numbers, in a sentence.
        cause: The most frequent reason for such numbers.
        remedy: The change to make, with the option or converter where there is one.
    """

    kind: str
    certain: bool
    evidence: str
    cause: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.evidence} {self.cause} {self.remedy}"
