"""The tiny networks of the sample folder as our denoisers: the reference's parameter names mapped to ours."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from prbench_adapters.diffusion.configuration import DenoiserConfiguration, EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser

_RENAMED = [
    (r"^input_process\.poseEmbedding", "frame_embedding"),
    (r"^output_process\.poseFinal", "head"),
    (r"^embed_timestep\.time_embed", "time_embedding"),
    (r"^embed_text", "text_embedding"),
    (r"^seqTrans(Encoder|Decoder)\.layers", "layers"),
    (r"self_attn\.in_proj_", "self_attention.query_key_value."),
    (r"self_attn\.out_proj", "self_attention.output"),
    (r"multihead_attn\.out_proj", "cross_attention.output"),
    (r"linear1", "feed_forward.expand"),
    (r"linear2", "feed_forward.contract"),
    (r"norm1", "self_attention_norm"),
]


def parameters(weights: dict[str, np.ndarray], architecture: str) -> dict[str, Tensor]:
    """Our state dict from the reference's arrays."""
    norms = {"encoder": {"norm2": "feed_forward_norm"}}.get(
        architecture, {"norm2": "cross_attention_norm", "norm3": "feed_forward_norm"}
    )
    state = {}
    for name, array in weights.items():
        for pattern, ours in [*_RENAMED, *norms.items()]:
            name = re.sub(pattern, ours, name)
        value = torch.from_numpy(array.astype(np.float32))
        if "multihead_attn.in_proj_" in name:
            width = len(value) // 3
            stem, kind = name.split("multihead_attn.in_proj_")
            state[f"{stem}cross_attention.query.{kind}"] = value[:width]
            state[f"{stem}cross_attention.key_value.{kind}"] = value[width:]
        else:
            state[name] = value
    return state


def load(samples: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of one file."""
    with np.load(samples / "metrics" / "networks" / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def denoiser(arrays: dict[str, np.ndarray], **changes: object) -> Denoiser:
    """The network of one file, ready to use; sizes are read from its arrays unless changed."""
    weights = {key[2:]: value for key, value in arrays.items() if key.startswith("w/")}
    architecture = "decoder" if any("Decoder" in key for key in weights) else "encoder"
    width, text_dimension = weights["embed_text.weight"].shape
    configuration = DenoiserConfiguration(
        **{
            "architecture": architecture,
            "width": width,
            "heads": 4,
            "layers": 2,
            "feed_forward": 32,
            "text_dimension": text_dimension,
            "diffusion_steps": 50,
            **changes,
        }
    )
    network = Denoiser(configuration)
    network.load_state_dict(parameters(weights, architecture))
    return network.eval().requires_grad_(False)


def condition(arrays: dict[str, np.ndarray]) -> EncodedCondition:
    """Text vectors (tokens, batch, dimension) of a file, batch first."""
    text = torch.from_numpy(arrays["text"]).transpose(0, 1).contiguous()
    padding = arrays.get("text_padding", np.zeros(text.shape[:2], dtype=bool))
    return EncodedCondition(text, torch.from_numpy(padding))


def features(array: np.ndarray) -> Tensor:
    """(batch, channel, frame) as (batch, frame, channel)."""
    return torch.from_numpy(array.astype(np.float32)).transpose(1, 2).contiguous()
