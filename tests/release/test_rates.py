"""Frame rates and primed frames are inferred from lengths, or have to be given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.release import ImportOptions
from prbench.release.known import load_known
from prbench.release.rates import FrameRateEvidence, infer_frame_rate, read_primed_frames
from prbench.sequences import SequenceTable
from tests.release.imports import imported, value
from tests.release.releases import plain_entry, rows

ROWS = rows(6)


def test_the_mean_length_and_the_primed_frames_tell_the_rate() -> None:
    known = load_known().datasets["hd-epic"]
    generator = np.random.default_rng(0)
    for rate in (20.0, 25.0, 30.0):
        lengths = np.rint(generator.normal(known.duration, known.duration_sd, 4000).clip(3) * rate).astype(int)
        primes = np.where(generator.uniform(size=4000) < 0.9, 2 * rate, 2 * rate - 5)
        evidence = FrameRateEvidence(lengths, primes, np.empty(0), None, known)
        found, inference = infer_frame_rate(evidence, read_primed_frames(primes, lengths))
        assert (found, inference.certainty) == (rate, "likely")
        alone = dataclasses.replace(evidence, known=None)
        assert infer_frame_rate(alone, read_primed_frames(primes, lengths))[1].certainty == "assumed"


def test_a_rate_that_nothing_tells_or_that_is_contradicted_is_unknown() -> None:
    known = load_known().datasets["hd-epic"]
    lengths, primes = np.full(4000, round(known.duration * 30)), np.full(4000, 40.0)
    primed = read_primed_frames(primes, lengths)
    found, inference = infer_frame_rate(FrameRateEvidence(lengths, primes, np.empty(0), None, known), primed)
    assert (found, inference.certainty) == (None, "unknown")
    assert "near 20" in inference.evidence
    assert "near 30" in inference.evidence
    odd = np.full(4000, 7.0)
    assert infer_frame_rate(FrameRateEvidence(lengths, odd, np.empty(0), None, None), primed)[0] is None


def test_an_untold_rate_has_to_be_given(tmp_path) -> None:
    moved = [dataclasses.replace(row, prime_frame=int(5 + 3 * i)) for i, row in enumerate(ROWS)]
    with pytest.raises(InputFileError, match=r"frame rate.*--fps"):
        imported(tmp_path / "without", moved)
    assert not (tmp_path / "without" / "table").exists()
    report = imported(tmp_path / "with", moved, options=ImportOptions(fps=20.0))
    assert value(report, "fps") == ("20", "certain")


def test_frames_from_one_and_seconds_are_recognised(tmp_path) -> None:
    early = [dataclasses.replace(ROWS[0], prime_frame=0), *ROWS[1:]]
    one = imported(
        tmp_path / "one",
        early,
        entry=lambda row, style: plain_entry(row, style) | {"primed_frame": row.prime_frame + 1},
    )
    assert value(one, "primed_frame") == ("frames from 1", "likely")
    seconds = imported(
        tmp_path / "seconds",
        early,
        entry=lambda row, style: plain_entry(row, style) | {"primed_frame": row.prime_frame / 20 + 0.01, "fps": 20},
    )
    assert value(seconds, "primed_frame") == ("seconds", "likely")
    for folder, late in (("one", 0.0), ("seconds", 0.01)):
        rows_back = SequenceTable.open(tmp_path / folder / "table").scalars()
        assert rows_back["prime_frame"].to_pylist() == [row.prime_frame for row in early]
        expected = [row.prime_frame / 20 + late for row in early]
        np.testing.assert_allclose(rows_back["prime_time"].to_numpy(), expected, atol=1e-9)
