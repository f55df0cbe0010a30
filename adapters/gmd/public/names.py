"""What the parameters of our networks are called in the original's checkpoints."""

from __future__ import annotations

import re

_RENAMED = (
    (r"^time_embedding", "embed_timestep.time_embed"),
    (r"^text_embedding", "embed_text"),
    (r"^condition", "unet.time_mlp"),
    (r"^head\.0\.convolution", "unet.final_conv.0.block.0"),
    (r"^head\.0\.norm", "unet.final_conv.0.block.2"),
    (r"^head\.1", "unet.final_conv.1"),
    (r"^middle\.0", "unet.mid_block1"),
    (r"^middle\.1", "unet.mid_block2"),
    (r"^(down|up)\.(\d+)\.blocks\.(\d)", r"unet.\1s.\2.\3"),
    (r"^(down|up)\.(\d+)\.resample", r"unet.\1s.\2.3.conv"),
    (r"\.first\.convolution\.", ".blocks.0.block1.0."),
    (r"\.first\.norm\.", ".blocks.0.block1.2."),
    (r"\.second\.convolution\.", ".blocks.1.block.0."),
    (r"\.second\.norm\.", ".blocks.1.block.2."),
    (r"\.condition\.", ".time_mlp.1."),
    (r"\.skip\.", ".residual_conv."),
)
_NOT_LEARNT = re.compile(r"clip_model\.|(embed_timestep\.)?sequence_pos_encoder\.pe$")


def original_name(name: str) -> str:
    """The original's name of a parameter of :class:`prbench_adapters.gmd.unet.TemporalUNet`."""
    for pattern, replacement in _RENAMED:
        name = re.sub(pattern, replacement, name)
    return name


def is_learnt(original: str) -> bool:
    """Whether an entry of a checkpoint is a network's own: no table of sinusoids, and nothing of frozen CLIP."""
    return _NOT_LEARNT.match(original) is None
