"""Differences between the five imitated datasets.

Sources: docs/specification/synthetic-recordings.md#world, docs/specification/synthetic-recordings.md#person,
docs/specification/synthetic-recordings.md#base-motion and docs/specification/synthetic-recordings.md#statistics.

Most constants are those of the page. Tuned here, so that the means of
docs/specification/synthetic-recordings.md#statistics are met within a third of their spread: the sizes of the free
floor (hd-epic, adt, gimo), ``edge`` (mogaze, gimo), carry pose, gap and surface weights of mogaze, head gain of hot3d,
the weights of the gaps of adt, and the speed of gimo (.70 on the page, for a cube as the goal; with the wrist alone as
the goal primes come later).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal


@dataclass(frozen=True)
class SurfaceKind:
    """A kind of furniture on which objects stand."""

    name: str
    height: float
    depth: float
    weight: float
    """Share of the goals that lie on surfaces of this kind."""


@dataclass(frozen=True)
class ObjectKind:
    """A kind of object; without extents a box is drawn."""

    name: str
    category: str
    half_extents: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Preset:
    """Every constant in which one dataset's world and people differ from the others'. Metres, seconds, degrees."""

    name: str
    room: tuple[float, float]
    """Free floor between the front edges of the furniture: x, z."""
    surfaces: tuple[SurfaceKind, ...]
    n_surfaces: int
    same_surface: float
    """Probability that the next goal is on the surface one stands at."""
    near: float
    """Probability that the next spot is drawn around the previous one."""
    spread: float
    edge: tuple[float, float]
    """Distance of the pelvis from the front edge when standing before it."""
    objects: tuple[ObjectKind, ...]
    gap: tuple[tuple[float, float, float], ...]
    """Planned prime gap: weight, median and log-sd of each log-normal part; empty: gaze follows the motor start."""
    idle: tuple[float, float]
    speed: float
    unprimed: float
    near_miss: float
    head_gain: float
    chest_gain: float
    prime_look: float
    """Median length of the first look at a goal."""
    spine_up: tuple[float, float, float]
    """Upward parts of pelvis-spine1, spine1-spine2, spine2-spine3, fractions of stature."""
    neck_offset: tuple[float, float, float]
    neck_length: float
    neck_tilt_deg: float
    grasp: Literal["fingertips", "wrapped", "wrist"]
    work_pose: tuple[float, float, float] | None
    """Waiting hands relative to the shoulder (outwards, up, forward; fractions of stature); None: hanging."""
    carry_pose: tuple[float, float, float]
    work_looks: float
    """Share of the fill fixations that go to the own hands or the work area."""
    spot_spacing: float = 0.16
    puts: bool = True
    table_only: bool = False
    """One table, people shift along it instead of walking."""
    seated_share: float = 0.0


_SMPL_SPINE = (0.0756, 0.0823, 0.033)
_SMPL_NECK = (0.0, 0.126, -0.012)
_OPTICAL_NECK = (0.0, 0.100, -0.004)
_CARRY = (-0.05, -0.17, 0.19)

_KITCHEN = tuple(
    ObjectKind(name, name)
    for name in (
        "mug", "plate", "bowl", "pan", "pot", "knife block", "salt", "pepper mill", "oil bottle", "milk carton",
        "jar", "tin", "kettle", "glass", "cutting board", "sponge", "towel", "spatula", "flour bag", "egg box",
    )
)  # fmt: skip

_MOGAZE = (
    *(ObjectKind(f"cup_{c}", "cup", (0.041, 0.035, 0.040)) for c in ("red", "green", "blue", "pink")),
    *(ObjectKind(f"plate_{c}", "plate", (0.092, 0.0035, 0.092)) for c in ("red", "green", "blue", "pink")),
    ObjectKind("jug", "jug", (0.062, 0.145, 0.076)),
    ObjectKind("bowl", "bowl", (0.142, 0.053, 0.190)),
)

_HOT3D = tuple(
    ObjectKind(name, name)
    for name in (
        "mug_white", "bowl", "bottle_mustard", "bottle_ranch", "can_soup", "can_parmesan", "carton_milk",
        "carton_oj", "cellphone", "dino_toy", "dvd_remote", "flask", "food_vegetables", "holder_black",
        "keyboard", "mouse", "plate_bamboo", "potato_masher", "puzzle_toy", "vase",
    )
)  # fmt: skip

_ADT = tuple(
    ObjectKind(name, category)
    for name, category in (
        ("BlackCeramicMug", "cup"), ("WhiteMug", "cup"), ("GlassCup", "cup"), ("WoodenBowl", "bowl"),
        ("BlackCeramicBowl", "bowl"), ("WhiteBowl", "bowl"), ("DinoToy", "toy"), ("BirdHouseToy", "toy"),
        ("CoffeeCan", "can"), ("TomatoSoupCan", "can"), ("CrackerBox", "box"), ("CocoaBox", "box"),
        ("GreenDecorationTall", "decoration"), ("Vase", "vase"), ("Candle", "candle"), ("BookDeepLearning", "book"),
        ("Clock", "clock"), ("PictureFrame", "picture frame"), ("Jar", "jar"), ("WaterBottle", "bottle"),
        ("SaltShaker", "shaker"), ("FlowerPot", "flower pot"), ("TissueBox", "box"), ("Mortar", "mortar"),
    )
)  # fmt: skip

_GIMO = tuple(ObjectKind(name, name, (0.05, 0.05, 0.05)) for name in ("cup", "book", "laptop", "pillow", "bottle"))

_TABLE = SurfaceKind("table", 0.74, 0.70, 0.35)

_ALL = (
    Preset(
        name="hd-epic",
        room=(2.6, 2.2),
        surfaces=(
            SurfaceKind("counter", 0.91, 0.6, 0.75),
            SurfaceKind("cupboard", 1.40, 0.3, 0.15),
            SurfaceKind("drawer", 0.68, 0.4, 0.10),
        ),
        n_surfaces=5,
        same_surface=0.80,
        near=0.45,
        spread=0.35,
        edge=(0.20, 0.30),
        objects=_KITCHEN,
        gap=((0.60, 2.2, 0.70), (0.40, 7.0, 0.25)),
        idle=(2.2, 0.8),
        speed=0.85,
        unprimed=0.12,
        near_miss=0.08,
        head_gain=1.0,
        chest_gain=0.0,
        prime_look=0.62,
        spine_up=_SMPL_SPINE,
        neck_offset=_SMPL_NECK,
        neck_length=0.0593,
        neck_tilt_deg=38.3,
        grasp="wrapped",
        work_pose=(-0.03, -0.20, 0.20),
        carry_pose=_CARRY,
        work_looks=0.35,
    ),
    Preset(
        name="mogaze",
        room=(2.15, 1.95),
        surfaces=(  # the high shelf is drawn more often than wanted: shorter people cannot reach it and draw again
            SurfaceKind("table", 0.72, 0.6, 0.23),
            SurfaceKind("shelf", 1.20, 0.24, 0.23),
            SurfaceKind("low shelf", 0.42, 0.24, 0.14),
            SurfaceKind("high shelf", 1.55, 0.24, 0.40),
        ),
        n_surfaces=4,
        same_surface=0.10,
        near=0.10,
        spread=0.35,
        edge=(0.34, 0.47),
        objects=_MOGAZE,
        gap=((1.0, 1.54, 0.42),),
        idle=(0.7, 0.6),
        speed=1.0,
        unprimed=0.05,
        near_miss=0.06,
        head_gain=0.93,
        chest_gain=-0.10,
        prime_look=0.62,
        spine_up=(0.0706, 0.0859, 0.0344),
        neck_offset=_OPTICAL_NECK,
        neck_length=0.080,
        neck_tilt_deg=7.4,
        grasp="wrapped",
        work_pose=None,
        carry_pose=(0.02, -0.275, 0.10),
        work_looks=0.0,
    ),
    Preset(
        name="hot3d",
        room=(2.4, 2.4),
        surfaces=(SurfaceKind("table", 0.92, 0.70, 1.0),),
        n_surfaces=1,
        same_surface=1.0,
        near=0.6,
        spread=0.4,
        edge=(0.14, 0.22),
        objects=_HOT3D,
        gap=((1.0, 1.45, 0.50),),
        idle=(1.4, 0.7),
        speed=0.80,
        unprimed=0.08,
        near_miss=0.08,
        head_gain=0.90,
        chest_gain=-0.05,
        prime_look=0.62,
        spine_up=_SMPL_SPINE,
        neck_offset=_SMPL_NECK,
        neck_length=0.0593,
        neck_tilt_deg=38.3,
        grasp="wrapped",
        work_pose=(-0.03, -0.24, 0.11),
        carry_pose=_CARRY,
        work_looks=0.35,
        spot_spacing=0.13,
        table_only=True,
        seated_share=0.3,
    ),
    Preset(
        name="adt",
        room=(4.2, 3.2),
        surfaces=(
            SurfaceKind("counter", 0.90, 0.6, 0.35),
            _TABLE,
            SurfaceKind("shelf", 1.35, 0.3, 0.15),
            SurfaceKind("low table", 0.45, 0.5, 0.15),
        ),
        n_surfaces=8,
        same_surface=0.74,
        near=0.45,
        spread=0.35,
        edge=(0.20, 0.30),
        objects=_ADT,
        gap=((0.36, 3.2, 0.50), (0.64, 8.0, 0.22)),
        idle=(2.8, 0.7),
        speed=0.90,
        unprimed=0.15,
        near_miss=0.08,
        head_gain=1.0,
        chest_gain=0.18,
        prime_look=0.80,
        spine_up=(0.0756, 0.0577, 0.0577),
        neck_offset=_OPTICAL_NECK,
        neck_length=0.080,
        neck_tilt_deg=7.4,
        grasp="fingertips",
        work_pose=None,
        carry_pose=_CARRY,
        work_looks=0.0,
    ),
    Preset(
        name="gimo",
        room=(4.7, 4.1),
        surfaces=(
            SurfaceKind("table", 0.74, 0.7, 0.50),
            SurfaceKind("shelf", 1.20, 0.3, 0.25),
            SurfaceKind("counter", 0.90, 0.6, 0.25),
        ),
        n_surfaces=8,
        same_surface=0.0,
        near=0.10,
        spread=0.35,
        edge=(0.26, 0.38),
        objects=_GIMO,
        gap=(),
        idle=(2.5, 0.6),
        speed=0.66,
        unprimed=0.10,
        near_miss=0.06,
        head_gain=1.06,
        chest_gain=0.16,
        prime_look=1.0,
        spine_up=_SMPL_SPINE,
        neck_offset=_SMPL_NECK,
        neck_length=0.080,
        neck_tilt_deg=7.4,
        grasp="wrist",
        work_pose=None,
        carry_pose=_CARRY,
        work_looks=0.0,
        puts=False,
    ),
)

PRESETS: Mapping[str, Preset] = MappingProxyType({preset.name: preset for preset in _ALL})
"""The five presets by name."""
