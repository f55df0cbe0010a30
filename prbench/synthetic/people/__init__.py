"""Procedural people who prime, walk, reach, carry and place, with everything known."""

from prbench.synthetic.people.perform import perform
from prbench.synthetic.people.person import PRESETS, Preset

__all__ = ["PRESETS", "Preset", "perform"]
