"""The tiny networks of the sample folder as ours: the reference's parameter names mapped to ours."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from prbench.text import text_encoder
from prbench_adapters.dart.model import DartConfiguration, DartModel, FeatureScaling, LatentDenoiser, PrimitiveVAE
from prbench_adapters.diffusion.model import TextVectors

_LAYER = [
    (r"self_attn\.in_proj_", "self_attention.query_key_value."),
    (r"self_attn\.out_proj", "self_attention.output"),
    (r"linear1", "feed_forward.expand"),
    (r"linear2", "feed_forward.contract"),
    (r"norm1", "self_attention_norm"),
    (r"norm2", "feed_forward_norm"),
]
_DENOISER = [
    (r"^embed_timestep\.time_embed", "time_embedding"),
    (r"^embed_text", "text_embedding"),
    (r"^embed_history", "history_embedding"),
    (r"^embed_noise", "latent_embedding"),
    (r"^seqTransEncoder\.layers", "layers"),
    (r"^output_process", "head"),
]
_VAE = [
    (r"^global_motion_token", "distribution_tokens"),
    (r"^query_pos_(encoder|decoder)\.pe", r"\1_positions"),
    (r"input_blocks", "input_layers"),
    (r"middle_block", "middle_layer"),
    (r"output_blocks", "output_layers"),
    (r"linear_blocks", "joins"),
    (r"^encoder_latent_proj", "encoder_head"),
    (r"^decoder_latent_proj", "latent_embedding"),
    (r"^skel_embedding", "frame_embedding"),
    (r"^final_layer", "decoder_head"),
]


def load(samples: Path) -> dict[str, np.ndarray]:
    """The arrays of the file."""
    with np.load(samples / "metrics" / "networks" / "dart_rollout.npz", allow_pickle=False) as file:
        return dict(file)


def model(arrays: dict[str, np.ndarray]) -> DartModel:
    """The two networks of the file with its statistics, ready to use."""
    configuration = DartConfiguration(
        latent=16, vae_width=16, vae_heads=4, vae_layers=3, vae_feed_forward=32,
        width=16, heads=4, layers=2, feed_forward=32, dropout=0.0, text_dimension=512,
    )  # fmt: skip
    vae, denoiser = PrimitiveVAE(configuration), LatentDenoiser(configuration)
    vae.load_state_dict(_positions_cut(_parameters(arrays, "vae", _VAE), vae))
    denoiser.load_state_dict(_parameters(arrays, "denoiser", _DENOISER))
    return DartModel(
        vae,
        denoiser,
        scaling=FeatureScaling(tensor(arrays, "mean"), tensor(arrays, "std")),
        latent_std=float(arrays["latent_std"]),
        texts=TextVectors(text_encoder("hashed-ngrams")),
    )


def tensor(arrays: dict[str, np.ndarray], name: str) -> Tensor:
    """One array."""
    return torch.from_numpy(arrays[name])


def _parameters(arrays: dict[str, np.ndarray], network: str, renamed: list[tuple[str, str]]) -> dict[str, Tensor]:
    state = {}
    for name, array in arrays.items():
        if name.startswith(f"{network}/"):
            ours = name.removeprefix(f"{network}/")
            for pattern, replacement in [*renamed, *_LAYER]:
                ours = re.sub(pattern, replacement, ours)
            state[ours] = torch.from_numpy(array.astype(np.float32))
    return state


def _positions_cut(state: dict[str, Tensor], vae: PrimitiveVAE) -> dict[str, Tensor]:
    """The reference keeps 500 positions, (position, 1, width), of which a primitive takes the first ones."""
    for name in ("encoder_positions", "decoder_positions"):
        state[name] = state[name][: len(getattr(vae, name)), 0]
    return state
