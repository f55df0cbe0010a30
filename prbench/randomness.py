"""Generators that depend on names, never on order, worker or batch."""

from __future__ import annotations

import hashlib

import numpy as np


def named_generator(*parts: str | int) -> np.random.Generator:
    """Return the generator of one purpose, named by a path such as ``("prbench-synth", 1, seed, "adt", "room", 3)``.

    Different paths give independent streams. The same path gives the same stream on every machine, in every process and
    in any order of calls. A part counts as it is written: the number 1 and the text "1" are the same part.

    Args:
        parts: Parts of the path. A name that holds slashes, such as a sequence id, is given as several parts.

    Raises:
        ValueError: if a part is empty or holds a slash, for ``("a/b", "c")`` and ``("a", "b/c")`` would be one path.
    """
    names = [str(part) for part in parts]
    ambiguous = [name for name in names if not name or "/" in name]
    if ambiguous:
        raise ValueError(f"parts of a generator's name: expected text without slashes, found {ambiguous[0]!r}")
    return np.random.default_rng(int.from_bytes(hashlib.sha256("/".join(names).encode()).digest()[:16], "little"))


def hash_fraction(*parts: str) -> float:
    """Return SHA-256 of the parts, joined by slashes, as a number from 0 to 1: it decides what no order may change."""
    return int.from_bytes(hashlib.sha256("/".join(parts).encode()).digest(), "big") / 2**256


def noise_seed(run_seed: int, sequence_id: str, sample: int) -> int:
    """Return the seed of one generated motion: 63 bits that depend on nothing but run seed, sequence and sample."""
    return int.from_bytes(hashlib.sha256(f"{run_seed}/{sequence_id}/{sample}".encode()).digest()[:8], "big") >> 1


def sequence_generator(seed: int) -> np.random.Generator:
    """Return the generator of one sequence's ``noise_seed``; it does not depend on the batch around the sequence."""
    return np.random.default_rng(np.random.SeedSequence([seed]))
