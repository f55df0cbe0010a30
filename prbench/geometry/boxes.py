"""Solid boxes around a motion, and how deep points lie in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of n sequences one after the other; box of row i are ``offsets[i]`` to ``offsets[i + 1] - 1``. Metres.

    Each sequence's boxes stand in that sequence's own frame.

    Raises:
        ValueError: if the arrays do not belong together.
    """

    centre: Float[np.ndarray, "boxes 3"]
    rotation: Float[np.ndarray, "boxes 3 3"]
    """Turns a vector of the box's own frame into the frame of the sequence."""
    half_extents: Float[np.ndarray, "boxes 3"]
    """Half the length of the edges along the box's own axes."""
    offsets: Int[np.ndarray, " n_and_1"]

    def __post_init__(self) -> None:
        count = len(self.centre)
        shapes = (self.centre.shape, self.rotation.shape, self.half_extents.shape)
        if shapes != ((count, 3), (count, 3, 3), (count, 3)):
            raise ValueError(f"expected centres, rotations and half extents of as many boxes, found {shapes}")
        if self.offsets[0] != 0 or self.offsets[-1] != count or (np.diff(self.offsets) < 0).any():
            raise ValueError(f"offsets must rise from 0 to {count}, found {self.offsets.tolist()}")

    def __len__(self) -> int:
        """Return the number of sequences."""
        return len(self.offsets) - 1

    @classmethod
    def joined(cls, parts: list[Boxes]) -> Boxes:
        """Join the boxes of several sequences, in the order given."""
        sizes = [np.diff(part.offsets) for part in parts]
        return cls(
            np.concatenate([np.empty((0, 3)), *(part.centre for part in parts)]),
            np.concatenate([np.empty((0, 3, 3)), *(part.rotation for part in parts)]),
            np.concatenate([np.empty((0, 3)), *(part.half_extents for part in parts)]),
            np.concatenate([[0], np.cumsum(np.concatenate([np.empty(0, dtype=np.int64), *sizes]))]).astype(np.int64),
        )

    def copied(self) -> Boxes:
        """The same boxes in arrays of their own."""
        return Boxes(self.centre.copy(), self.rotation.copy(), self.half_extents.copy(), self.offsets.copy())

    def part(self, start: int, stop: int) -> Boxes:
        """The boxes of the sequences ``start`` to ``stop - 1``, without copying."""
        begin = self.offsets[start]
        end = self.offsets[stop]
        return Boxes(
            self.centre[begin:end],
            self.rotation[begin:end],
            self.half_extents[begin:end],
            self.offsets[start : stop + 1] - begin,
        )

    def chosen(self, keep: Bool[np.ndarray, " boxes"]) -> Boxes:
        """The boxes where ``keep`` is true, each still with its sequence."""
        before = np.concatenate([[0], np.cumsum(keep)])
        return Boxes(self.centre[keep], self.rotation[keep], self.half_extents[keep], before[self.offsets])

    def of_rows(self, rows: Int[np.ndarray, " m"]) -> Boxes:
        """The boxes of some sequences, in the order given (copies)."""
        return Boxes.joined([self.part(int(row), int(row) + 1) for row in rows])

    def placed(self, transform: Float[np.ndarray, "4 4"]) -> Boxes:
        """The same boxes in another frame.

        Args:
            transform: Maps points of the present frame into the other one; rigid.
        """
        turn = transform[:3, :3]
        return Boxes(self.centre @ turn.T + transform[:3, 3], turn @ self.rotation, self.half_extents, self.offsets)

    def depth(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points boxes"]:
        """How deep each point lies in each box: the distance to the nearest side; negative outside. Metres.

        Args:
            points: In the frame of the boxes.
        """
        away = points[:, None] - self.centre
        local = np.einsum("pbi,bij->pbj", away, self.rotation)
        return (self.half_extents - np.abs(local)).min(axis=-1)

    def reached(self, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, " boxes"]:
        """The boxes that come into the space that the points span along the axes; no other one holds a point."""
        reach = (np.abs(self.rotation) * self.half_extents[:, None]).sum(axis=-1)
        low = points.min(axis=0)
        high = points.max(axis=0)
        return ((self.centre + reach >= low) & (self.centre - reach <= high)).all(axis=1)


def deepest(points: Float[np.ndarray, "frames joints 3"], boxes: Boxes) -> Float[np.ndarray, " frames"]:
    """Largest depth of any joint in any box in each frame, metres; 0 where no joint is in a box.

    Args:
        points: One motion.
        boxes: In its frame.
    """
    flat = points.reshape(-1, 3)
    near = boxes.chosen(boxes.reached(flat))
    largest = np.zeros(len(flat))
    # One box after the other: a scene of hundreds of boxes needs no more memory than one.
    for number in range(len(near.centre)):
        one = Boxes(
            near.centre[number : number + 1],
            near.rotation[number : number + 1],
            near.half_extents[number : number + 1],
            np.array([0, 1]),
        )
        np.maximum(largest, one.depth(flat)[:, 0], out=largest)
    return largest.reshape(points.shape[:2]).max(axis=1)
