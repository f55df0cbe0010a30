"""HumanML3D, the official folder (``formats/humanml3d.md``)."""

from prbench.corpora.humanml3d.source import CORPUS

__all__ = ["CORPUS"]
