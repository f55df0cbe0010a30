"""Confidence intervals that know that sequences of one recording are not independent.

Source: docs/specification/protocol.md#intervals.

Every estimate is the mean over sequences (of the mean over samples, where a sequence has several), and every interval
is that of this estimator: its spread is measured by leaving out, or drawing anew, whole recordings.

* **Rates** get Wilson's score interval with an effective sample size. The design effect is the variance of the mean
  between recordings (jackknife) over its variance if all sequences were independent, and at least 1; few recordings
  cost degrees of freedom as in Korn and Graubard (1998). However correlated the sequences, n recordings count for no
  less than n independent sequences of their sizes (Kish). Where all values are equal, nothing is known about the
  correlation; then the interval is that of Clopper and Pearson with one trial a recording, so that 0 % and 100 % never
  claim certainty.
* **Metres and ratios** get a percentile bootstrap over recordings, with samples drawn anew inside their sequences. It
  is computed instead of drawn (:mod:`prbench.evaluation.bootstrap`), so that no seed moves a printed digit.
  Percentiles of few recordings lie too close together; they are taken further out by as much as Student's interval is
  wider than the normal one (Hesterberg 2015, "expanded percentiles"). Below ten recordings the interval is Student's
  itself, from the jackknife over recordings with recordings - 1 degrees of freedom. With recordings of one size this
  is the t interval of the recording means.
* With a single recording, a mean has no interval; a rate has that of one trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from prbench.evaluation.bootstrap import RecordingTotals
from prbench.metrics import MetricInfo

Ids = Sequence[str] | np.ndarray
"""One name a row."""
CONFIDENCE = 0.95
_FEWEST_FOR_BOOTSTRAP = 10
EQUAL_WITHIN = 1e-5
"""Values no farther apart are equal: what arithmetic alone makes of them is never printed, and decides nothing."""
_FEW_RECORDINGS = "few_recordings"
_ONE_RECORDING = "one_recording"
_ALL_EQUAL = "all_equal"


@dataclass(frozen=True)
class Estimate:
    """A mean over sequences with its 95 % interval."""

    mean: float
    low: float | None
    """None where the data do not support an interval."""
    high: float | None
    n_sequences: int
    n_recordings: int
    method: str
    """Name of the interval: wilson-cluster, clopper-pearson-recordings, bootstrap, t-jackknife or none."""
    marks: tuple[str, ...]
    """``few_recordings`` (below ten), ``one_recording``, ``all_equal``."""


@dataclass(frozen=True, eq=False)
class ClusteredValues:
    """Values grouped by sequence and recording, in an order that does not depend on that of the rows."""

    values: Float[np.ndarray, " rows"]
    samples: Int[np.ndarray, " sequences"]
    """Rows (samples) of each sequence; its rows stand together."""
    sequences: Int[np.ndarray, " recordings"]
    """Sequences of each recording; they stand together."""
    recordings: tuple[str, ...]

    @property
    def sequence_means(self) -> Float[np.ndarray, " sequences"]:
        """Mean over the samples of each sequence."""
        return np.add.reduceat(self.values, _starts(self.samples)) / self.samples

    @property
    def totals(self) -> Float[np.ndarray, " recordings"]:
        """Sum of the sequence means of each recording."""
        return np.add.reduceat(self.sequence_means, _starts(self.sequences))

    @property
    def inner_variances(self) -> Float[np.ndarray, " recordings"]:
        """Variance of each total, if as many samples of each of its sequences are drawn anew from them."""
        about_mean = self.values - np.repeat(self.sequence_means, self.samples)
        of_means = np.add.reduceat(about_mean**2, _starts(self.samples)) / self.samples.astype(np.float64) ** 2
        return np.add.reduceat(of_means, _starts(self.sequences))

    @property
    def mean(self) -> float:
        """Mean over sequences, the estimate itself."""
        return float(self.totals.sum() / self.sequences.sum())

    @property
    def marks(self) -> tuple[str, ...]:
        """Remarks that a reader of the interval needs."""
        count = len(self.sequences)
        found = {
            _ONE_RECORDING: count == 1,
            _FEW_RECORDINGS: count < _FEWEST_FOR_BOOTSTRAP,
            _ALL_EQUAL: bool(np.ptp(self.values) <= EQUAL_WITHIN),
        }
        return tuple(mark for mark, holds in found.items() if holds)

    def estimate(self, low: float | None, high: float | None, method: str) -> Estimate:
        """Put the mean and an interval of it together."""
        return Estimate(self.mean, low, high, len(self.samples), len(self.sequences), method, self.marks)


def clustered(
    values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None
) -> ClusteredValues:
    """Group values by recording and sequence.

    Args:
        values: One a row.
        recording_ids: The recording that each row's sequence comes from.
        sequence_ids: The sequence of each row, where a sequence has several samples; by default every row is one.

    Raises:
        ValueError: without values, for values that are not finite, columns of unequal lengths, or a sequence that
            belongs to two recordings.
    """
    if len(values) == 0:
        raise ValueError("no values to estimate from")
    if not np.isfinite(values).all():
        raise ValueError(f"row {np.flatnonzero(~np.isfinite(values))[0]}: the value is not finite")
    sequences = np.arange(len(values)) if sequence_ids is None else np.asarray(sequence_ids)
    if not len(values) == len(recording_ids) == len(sequences):
        raise ValueError("values, recording ids and sequence ids differ in number")
    names, recording = np.unique(np.asarray(recording_ids), return_inverse=True)
    sequence = np.unique(sequences, return_inverse=True)[1]
    # Sorted by values last, so that the order of rows leaves no trace in rounded sums.
    order = np.lexsort((values, sequence, recording) if sequence_ids is not None else (values, recording))
    pairs = np.stack([recording, sequence])[:, order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(pairs) != 0).any(axis=0)]))
    if len(first) != sequence.max() + 1:
        raise ValueError("a sequence belongs to two recordings")
    return ClusteredValues(
        values[order].astype(np.float64),
        np.diff(np.append(first, len(values))),
        np.bincount(pairs[0, first]),
        tuple(str(name) for name in names),
    )


def metric_interval(
    info: MetricInfo,
    values: Float[np.ndarray, " rows"],
    recording_ids: Ids,
    sequence_ids: Ids | None = None,
) -> Estimate:
    """Return the interval that fits a metric; arguments as those of :func:`clustered`."""
    if info.unit == "rate":
        return rate_interval(values, recording_ids, sequence_ids)
    return mean_interval(values, recording_ids, sequence_ids, nonnegative=not info.can_be_negative)


def rate_interval(values: Float[np.ndarray, " rows"], recording_ids: Ids, sequence_ids: Ids | None = None) -> Estimate:
    """Mean of a rate (values from 0 to 1) over sequences, with a score interval; arguments as :func:`clustered`."""
    if ((values < 0) | (values > 1)).any():
        raise ValueError("a rate has values from 0 to 1")
    data = clustered(values, recording_ids, sequence_ids)
    # All values are equal: their spread says nothing about how alike sequences of one recording are.
    if min(data.mean, 1 - data.mean) <= EQUAL_WITHIN:
        low, high = _clopper_pearson_of_recordings(float(round(data.mean)), len(data.sequences))
        return data.estimate(low, high, "clopper-pearson-recordings")
    low, high = _wilson(data.mean, effective_sample_size(data))
    return data.estimate(low, high, "wilson-cluster")


def mean_interval(
    values: Float[np.ndarray, " rows"],
    recording_ids: Ids,
    sequence_ids: Ids | None = None,
    *,
    nonnegative: bool = False,
) -> Estimate:
    """Mean over sequences, with an interval from the spread between recordings; arguments as :func:`clustered`.

    Args:
        values: One a row.
        recording_ids: One a row.
        sequence_ids: One a row, or None.
        nonnegative: The quantity cannot fall below 0, so its interval is cut there.
    """
    data = clustered(values, recording_ids, sequence_ids)
    if len(data.sequences) == 1:
        return data.estimate(None, None, "none")
    if len(data.sequences) < _FEWEST_FOR_BOOTSTRAP:
        reach = special.stdtrit(len(data.sequences) - 1, 0.5 + CONFIDENCE / 2) * np.sqrt(_jackknife_variance(data))
        low = data.mean - reach
        high = data.mean + reach
        method = "t-jackknife"
    else:
        low, high = _bootstrap(data)
        method = "bootstrap"
    return data.estimate(max(float(low), 0.0) if nonnegative else float(low), float(high), method)


def _jackknife_variance(data: ClusteredValues) -> float:
    """Variance of the mean over sequences, from leaving out one recording (of two or more) at a time."""
    count = len(data.sequences)
    n = data.sequences.sum()
    without = (data.totals.sum() - data.totals) / (n - data.sequences)
    return float((count - 1) / count * ((without - data.mean) ** 2).sum())


def effective_sample_size(data: ClusteredValues) -> float:
    """The number of independent sequences whose rate would be known as well as this one (rate neither 0 nor 1)."""
    count = len(data.sequences)
    n = int(data.sequences.sum())
    at_least = n**2 / float((data.sequences.astype(np.float64) ** 2).sum())
    if count == 1:
        return at_least
    design_effect = max(_jackknife_variance(data) / (data.mean * (1 - data.mean) / (n - 1)), 1.0)
    upper = 0.5 + CONFIDENCE / 2
    few_recordings = (special.stdtrit(n - 1, upper) / special.stdtrit(count - 1, upper)) ** 2
    return max(float(n / design_effect * few_recordings), at_least)


def _wilson(rate: float, n: float) -> tuple[float, float]:
    # Wilson (1927): the interval of all rates whose score test does not reject the observed one.
    z = special.ndtri(0.5 + CONFIDENCE / 2)
    centre = (rate + z**2 / (2 * n)) / (1 + z**2 / n)
    reach = z / (1 + z**2 / n) * np.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    return float(centre - reach), float(centre + reach)


def _clopper_pearson_of_recordings(rate: float, count: int) -> tuple[float, float]:
    bound = ((1 - CONFIDENCE) / 2) ** (1 / count)
    return (0.0, 1 - bound) if rate == 0 else (bound, 1.0)


def _bootstrap(data: ClusteredValues) -> tuple[float, float]:
    drawn = RecordingTotals(data.totals, data.sequences, data.inner_variances)
    lowest = float(data.values.min())
    highest = float(data.values.max())
    tail = _expanded_tail(len(data.sequences))
    low = drawn.percentile(tail, lowest=lowest, highest=highest)
    high = drawn.percentile(1 - tail, lowest=lowest, highest=highest)
    return low, high


def _expanded_tail(count: int) -> float:
    # Hesterberg (2015): percentiles as far out as Student's interval is wider than the normal one.
    reach = special.stdtrit(count - 1, 0.5 + CONFIDENCE / 2) * np.sqrt(count / (count - 1))
    return float(special.ndtr(-reach))


def _starts(counts: np.ndarray) -> np.ndarray:
    return np.cumsum(counts) - counts
