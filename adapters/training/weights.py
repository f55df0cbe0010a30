"""Weights on disk: ``safetensors`` with a header that says what they are, and a JSON card beside them.

No file of this format can run code when it is opened. What a file holds is decided by its header: ``kind``,
``configuration`` (JSON) and ``representation``; a reader that expects something else says so before it looks at a
tensor. This module needs torch and safetensors only, so that an adapter may load with it.
"""

from __future__ import annotations

import json
import shlex
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import safetensors.torch
import torch
from safetensors import SafetensorError

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_whole, require
from prbench.files.storage import bytes_digest, write_bytes, write_json
from prbench.limits import LARGEST_HEADER

_FORMAT = "prbench-weights"
FORMAT_VERSION = "1"
_REPRESENTATION = "humanml3d-263"
_HALF_LIMIT = torch.finfo(torch.float16).max

_Configuration = TypeVar("_Configuration")


@dataclass(frozen=True, eq=False)
class Weights:
    """A weights file in memory.

    Attributes:
        tensors: Maps names to tensors, on the CPU; floating-point ones are float32 whatever the file holds.
        digest: SHA-256 of the file.
    """

    path: Path
    tensors: dict[str, torch.Tensor]
    metadata: dict[str, str]
    digest: str

    @property
    def kind(self) -> str:
        """Kind of network that the weights are of, such as ``denoiser``."""
        return self.metadata.get("kind", "")

    def configuration(self, kind: type[_Configuration]) -> _Configuration:
        """Return the network's configuration from the header.

        Raises:
            InputFileError: if it is not one of ``kind``.
        """
        try:
            return msgspec.json.decode(self.metadata.get("configuration", ""), type=kind)
        except msgspec.DecodeError as error:  # ValidationError is one of them
            remedy = "The weights were made by another version of prbench or by another program; train them again."
            about = {"expected": f"a {kind.__name__} as JSON", "found": str(error), "remedy": remedy}
            raise InputFileError(self.path, "configuration", **about) from error

    def require_same(self, configuration: msgspec.Struct, *, apart_from: Collection[str]) -> None:
        """Refuse to go on from these weights with a network of another configuration.

        Args:
            configuration: Configuration of the network that will be trained.
            apart_from: Its fields that may differ.

        Raises:
            InputFileError: naming the first field that differs, and how to keep the old values of all.
        """
        old = self.configuration(type(configuration))
        fields = [name for name in configuration.__struct_fields__ if name not in apart_from]
        different = [name for name in fields if getattr(configuration, name) != getattr(old, name)]
        if different:
            settings = []
            for name in different:
                value = getattr(old, name)
                text = value if isinstance(value, str) else json.dumps(msgspec.to_builtins(value))
                settings.append(f"--set {shlex.quote(f'model.{name}={text}')}")  # as a shell and TOML take it
            raise InputFileError(
                self.path,
                f"configuration.{different[0]}",
                expected=f"{getattr(configuration, different[0])}, as in the configuration of this training",
                found=f"{getattr(old, different[0])}",
                remedy=f"Add {' '.join(settings)}, or start from other weights.",
            )

    def require_representation(self, mode: str) -> None:
        """Refuse weights of other features than the configuration in the same header says.

        Args:
            mode: Mode of the representation: ``continuous`` or ``reference``.

        Raises:
            InputFileError: naming both.
        """
        _require_entry(self.path, self.metadata, "representation", representation_entry(mode))

    def part(self, prefix: str) -> dict[str, torch.Tensor]:
        """Tensors whose names begin with ``prefix`` and a dot, without both."""
        head = f"{prefix}."
        return {name.removeprefix(head): tensor for name, tensor in self.tensors.items() if name.startswith(head)}

    def load_into(self, module: torch.nn.Module, prefix: str) -> None:
        """Fill a module with the tensors ``<prefix>.<parameter>``.

        Raises:
            InputFileError: if one is missing, has another shape, or belongs to no parameter.
        """
        wanted = module.state_dict()
        found = self.part(prefix)
        for name, tensor in wanted.items():
            self.require(f"{prefix}.{name}", tuple(tensor.shape))
        unknown = sorted(set(found) - set(wanted))
        if unknown:
            raise self._misfit(f"{prefix}.{unknown[0]}", "only tensors of the configured network", "one more")
        module.load_state_dict(found)

    def require(self, name: str, shape: tuple[int, ...]) -> torch.Tensor:
        """Return the tensor of this name and shape.

        Raises:
            InputFileError: if there is none.
        """
        tensor = self.tensors.get(name)
        if tensor is None:
            raise self._misfit(name, f"a tensor of shape {shape}", "none of this name")
        if tuple(tensor.shape) != shape:
            raise self._misfit(name, f"shape {shape}", f"shape {tuple(tensor.shape)}")
        return tensor

    def _misfit(self, where: str, expected: str, found: str) -> InputFileError:
        remedy = "The file does not fit the configuration in its own header; train or download it again."
        return InputFileError(self.path, where, expected=expected, found=found, remedy=remedy)


def origin_of(start: Weights | None) -> tuple[str, ...]:
    """Return the line of a card about the initial weights of a training, where it has some."""
    return () if start is None else (f"initial weights {start.path.name}, sha256 {start.digest}",)


def start_from(path: Path | None, kind: str, sizes: msgspec.Struct, network: torch.nn.Module) -> tuple[str, ...]:
    """Fill a network with initial weights, where a training has some, and return the line of its card about them.

    Raises:
        InputFileError: if they are of another kind or configuration.
    """
    if path is None:
        return ()
    start = read_weights(path, kind=kind)
    start.require_same(sizes, apart_from=())
    start.load_into(network, "network")
    return origin_of(start)


def write_weights(
    path: Path,
    tensors: Mapping[str, torch.Tensor],
    metadata: Mapping[str, str],
    card: Mapping[str, Any],
    *,
    dtype: Literal["float32", "float16"] = "float32",
) -> None:
    """Write weights and their card, ``<name>.json`` beside them; each file whole or not at all.

    Args:
        path: ``<name>.safetensors``.
        tensors: Tensors by name, on any device.
        metadata: Header entries; ``format`` and ``format_version`` are added.
        card: What people and the leaderboard are told; anything that JSON can hold. Gets the digest of the
            weights file.
        dtype: Type of matrices. Vectors (biases, norms, statistics) weigh little and stay float32.

    Raises:
        StorageError: if a file cannot be written.
        ValueError: if a value is not finite, or too large for float16.
    """
    stored = {name: _stored(name, tensor, dtype) for name, tensor in tensors.items()}
    content = safetensors.torch.save(stored, metadata={**metadata, "format": _FORMAT, "format_version": FORMAT_VERSION})
    # The library writes the entries of the header in another order every time; they are sorted here.
    (length,) = struct.unpack("<Q", content[:8])
    found = json.loads(content[8 : 8 + length])
    found["__metadata__"] = dict(sorted(found["__metadata__"].items()))
    text = json.dumps(found, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)  # tensors begin at a multiple of 8
    content = struct.pack("<Q", len(text)) + text + content[8 + length :]
    write_bytes(path, content)
    write_json(path.with_suffix(".json"), {**card, "weights": path.name, "weights_sha256": bytes_digest(content)})


def _stored(name: str, tensor: torch.Tensor, dtype: str) -> torch.Tensor:
    tensor = tensor.detach().cpu().contiguous()
    if not tensor.is_floating_point():
        return tensor.clone()
    if not bool(torch.isfinite(tensor).all()):
        raise ValueError(f"tensor '{name}' holds NaN or infinity; the training has diverged.")
    # Vectors weigh little and suffer most from rounding.
    if dtype == "float32" or tensor.ndim < 2:
        return tensor.to(torch.float32).clone()  # safetensors refuses tensors that share memory
    if float(tensor.abs().max() if tensor.numel() else 0.0) > _HALF_LIMIT:
        raise ValueError(f"tensor '{name}' does not fit float16; save it as float32.")
    return tensor.to(torch.float16).clone()


def weights_header(kind: str, configuration: msgspec.Struct, representation: str) -> dict[str, str]:
    """Return the entries of a header that say what the weights are; the writer adds format and version.

    Args:
        kind: What the weights are of, such as ``denoiser``.
        configuration: Configuration of the network; is stored as JSON.
        representation: What the network sees, such as :func:`representation_entry` gives.
    """
    about = msgspec.json.encode(configuration).decode()
    return {"kind": kind, "configuration": about, "representation": representation}


def representation_entry(mode: str) -> str:
    """Return header entry ``representation`` of a network of motion features, such as ``humanml3d-263/continuous``."""
    return f"{_REPRESENTATION}/{mode}"


@foreign_input()
def read_weights(path: Path, *, kind: str | None = None) -> Weights:
    """Read a weights file.

    Args:
        path: ``<name>.safetensors``; its card is not needed.
        kind: What it must be of, if that matters.

    Raises:
        InputFileError: if there is no such file, it is a pickle or another format, it is damaged, or it holds weights
            of another kind.
    """
    try:
        content = read_whole(path)
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="a weights file (.safetensors)", found="no such file") from error
    pickled = content.startswith((b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"))
    remedy = (
        "Pickles can run code when they are opened, so prbench never does. Load it where you trust it and save its"
        " tensors with safetensors."
    )
    require(path, (not pickled, "", "a safetensors file", "a pickle (a PyTorch checkpoint)", remedy))
    # The header of a safetensors file: 8 bytes of length, then JSON.
    if len(content) < 8:
        raise _damaged(path, f"{len(content)} bytes")
    (length,) = struct.unpack("<Q", content[:8])
    if length > min(LARGEST_HEADER, len(content) - 8):
        raise _damaged(path, "no header, or a truncated one")
    try:
        metadata = json.loads(content[8 : 8 + length]).get("__metadata__", {})
    except (ValueError, AttributeError, RecursionError) as error:
        raise _damaged(path, "a header that is not JSON") from error
    metadata = metadata if isinstance(metadata, dict) else {}
    _require_entry(path, metadata, "format", _FORMAT)
    _require_entry(path, metadata, "format_version", FORMAT_VERSION)
    if kind is not None:
        _require_entry(path, metadata, "kind", kind)
    try:
        tensors = safetensors.torch.load(content)
    except SafetensorError as error:
        raise _damaged(path, str(error)) from error
    tensors = {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in tensors.items()}
    return Weights(path, tensors, metadata, bytes_digest(content))


def _require_entry(path: Path, metadata: Mapping[str, str], key: str, expected: str) -> None:
    if metadata.get(key) != expected:
        remedies = {
            "format": "These are not weights of prbench.",
            "format_version": "They were written by another version of prbench; update it.",
            "kind": "Choose weights that were trained for this method.",
            "representation": "Choose weights that were trained with this representation.",
        }
        found = f"'{metadata[key]}'" if key in metadata else "nothing"
        raise InputFileError(path, f"header entry '{key}'", expected=f"'{expected}'", found=found, remedy=remedies[key])


def _damaged(path: Path, found: str) -> InputFileError:
    remedy = "It may be truncated; copy or train it again."
    return InputFileError(path, "", expected="a safetensors file", found=found, remedy=remedy)
