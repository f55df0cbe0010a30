"""The tiny networks of the sample folder as ours: the published programs' parameter names mapped to our own."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

Arrays = Mapping[str, np.ndarray]
_Names = Sequence[tuple[str, str]]

_DENOISER = (
    (r"^sequence_embedding", "places"),
    (r"^joint_embed", "input"),
    (r"^cond_embed", "condition"),
    (r"^time_embed", "time"),
    (r"^out\.", "output."),
    (r"^temporal_decoder_blocks", "blocks"),
    (r"sa_block\.norm", "norm"),
    (r"sa_block\.proj_out", "attention_style"),
    (r"ca_block\.norm", "cross.norm"),
    (r"ca_block\.text_norm", "cross.condition_norm"),
    (r"ca_block\.query", "cross.query"),
    (r"ca_block\.proj_out", "cross.style"),
    (r"ffn\.linear1", "expand"),
    (r"ffn\.linear2", "contract"),
    (r"ffn\.proj_out", "feed_forward_style"),
    (r"emb_layers\.1", "scale_shift"),
    (r"out_layers\.2", "output"),
)
_ENCODER = (
    (r"^gaze_encoder\.gaze_cnn", "gaze"),
    (r"^pose_encoder\.", "pose."),
    (r"^(?=start_gcn|residual_gcns|end_gcn)", "fusion."),
    (r"start_gcn", "start"),
    (r"end_gcn", "end"),
    (r"residual_gcns", "blocks"),
    (r"\.gcn\.", ".attention."),
    (r"\.ln\.", ".norm."),
    (r"attention_weights_temporal", "over_steps"),
    (r"attention_weights", "over_nodes"),
    (r"feature_weights", "channels"),
)
_CVAE = (
    (r"^x_rnn\.rnn_f\.(.*)", r"past.\1_l0"),
    (r"^e_rnn\.rnn_f\.(.*)", r"future.\1_l0"),
    (r"^e_mlp", "posterior"),
    (r"^e_mu", "mean"),
    (r"^e_logvar", "log_variance"),
    (r"^drnn_mlp", "decoder.first_state"),
    (r"^d_rnn\.rnn_f", "decoder.cell"),
    (r"^d_mlp", "decoder.mlp"),
    (r"^d_out", "decoder.output"),
)
_DLOW = ((r"^x_rnn\.rnn_f\.(.*)", r"past.\1_l0"), (r"^head_A", "scales"), (r"^head_b", "shifts"))
_PAST = (
    (r"^x_rnn\.rnn_f\.(.*)", r"encoder.\1_l0"),
    (r"^drnn_mlp", "decoder.first_state"),
    (r"^d_rnn\.rnn_f", "decoder.cell"),
    (r"^d_mlp", "decoder.mlp"),
    (r"^d_out", "decoder.output"),
)
_BEHAVIOUR = (
    (r"^b_enc\.rnn", "encoder"),
    (r"^b_enc\.mu_fn", "mean"),
    (r"^b_enc\.std_fn", "log_deviation"),
    (r"\.beta", ".shift"),
    (r"\.gamma", ".scale"),
    (r"conv\.bias", "linear.bias"),
    (r"conv\.weight_g", "linear.parametrizations.weight.original0"),
    (r"conv\.weight_v", "linear.parametrizations.weight.original1"),
    (r"^decoder\.rnn\.(.*)", r"coupler.\1_l0"),
    (r"^decoder\.n_out", "offset"),
    (r"^context_encoder", "context"),
)
_AUXILIARY = ((r"^decoder\.rnn\.(.*)", r"auxiliary.\1_l0"), (r"^decoder\.n_out", "auxiliary_pose"))
_UNET = (
    (r"^time_embed", "time"),
    (r"^middle_block", "middle"),
    (r"^output_blocks", "up"),
    (r"^out\.", "output."),
    (r"in_layers\.0", "first_norm"),
    (r"in_layers\.2", "first"),
    (r"emb_layers\.1", "scale_shift"),
    (r"out_layers\.0", "second_norm"),
    (r"out_layers\.3", "second"),
    (r"skip_connection", "skip"),
    (r"qkv", "query_key_value"),
    (r"proj_out", "output"),
)


def load(samples: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of one file."""
    with np.load(samples / "metrics" / "networks" / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(array))


def largest_difference(found: Tensor, expected: np.ndarray) -> float:
    assert tuple(found.shape) == expected.shape
    return float(np.abs(found.detach().double().numpy() - expected.astype(np.float64)).max())


def agree(arrays: Arrays, within: float, suffix: str = "", **found: Tensor) -> None:
    """Hold results against the arrays of their names (with a suffix behind each)."""
    for name, value in found.items():
        assert largest_difference(value, arrays[name + suffix]) <= within, name


def agree_in_size(arrays: Arrays, **found: Tensor) -> None:
    """Hold losses against the numbers of their names, to a hundred-thousandth of each."""
    for name, value in found.items():
        np.testing.assert_allclose(value.detach().numpy(), arrays[name], rtol=1e-5, err_msg=name)


def agree_in_gradient(arrays: Arrays, network: nn.Module) -> None:
    """Hold the norm of the gradient of all parameters that are trained against the published one."""
    gradients = [parameter.grad for parameter in network.parameters() if parameter.requires_grad]
    norm = torch.stack([gradient.norm() for gradient in gradients]).norm()
    np.testing.assert_allclose(norm.numpy(), arrays["grad_norm"], rtol=1e-4)


def weights(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    start = f"w/{prefix}"
    return {name.removeprefix(start): array for name, array in arrays.items() if name.startswith(start)}


def load_denoiser(network: nn.Module, arrays: Arrays, prefix: str = "") -> None:
    state = _renamed(weights(arrays, prefix), _DENOISER)
    for place in range(len(network.blocks)):
        block = f"blocks.{place}"
        own = [state.pop(f"{block}.sa_block.{part}.weight") for part in ("query", "key", "value")]
        state[f"{block}.query_key_value.weight"] = torch.cat(own)
        if f"{block}.ca_block.key.weight" in state:
            other = [state.pop(f"{block}.ca_block.{part}.weight") for part in ("key", "value")]
            state[f"{block}.cross.key_value.weight"] = torch.cat(other)
    network.load_state_dict(state)


def load_encoder(network: nn.Module, arrays: Arrays, prefix: str = "") -> None:
    state = _renamed(weights(arrays, prefix), _ENCODER)
    for name in state:
        if "over_" in name:
            heads = len(state[name])
            # One column a head, for two tokens behind one another.
            state[name] = state[name].reshape(heads, 2, -1)
    network.load_state_dict(state)


def load_cvae(network: nn.Module, arrays: Arrays, prefix: str = "") -> None:
    network.load_state_dict(_renamed(weights(arrays, prefix), _CVAE))


def load_dlow(network: nn.Module, arrays: Arrays) -> None:
    own = _renamed(weights(arrays, "sampler/"), _DLOW)
    frozen = _renamed(weights(arrays, "cvae/"), _CVAE)
    network.load_state_dict({**own, **{f"cvae.{name}": value for name, value in frozen.items()}})


def _renamed(arrays: Arrays, names: _Names) -> dict[str, Tensor]:
    state = {}
    for name, array in arrays.items():
        for pattern, ours in names:
            name = re.sub(pattern, ours, name)
        # Every layer of a perceptron is followed by its tanh.
        name = re.sub(r"affine_layers\.(\d+)", lambda found: str(2 * int(found[1])), name)
        scale = 16.0 if array.dtype == np.int8 else 1.0
        state[name] = torch.from_numpy(array.astype(np.float32) / np.float32(scale))
    return state


def load_past(network: nn.Module, arrays: Arrays) -> None:
    network.load_state_dict(_renamed(weights(arrays, "observation/"), _PAST))


def load_behaviour(network: nn.Module, arrays: Arrays) -> None:
    state = _renamed(weights(arrays, "behaviour/"), _BEHAVIOUR)
    if "w/auxiliary/decoder.n_out.bias" in arrays:
        state |= _renamed(weights(arrays, "auxiliary/"), _AUXILIARY)
    else:
        # Files of the diffusion have no use for the auxiliary decoder.
        state |= {name: value for name, value in network.state_dict().items() if name.startswith("auxiliary")}
    for name in state:
        if name.endswith(("scale", "shift")):
            state[name] = state[name].flatten()
        elif "original" in name:
            state[name] = state[name].flatten(1)
    network.load_state_dict(state)


def load_unet(network: nn.Module, arrays: Arrays) -> None:
    state = _renamed(weights(arrays, "unet/"), _UNET)
    # Blocks of the way down are counted from the first convolution there.
    for name in [name for name in state if name.startswith("input_blocks.")]:
        _, place, rest = name.split(".", 2)
        state[f"down.{int(place) - 1}.{rest}" if int(place) else rest.replace("0.", "input.")] = state.pop(name)
    network.load_state_dict(state)
