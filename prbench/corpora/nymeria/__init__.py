"""Nymeria and NymeriaPlus: suit motion and narrations (docs/specification/nymeria.md)."""

from prbench.corpora.nymeria.source import CORPUS

__all__ = ["CORPUS"]
