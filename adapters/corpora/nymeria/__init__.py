"""Nymeria and NymeriaPlus: suit motion and narrations (docs/specification/nymeria.md)."""

from prbench_adapters.corpora.nymeria.source import CORPUS

__all__ = ["CORPUS"]
