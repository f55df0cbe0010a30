"""Orders in which other programs write joints, with the names of :class:`prbench.geometry.skeleton.Joint`."""

from __future__ import annotations

from dataclasses import dataclass

from prbench.geometry.skeleton import CHAINS, Joint

_LEG = ("hip", "knee", "ankle", "foot")
_ARM = ("collar", "shoulder", "elbow", "wrist")
_TRUNK = ("spine1", "spine2", "spine3")
_TOP = ("neck", "head")
_FOREIGN = (
    "Write its map for prbench.representation.converters.JointMap, which turns joints of other skeletons into the 22."
)
_NAMES = tuple(joint.name.lower() for joint in Joint)


@dataclass(frozen=True)
class Order:
    """An order of joints."""

    name: str
    joints: tuple[str, ...]
    """In the order of the file; a joint that the 22 do not have has a name of its own."""
    remedy: str = ""
    """Instead of the index that puts the 22 joints into place."""

    def places(self) -> dict[str, int]:
        """Map the name of each joint to its place."""
        return {joint: place for place, joint in enumerate(self.joints)}

    @property
    def holds_all(self) -> bool:
        """True if it holds all 22 joints."""
        return set(_NAMES) <= set(self.joints)

    def index(self) -> tuple[int, ...]:
        """``joints[:, index]`` stands in HumanML3D's order."""
        places = self.places()
        return tuple(places[name] for name in _NAMES)


def _unique(joints: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(joints))


def _depth_first_orders() -> tuple[Order, ...]:
    orders = []
    for first, second in (("left", "right"), ("right", "left")):
        for trunk_first in (False, True):
            for arms_before_head in (False, True):
                start = "trunk" if trunk_first else "legs"
                top = "arms before the head" if arms_before_head else "head before the arms"
                if (first, trunk_first, arms_before_head) == ("right", False, False):
                    continue  # the chain order of HumanML3D
                name = f"depth-first order, as in BVH files ({start} first, {first} side first, {top})"
                orders.append(
                    _depth_first(name, first, second, trunk_first=trunk_first, arms_before_head=arms_before_head)
                )
    return tuple(orders)


def _depth_first(name: str, first: str, second: str, *, trunk_first: bool, arms_before_head: bool) -> Order:
    legs = _side(first, _LEG) + _side(second, _LEG)
    arms = _side(first, _ARM) + _side(second, _ARM)
    upper = _TRUNK + (arms + _TOP if arms_before_head else _TOP + arms)
    return Order(name, ("pelvis", *(upper + legs if trunk_first else legs + upper)))


def _side(side: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for part in parts)


_CHAIN_ORDER = Order(
    "kinematic chain order of HumanML3D", _unique(tuple(_NAMES[joint] for chain in CHAINS for joint in chain))
)
ORDERS_OF_22: tuple[Order, ...] = (
    _CHAIN_ORDER,
    *_depth_first_orders(),
    Order("alphabetical order (left_ankle, left_collar …)", tuple(sorted(_NAMES))),
    Order("reversed order", _NAMES[::-1]),
    Order(
        "all left joints, then all right ones, behind those of the middle",
        tuple(sorted(_NAMES, key=lambda name: ("left" in name) + 2 * ("right" in name))),
    ),
    Order("pelvis at the end", (*_NAMES[1:], "pelvis")),
)
"""Full orders of the 22 joints other than HumanML3D's own."""
OTHER_ORDERS: tuple[Order, ...] = (
    Order(
        "OpenPose COCO (18 joints)",
        ("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
         "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
         "right_ear", "left_ear"),
        _FOREIGN,
    ),
    Order(
        "KIT motion-language (21 joints)",
        ("pelvis", "spine1", "spine3", "neck", "head", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder",
         "right_elbow", "right_wrist", "left_hip", "left_knee", "left_ankle", "left_heel", "left_foot", "right_hip",
         "right_knee", "right_ankle", "right_heel", "right_foot"),
        _FOREIGN,
    ),
    Order("the 22 joints without the pelvis (21 joints)", _NAMES[1:], "Put the pelvis back at place 0."),
)  # fmt: skip
"""Orders with another number of joints that are not among ``prbench.representation.converters.JOINT_MAPS``."""
