"""Shapes of the report of ``prbench analyse errors``; nothing here needs arrays."""

from __future__ import annotations

from pathlib import Path

import msgspec


class Group(msgspec.Struct, frozen=True, kw_only=True):
    """What the motions of one group of sequences lack: all of them, those of one layout, or those of one bin.

    Attributes:
        by: ``all``, ``layout`` (where there are several), ``bearing`` (degrees), ``distance``, ``height`` (metres) or
            ``prime gap`` (seconds).
        name: The layout, or the bin's ends.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        primed: Prime Success, mean over motions.
        looking: Share of the motions of each cause of Prime Success (docs/error-budget.md#prime-success).
        miss_deg: Median angle between ray and goal in the best frame, degrees; null without any.
        miss_up_deg: Median of the ray's elevation minus the goal's in that frame, degrees; positive above the goal.
        miss_aside_deg: Median size of the sideways part, degrees.
        look_time: Median time of the best frame after the recorded prime time, seconds.
        stays: Share whose ray stays on the goal in the window.
        stays_with_elevation: Share whose ray would, if it had the goal's elevation.
        stays_with_azimuth: Share whose ray would, if it had the goal's azimuth.
        reached: Reach Success, mean over motions.
        reaching: Share of the motions of each cause of Reach Success (docs/error-budget.md#reach-success).
        smallest: Median of the smallest distance of a wrist from the goal, metres.
        skating: Mean Foot Skating.
        slides: Mean share of frame transitions with a slow slide.
        slides_in: The same up to the prime time (``before``), from there to the last second (``way``), and in it
            (``end``).
        bone_change: Mean of the largest relative change of a bone.
        worst_bones: Share of the motions in which each bone changes most; the three most frequent ones.
    """

    by: str
    name: str
    sequences: int
    recordings: int
    primed: float
    looking: dict[str, float]
    miss_deg: float | None
    miss_up_deg: float | None
    miss_aside_deg: float | None
    look_time: float | None
    stays: float
    stays_with_elevation: float
    stays_with_azimuth: float
    reached: float
    reaching: dict[str, float]
    smallest: float
    skating: float
    slides: float
    slides_in: dict[str, float | None]
    bone_change: float
    worst_bones: dict[str, float]


class AngleGain(msgspec.Struct, frozen=True, kw_only=True):
    """How far a head follows its goal: the line of an angle of its ray against that angle of the goal.

    Attributes:
        who: ``method``, ``people`` or ``beside``.
        layout: ``all`` for all motions together; where there are several datasets, also the name of each.
        angle: ``elevation`` or ``azimuth``, in the best frame.
        slope: 1 for a head that follows its goal, 0 for one that ignores it.
        offset_deg: Angle of the ray for a goal at angle 0, degrees.
        correlation: Correlation of both angles.
        motions: Number of motions.
    """

    who: str
    layout: str
    angle: str
    slope: float
    offset_deg: float
    correlation: float
    motions: int


class Parts(msgspec.Struct, frozen=True, kw_only=True):
    """Where the successes of one rate are lost; the first six shares add up to 1.

    Attributes:
        metric: ``prime_success`` or ``reach_success``.
        layout: ``all`` for all sequences together; where there are several datasets, also the name of each.
        sequences: Number of sequences.
        always: Sequences of which every sample succeeds.
        noise: Sequences of which some samples succeed: what the best of k samples wins over the worst.
        optimisation: Sequences of which no sample succeeds, but one of the run beside it does.
        representation: Of the rest, those where people succeed, but not after their motion went through the features.
        not_learnt: Of the rest, those where people succeed through the features as well.
        nor_people: The others: nobody succeeds.
        samples: Motions a sequence, k.
        mean: The method's rate.
        best_of_k: Rate of sequences with a sample that succeeds.
        people: Rate of recorded people.
        through_features: Rate of recorded people's motion through the features that models learn from, and back.
    """

    metric: str
    layout: str
    sequences: int
    always: float
    noise: float
    optimisation: float
    representation: float
    not_learnt: float
    nor_people: float
    samples: int
    mean: float
    best_of_k: float
    people: float
    through_features: float


class Beside(msgspec.Struct, frozen=True, kw_only=True):
    """A run beside another one, on the sequences and samples that both have.

    Attributes:
        run: Folder of the run beside.
        options: Its method's options.
        metric: ``prime_success`` or ``reach_success``.
        sequences: Number of sequences that both have.
        rate: Rate of the run.
        rate_beside: Rate of the run beside.
        gained: Share of the motions that succeed in the run beside alone.
        lost: Share of the motions that succeed in the run alone.
    """

    run: Path
    options: dict[str, str]
    metric: str
    sequences: int
    rate: float
    rate_beside: float
    gained: float
    lost: float


class RunBudget(msgspec.Struct, frozen=True, kw_only=True):
    """The error budget of one run.

    Attributes:
        run: The run folder.
        method: Name of the method.
        condition: What it was given.
        options: Its options.
        split: Split of the sequences.
        samples: Motions a sequence.
        synthetic: The people are synthetic.
        method_groups: The run's motions, by group.
        people_groups: Recorded motions of the same sequences, by the same groups.
        gains: Slopes of elevation and azimuth.
        parts: Where successes are lost.
        beside: Comparison with the run beside; empty without one.
    """

    run: Path
    method: str
    condition: str
    options: dict[str, str]
    split: str
    samples: int
    synthetic: bool
    method_groups: list[Group]
    people_groups: list[Group]
    gains: list[AngleGain]
    parts: list[Parts]
    beside: list[Beside]


class ErrorBudgetReport(msgspec.Struct, frozen=True, kw_only=True):
    """Error budgets of runs.

    Attributes:
        runs: One entry a run.
        out: Folder with one row a motion (``motions.parquet``, ``motions.csv``); null without ``--out``.
    """

    runs: list[RunBudget]
    out: Path | None
