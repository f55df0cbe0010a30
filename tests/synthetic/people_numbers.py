"""Numbers of synthetic people, acted out and recorded, beside the ranges that are asked of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from prbench.curation import curate_recording
from prbench.engine import Engine, InProcess
from prbench.errors import UsageError
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.synthetic_table import Staging
from prbench.metrics.batch import MotionBatch
from prbench.metrics.plausible import body_numbers, plausible
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.performance import Performance
from tests.synthetic.behaviour import Range, measure_behaviour, ranges
from tests.synthetic.true_clips import FPS, clips_of

EVENTS = 6
"""Picks and puts of each recording."""
_IN_PROCESS = InProcess()
_PLAUSIBLE = Range(1.0, 1.0, "our limit: people are plausible")
_RATE = 60.0
"""Frames a second of people without sensors: twice what the fastest of their movements need."""


@dataclass(frozen=True)
class PeopleNumber:
    """One number of the people of a preset, and where it must lie."""

    preset: str
    """The people: a dataset whose people they imitate."""
    name: str
    """A field of :class:`~prbench.synthetic.behaviour.Behaviour` or of
    :class:`~prbench.metrics.plausible.BodyNumbers`, or ``plausible``: the share of sequences that keep all limits."""
    acted: float
    """Of noise-free motion and gaze; of body numbers the worst sequence."""
    recorded: float | None
    """Of the sequences that curation makes of the sensors' recordings, the worst; None for behaviour."""
    range: Range
    """Where it must lie, and why."""

    @property
    def holds(self) -> bool:
        """Return True where the number lies in its range, recorded and not."""
        return self.range.holds(self.acted) and (self.recorded is None or self.range.holds(self.recorded))


def people_numbers(
    preset: str, *, recordings: int, seed: int, engine: Engine = _IN_PROCESS
) -> tuple[PeopleNumber, ...]:
    """Measure how the people of a preset act, and whether their bodies keep the protocol's limits.

    Behaviour is measured without provocations, which are meant to be unusual; recorded people have them.

    Args:
        preset: A name of :data:`prbench.synthetic.people.PRESETS`.
        recordings: Number of recordings of six events each.
        seed: Of everything.
        engine: Runs one recording at a time.

    Returns:
        Behaviour, then body numbers, in the order of their fields.

    Raises:
        UsageError: if there is no such preset, or the recordings hold no sequence.
    """
    if preset not in PRESETS:
        raise UsageError(f"expected one of {', '.join(PRESETS)}, found {preset!r}: only these have people that act.")
    performances = list(engine.map(partial(_act, preset, seed), range(recordings)))
    recorded = [joints for some in engine.map(partial(_record, preset, seed), range(recordings)) for joints in some]
    acted = [
        transform_points(invert_rigid(canonical_frame(clip.joints)), clip.joints) for clip in clips_of(performances)
    ]
    if not acted or not recorded:
        raise UsageError(f"{recordings} recordings of seed {seed} hold no sequence; ask for more with --count.")
    behaviour = asdict(measure_behaviour(performances))
    numbers = [PeopleNumber(preset, name, behaviour[name], None, asked) for name, asked in ranges(preset).items()]
    limits = load_protocol().metrics
    shares = []
    extremes = []
    for motions in (MotionBatch.from_motions(acted), MotionBatch.from_motions(recorded)):
        shares.append(float(plausible(motions, FPS, limits).mean()))
        found = body_numbers(motions, FPS, limits)
        worst = {name: float(values.max()) for name, values in vars(found).items()}
        extremes.append(worst | {"lowest_pelvis": float(found.lowest_pelvis.min())})
    numbers.append(PeopleNumber(preset, "plausible", shares[0], shares[1], _PLAUSIBLE))
    highest = {
        "trunk_tilt": limits.largest_trunk_tilt_deg,
        "floating": limits.largest_floating,
        "penetration": limits.largest_penetration,
        "bone_change": limits.largest_bone_change,
        "slow_slides": limits.largest_slide_share,
        "jerk": limits.largest_jerk,
        "speed": limits.largest_speed,
    }
    source = "the protocol's limit"
    bounds = {"lowest_pelvis": Range(limits.lowest_pelvis, np.inf, source)}
    bounds |= {name: Range(-np.inf, high, source) for name, high in highest.items()}
    numbers += [
        PeopleNumber(preset, name, extremes[0][name], extremes[1][name], asked) for name, asked in bounds.items()
    ]
    return tuple(numbers)


def _act(preset: str, seed: int, index: int) -> Performance:
    return perform(preset, seed=seed, index=index, n_events=EVENTS, rate=_RATE, provocations={})


def _record(preset: str, seed: int, index: int) -> list[np.ndarray]:
    staging = Staging(preset, seed, n_events=EVENTS)
    recording = staging.sense(staging.perform(index))
    curated = curate_recording(recording, load_manifest(preset), load_protocol())
    return [np.asarray(sequence.joints) for sequence in curated.sequences]
