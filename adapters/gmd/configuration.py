"""Architecture of both networks of GMD: one frozen record, stored as JSON beside their weights."""

from __future__ import annotations

from typing import Literal

import msgspec

GROUPS = 8
"""Groups of every group normalisation; widths are multiples of it."""


class GMDConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes, conditions and data of the motion and the trajectory network (docs/specification/gmd.md#networks).

    The defaults are those of the released models, but for the text encoder, whose vectors are averaged over the word
    pieces to one vector a caption.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    motion_widths: tuple[int, ...] = (1024, 1024, 1024, 1024)
    """Channels of each level of the motion network; every further level halves the frames."""
    trajectory_widths: tuple[int, ...] = (64, 128, 256)
    condition_width: int = 512
    """Numbers of the vector of step and text, in both networks."""
    emphasis: float = 10.0
    """Weight c of the three absolute root features in the random projection."""
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    diffusion_steps: int = 1000
    representation: Literal["continuous", "reference"] = "continuous"
    fps: float = 20.0
    max_frames: int = 241
    padded_frames: int = 224
    """Every motion is padded with zeros to this length before a network sees it: group normalisation takes its
    statistics over padding too, so the length must not depend on the batch."""
    padding_step: int = 8
    """Motions that are longer than ``padded_frames`` are padded to the next multiple of this."""
    uniform_skeleton: bool = False
    """True if the features are those of bodies rescaled to HumanML3D's skeleton.

    Source: docs/specification/pr-model.md#data-and-features.
    """

    def __post_init__(self) -> None:
        for name in ("motion_widths", "trajectory_widths"):
            widths = getattr(self, name)
            if not widths or any(width < GROUPS or width % GROUPS for width in widths):
                raise ValueError(f"'{name}' must be one or more positive multiples of {GROUPS}, found {list(widths)}")
        for name in ("text_dimension", "diffusion_steps", "max_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if self.condition_width < 2 or self.condition_width % 2:
            raise ValueError(f"'condition_width' must be even and positive, found {self.condition_width}")
        if self.emphasis <= 0 or self.fps <= 0:
            raise ValueError(f"'emphasis' and 'fps' must be positive, found {self.emphasis} and {self.fps}")
        for name in ("padded_frames", "padding_step"):
            if getattr(self, name) < 1 or getattr(self, name) % self.stride:
                raise ValueError(
                    f"'{name}' must be a multiple of {self.stride}, because the levels of the networks halve the"
                    f" frames, found {getattr(self, name)}"
                )

    @property
    def stride(self) -> int:
        """Divisor of the number of frames that lets it be halved between all levels."""
        return 2 ** (max(len(self.motion_widths), len(self.trajectory_widths)) - 1)

    def window(self, n_frames: int) -> int:
        """Frames with padding: ``padded_frames``, for longer motions the next multiple of ``padding_step``."""
        return max(self.padded_frames, -(-n_frames // self.padding_step) * self.padding_step)
