"""One recording of the corpus from its seed: somebody who does one thing after the other, or who primes and reaches.

Every fourth recording is a prime-and-reach performance of the benchmark's presets, but of a seed of its own, so that no
recording of a benchmark table is ever among what a method is pre-trained on
(docs/specification/synthetic-recordings.md#determinism-splits-sizes and
docs/specification/synthetic-recordings.md#text).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from prbench.randomness import named_generator
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities.act_out import act_out
from prbench.synthetic.activities.acts import PAUSE, SHORT, SITTING, STANDING, stand
from prbench.synthetic.activities.narrate import NarratedMotion, narrate, narrate_events
from prbench.synthetic.activities.script import Script, ScriptWriter
from prbench.synthetic.people import PRESETS, Preset, perform
from prbench.synthetic.people.person import Person, draw_person
from prbench.synthetic.people.world import Source, assign

RATE = 240.0
_N_ACTIVITIES = 14
N_EVENTS = 8
_EVERY = 4
"""Each so many-th recording shows picks and puts."""
_BASE_PRESET = "hd-epic"
_GOAL_PRESETS = ("adt", "mogaze", "gimo", "hd-epic")
_FIRST_TEXT = (0.205, 0.225)  # s after the suit, as in real sequences of known clocks
_WAITS = 0.5
_SHORTEST_ALONE = 3.1
"""Share of short activities after which people wait, and until when after their beginning, so that a text fits."""
_CLOSING = 0.8


@dataclass(frozen=True)
class Identity:
    """Name, person and split of one recording, known before it is acted out."""

    recording_id: str
    participant_id: str
    split: Literal["train", "validation", "test"]
    goal_preset: str | None
    """Of a prime-and-reach recording."""
    person: int


def identity_of(seed: int, index: int) -> Identity:
    """Return who acts in recording ``index`` of the corpus of a seed."""
    preset = _GOAL_PRESETS[(index // _EVERY) % len(_GOAL_PRESETS)] if index % _EVERY == _EVERY - 1 else None
    source = _source(seed, "activities") if preset is None else Source(_goal_seed(seed), preset, "default")
    assigned = assign(source, index, "person_and_room")
    participant = f"invented_{'a' if preset is None else preset.replace('-', '')}{assigned.person:03d}"
    name = f"20000101_s0_{participant}_act{seed}_n{index:05d}"
    return Identity(name, participant, assigned.split, preset, assigned.person)


def narrated_recording(seed: int, index: int) -> NarratedMotion:
    """Act out recording ``index``; it depends on nothing but the two numbers."""
    identity = identity_of(seed, index)
    if identity.goal_preset is not None:
        return _goal_recording(seed, index, identity, identity.goal_preset)
    source = _source(seed, "activities")
    person = draw_person(_preset(), identity.participant_id, source.generator("person", identity.person, "body"))
    script = _write_script(person, source.generator("recording", index, "plan"), _N_ACTIVITIES)
    motion = act_out(_preset(), script, RATE, source.generator("recording", index, "motion"))
    words = source.generator("recording", index, "narration")
    return NarratedMotion(
        recording_id=identity.recording_id,
        participant_id=identity.participant_id,
        split=identity.split,
        rate=RATE,
        joints=motion.joints,
        rotations=motion.rotations,
        head_rotation=motion.head_rotation,
        eye=motion.eye,
        planted=motion.planted,
        neck_tilt_deg=float(np.rad2deg(person.body.neck_tilt)),
        narrations=narrate(script, motion, RATE, words),
    )


def _write_script(person: Person, rng: np.random.Generator, n_activities: int) -> Script:
    """Draw one activity after the other; people stand up before they walk on."""
    writer = ScriptWriter(person, rng)
    writer.now = writer.draw(*_FIRST_TEXT)
    stand(writer)
    for _ in range(n_activities):
        last = writer.script.acts[-1]
        waits = last.name in SHORT and writer.rng.random() < _WAITS
        writer.now = max(writer.now + writer.draw(*PAUSE), last.begin + _SHORTEST_ALONE if waits else 0.0)
        choices = SITTING if writer.is_seated else STANDING
        weights = np.array(list(choices.values()))
        list(choices)[int(rng.choice(len(weights), p=weights / weights.sum()))](writer)
    writer.script.end = writer.now + _CLOSING
    return writer.script


def _preset() -> Preset:
    return replace(PRESETS[_BASE_PRESET], name="activities", work_pose=None, speed=1.0)


def _source(seed: int, preset: str) -> Source:
    return Source(seed, preset, "default")


def _goal_seed(seed: int) -> int:
    """Return the seed of the prime-and-reach recordings, which nobody gives to a benchmark table."""
    drawn = named_generator("prbench-synth", GENERATOR_VERSION, seed, "corpus", "goals").integers(2**40, 2**60)
    return int(drawn)


def _goal_recording(seed: int, index: int, identity: Identity, preset: str) -> NarratedMotion:
    performance = perform(preset, seed=_goal_seed(seed), index=index, n_events=N_EVENTS, rate=RATE, provocations={})
    words = Source(seed, "corpus", "default").generator("recording", index, "narration")
    return NarratedMotion(
        recording_id=identity.recording_id,
        participant_id=identity.participant_id,
        split=identity.split,
        rate=RATE,
        joints=performance.joints,
        rotations=performance.rotations,
        head_rotation=performance.head_rotation,
        eye=performance.eye,
        planted=performance.planted,
        neck_tilt_deg=performance.person.neck_tilt_deg,
        narrations=narrate_events(performance, words),
    )
