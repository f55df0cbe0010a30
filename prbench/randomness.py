"""Generators that depend on names, never on order, worker or batch."""

from __future__ import annotations

import hashlib

import numpy as np


def named_generator(*parts: str | int) -> np.random.Generator:
    """A generator for one purpose, named by a path such as ``("prbench-synth", 1, seed, "adt", "room", 3, "plan")``.

    Two different paths give independent streams; the same path gives the same stream on every machine, in every
    process and in any order of calls.
    """
    digest = hashlib.sha256("/".join(str(part) for part in parts).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


def hash_fraction(*parts: str) -> float:
    """SHA-256 of the parts joined by slashes, as a number from 0 to 1: decides what must never depend on an order."""
    return int.from_bytes(hashlib.sha256("/".join(parts).encode()).digest(), "big") / 2**256


def noise_seed(run_seed: int, sequence_id: str, sample: int) -> int:
    """The seed of one generated motion: 63 bits that depend on nothing but run seed, sequence and sample."""
    digest = hashlib.sha256(f"{run_seed}/{sequence_id}/{sample}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def sequence_generator(seed: int) -> np.random.Generator:
    """A generator for one sequence's ``noise_seed``; the batch around the sequence leaves no trace in it."""
    return np.random.default_rng(np.random.SeedSequence([seed]))
