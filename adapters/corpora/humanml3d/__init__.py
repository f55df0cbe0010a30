"""HumanML3D, the official folder (docs/specification/humanml3d.md#text-files)."""

from prbench_adapters.corpora.humanml3d.source import CORPUS

__all__ = ["CORPUS"]
