"""HumanML3D, the official folder (docs/specification/humanml3d.md#text-files)."""

from prbench.corpora.humanml3d.source import CORPUS

__all__ = ["CORPUS"]
