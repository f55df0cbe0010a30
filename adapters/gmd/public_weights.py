"""Files of the original program: its checkpoints, and the statistics and projection that they were trained with.

A checkpoint is a file of ``torch.save``, from which numbers are read and nothing else. It is opened with
``weights_only=True``: PyTorch then builds tensors and plain containers, and refuses whatever would run code. Files that
ask for more are refused here too.
"""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

import prbench
from prbench.errors import InputFileError, UsageError
from prbench.files.arrays import load_array
from prbench.files.bounded import foreign_input, require, require_size
from prbench.files.storage import file_digest
from prbench.limits import LARGEST_UNPACKED
from prbench.protocol.manifests import read_toml
from prbench.representation.features import N_FEATURES
from prbench.text import CLIP
from prbench_adapters.gmd.model import KIND, ROOT_XZ, FeatureSpace, GMDConfiguration, GMDNetworks, TemporalUNet
from prbench_adapters.training.weights import representation_entry, weights_header, write_weights

# SHA-256 of ``Mean_abs_3d.npy``, ``Std_abs_3d.npy`` and ``rand_proj.npy`` in the public repository.
RELEASED = {
    "mean": "1bb2633e77a99f1120fc1eb424b7489360bac0a8dfb579e18bd5065431b4b07e",
    "std": "9f5f12cae2003ef19fea119347346d0e46ad85c86dcd1096f1e319ee2a69f940",
    "projection": "91027345a8157fbfe31f6c75b3d341436b649194fe31158ea4419d5cf38d5abb",
}
# Metres. Where people stand deviates by decimetres; how far they step in a frame, by some centimetres.
_LEAST_DEVIATION_OF_PLACES = 0.1
# A draw of the projection has a sum of squares of 263, give or take some per cent; its inverse has many times that.
_MOST_OFF = 1.25
# The copies of the network in a checkpoint, the one to sample with first: a moving average over training.
_COPIES = ("model_avg", "model")
# Earlier versions of PyTorch could be made to run code in spite of ``weights_only`` (CVE-2025-32434).
_SAFE_SINCE = (2, 6)
_NOT_LEARNT = re.compile(r"clip_model\.|(embed_timestep\.)?sequence_pos_encoder\.pe$")
_REFUSED = re.compile(r"GLOBAL ([\w.]+)")


def read_space(mean: Path, std: Path, projection: Path) -> FeatureSpace:
    """Return the feature space of the public checkpoints.

    Args:
        mean: ``Mean_abs_3d.npy``, of features with an absolute root.
        std: ``Std_abs_3d.npy``.
        projection: ``rand_proj.npy``.

    Raises:
        InputFileError: if a file is none of these.
    """
    means = _read(mean, (N_FEATURES,))
    deviations = _read(std, (N_FEATURES,))
    remedy = "Give --statistics Mean_abs_3d.npy Std_abs_3d.npy, in this order."
    least = int(deviations.argmin())
    found = f"{deviations[least]:g}"
    require(std, (deviations[least] > 0, f"column {least}", "a positive deviation", found, remedy))
    # HumanML3D's own statistics, which are those of relative features, have the same shape.
    most = deviations[ROOT_XZ].max()
    expected = "deviations of where the pelvis stands, some decimetres"
    found = f"{most:.3f} m, as of its steps from frame to frame"
    remedy = f"These seem to be statistics of relative features. {remedy}"
    require(std, (most >= _LEAST_DEVIATION_OF_PLACES, "columns 1 and 2", expected, found, remedy))
    matrix = _read(projection, (N_FEATURES, N_FEATURES))
    size = float((matrix.astype(np.float64) ** 2).sum()) / N_FEATURES
    # The repository also holds the inverse, which is as square and as large.
    fits = 1 / _MOST_OFF < size < _MOST_OFF and np.linalg.matrix_rank(matrix.astype(np.float64)) == N_FEATURES
    expected = "an emphasis projection that can be inverted, with a mean square of 1 a row"
    remedy = "Give --projection rand_proj.npy; inv_rand_proj.npy is its inverse, which prbench computes itself."
    require(projection, (fits, "", expected, f"{size:.3g}", remedy))
    return FeatureSpace.of(torch.from_numpy(means), torch.from_numpy(deviations), torch.from_numpy(matrix))


def _read(path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    array = load_array(path)
    require(path, (array.shape == shape, "", f"an array of shape {shape}", f"shape {array.shape}", ""))
    finite = array.dtype.kind == "f" and np.isfinite(array).all()
    require(path, (finite, "", "finite numbers", f"{array.dtype} with NaN or infinity", ""))
    return array.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """One network of the original program.

    Attributes:
        copy: Name of this copy in the file: ``model_avg``, ``model``, or ``only`` where there are no two.
        tensors: Maps the original's names to tensors, on the CPU.
    """

    path: Path
    copy: str
    tensors: dict[str, Tensor]

    def require(self, name: str, shape: tuple[int | None, ...]) -> Tensor:
        """Return the tensor of this name.

        Args:
            name: The original's.
            shape: Its sizes; None for any.

        Raises:
            InputFileError: if there is none, it has another shape, or it holds anything but finite numbers.
        """
        tensor = self.tensors.get(name)
        wanted = f"({', '.join('any' if size is None else str(size) for size in shape)})"
        if tensor is None:
            raise self.misfit(name, f"a tensor of shape {wanted}", "none of this name")
        sizes = tuple(tensor.shape)
        if len(sizes) != len(shape) or any(want not in (None, size) for want, size in zip(shape, sizes, strict=True)):
            raise self.misfit(name, f"shape {wanted}", f"shape {sizes}")
        if not (tensor.is_floating_point() and bool(torch.isfinite(tensor).all())):
            raise self.misfit(name, "finite numbers", f"{tensor.dtype} with NaN, infinity or no fractions")
        return tensor.float()

    def misfit(self, name: str, expected: str, found: str) -> InputFileError:
        """Return an error about one tensor of this file."""
        remedy = "Give the motion network's file as --motion and the trajectory network's as --trajectory,"
        remedy += " both as GMD was released (absolute root, U-Net with adaptive group normalisation)."
        return InputFileError(self.path, f"'{name}'", expected=expected, found=found, remedy=remedy)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read the averaged network of a checkpoint, or the only one that it holds.

    Args:
        path: ``model000500000.pt`` or the like.

    Raises:
        InputFileError: if there is no such file, it is no checkpoint, or it holds more than numbers.
        UsageError: if this version of PyTorch cannot be trusted to open it.
    """
    # Before this version ``weights_only`` does not keep its promise.
    if tuple(int(part) for part in re.findall(r"\d+", torch.__version__)[:2]) < _SAFE_SINCE:
        least = ".".join(map(str, _SAFE_SINCE))
        why = f"(CVE-2025-32434). Run: pip install 'torch>={least}'"
        raise UsageError(f"opening a checkpoint safely needs PyTorch {least} or later, found {torch.__version__} {why}")
    content = _mapping(path, _content(path))
    copy = next((name for name in _COPIES if name in content), "only")
    tensors = {}
    for name, value in (content if copy == "only" else _mapping(path, content[copy])).items():
        if not isinstance(value, Tensor):
            found = f"a {type(value).__name__}"
            raise InputFileError(path, f"'{name}'", expected="a tensor", found=found, remedy=_saving_anew(path))
        # True where an entry of a checkpoint that is a network's own: no table of sinusoids, nothing of CLIP.
        if _NOT_LEARNT.match(name) is None:
            tensors[name] = value
    return Checkpoint(path, copy, tensors)


def _mapping(path: Path, value: object) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise InputFileError(path, "", expected="tensors by name", found=f"a {type(value).__name__}")
    return value


@foreign_input()
def _content(path: Path) -> object:
    if not path.is_file():
        raise InputFileError(path, "", expected="a checkpoint (.pt)", found="no such file")
    require_size(path, largest=LARGEST_UNPACKED)
    if not zipfile.is_zipfile(path):
        raise _no_checkpoint(path, "another format, or a truncated file")
    try:
        # Mapped and not read: a checkpoint holds both copies of the network, of which one is taken.
        return torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except pickle.UnpicklingError as error:
        wanted = _REFUSED.search(str(error))
        found = f"one that asks for '{wanted[1]}'" if wanted else "one that asks for more"
        expected = "a checkpoint of numbers alone"
        raise InputFileError(path, "", expected=expected, found=found, remedy=_saving_anew(path)) from error
    except RuntimeError as error:
        raise _no_checkpoint(path, "an archive without one, or a damaged one") from error


def _no_checkpoint(path: Path, found: str) -> InputFileError:
    remedy = "If it is what was downloaded, unpack it first and name the model….pt inside; else download it again."
    return InputFileError(path, "", expected="a checkpoint of torch.save (.pt)", found=found, remedy=remedy)


def _saving_anew(path: Path) -> str:
    sentence = "prbench runs no code of a file. If you trust it, keep its tensors alone, where the original program"
    sentence += f" runs: python -c \"import torch; c = torch.load('{path.name}', map_location='cpu'); c ="
    sentence += " c.get('model_avg', c); torch.save({k: v for k, v in c.items() if torch.is_tensor(v)}, 'tensors.pt')\""
    return f"{sentence} and import tensors.pt."


_NAMES = read_toml("prbench_adapters.gmd", "public_names.toml", dict[str, list[tuple[str, str]]])
_PADDING_STEP = 8
_SUFFIX = ".safetensors"
_CARD_VERSION = 1
_ORIGIN = (
    "GMD: Guided Motion Diffusion for Controllable Human Motion Synthesis (Karunratanakul et al., ICCV 2023),"
    " https://github.com/korrawe/guided-motion-diffusion"
)
_LICENCE = (
    "that of the imported files: the original's repository is under the MIT licence (copyright Korrawe Karunratanakul"
    " and Guy Tevet); CLIP and HumanML3D, on which the networks were trained, have their own terms"
)


@dataclass(frozen=True)
class PublicFiles:
    """Files that a user has downloaded."""

    motion: Path
    trajectory: Path
    mean: Path
    std: Path
    projection: Path


@dataclass(frozen=True)
class Imported:
    """Report of what was written.

    Attributes:
        copies: Name of the copy that was taken, by network.
        not_released: Statistics and projection that are not those of the public repository.
    """

    configuration: GMDConfiguration
    copies: dict[str, str]
    parameters: int
    not_released: tuple[Path, ...]


def import_public(files: PublicFiles, out: Path) -> Imported:
    """Write weights of ``prbench run --method gmd`` and their card.

    Args:
        files: The files of the original.
        out: ``<name>.safetensors``; the card is written beside it. The same files give the same bytes.

    Raises:
        InputFileError: if a file is not what it should be; then nothing is written.
        StorageError: if the weights cannot be written.
        UsageError: if ``out`` has another suffix, or PyTorch is too old to open the files safely.
    """
    if out.suffix != _SUFFIX:
        raise UsageError(f"--out {out}: expected a name that ends with {_SUFFIX}.")
    space = read_space(files.mean, files.std, files.projection)
    motion = read_checkpoint(files.motion)
    trajectory = read_checkpoint(files.trajectory)
    # The weight c of the absolute root with which the projection was drawn, a whole number.
    squares = space.projection.square().sum(dim=1)
    emphasis = float(max(1.0, torch.round((squares[:3].mean() / squares[3:].mean()).sqrt())))
    configuration = _configuration_of(motion, trajectory, emphasis)
    # The parameters of both networks by our names, ``motion.…`` and ``trajectory.…``.
    with torch.device("meta"):  # names and shapes alone
        unets = GMDNetworks(configuration)
    networks = {}
    for prefix, checkpoint, unet in (("motion", motion, unets.motion), ("trajectory", trajectory, unets.trajectory)):
        networks |= {f"{prefix}.{name}": tensor for name, tensor in parameters_of(checkpoint, unet).items()}
    tensors = {f"networks.{name}": tensor for name, tensor in networks.items()}
    tensors |= {"statistics.mean": space.mean, "statistics.std": space.std, "projection": space.projection}
    metadata = weights_header(KIND, configuration, representation_entry(configuration.representation))
    copies = {"motion": motion.copy, "trajectory": trajectory.copy}
    parameters = sum(tensor.numel() for tensor in networks.values())
    by_role = asdict(files)
    digests = {role: file_digest(path) for role, path in by_role.items()}
    # prbench trained nothing of this, so there are no curves and no scores.
    card = {
        "card_version": _CARD_VERSION,
        "prbench": prbench.__version__,
        "method": "gmd",
        "stage": "imported",
        "origin": _ORIGIN,
        "licence": _LICENCE,
        "trained_on": "HumanML3D, by the authors of GMD",
        "parameters": parameters,
        "configuration": {"model": msgspec.to_builtins(configuration)},
        "files": {
            role: {"name": path.name, "sha256": digests[role]}
            | ({"copy": copies[role]} if role in copies else {"as_released": digests[role] == RELEASED[role]})
            for role, path in by_role.items()
        },
    }
    # After everything was checked: a wrong file leaves no weights behind.
    write_weights(out, tensors, metadata, card)
    others = tuple(by_role[role] for role in RELEASED if digests[role] != RELEASED[role])
    return Imported(configuration, copies, parameters, others)


def _configuration_of(motion: Checkpoint, trajectory: Checkpoint, emphasis: float) -> GMDConfiguration:
    """Describe the released networks: sizes from their arrays, the rest from docs/specification/gmd.md#networks.

    Raises:
        InputFileError: if the files hold no such networks.
    """
    size, text_dimension = motion.require("embed_text.weight", (None, None)).shape
    motion_widths = widths_of(motion)
    trajectory_widths = widths_of(trajectory)
    levels = max(len(motion_widths), len(trajectory_widths))
    try:
        return GMDConfiguration(
            motion_widths=motion_widths,
            trajectory_widths=trajectory_widths,
            condition_width=size,
            emphasis=emphasis,
            text_encoder=CLIP,
            text_dimension=text_dimension,
            representation="reference",  # the original's own heading
            padding_step=max(_PADDING_STEP, 2 ** (levels - 1)),
            uniform_skeleton=True,  # HumanML3D's people share one
        )
    except ValueError as error:
        raise InputFileError(motion.path, "sizes", expected="networks of GMD", found=f"others: {error}") from error


def widths_of(checkpoint: Checkpoint) -> tuple[int, ...]:
    """Channels of each level, the finest first; at least one.

    Raises:
        InputFileError: if the first level is missing, as it is in other networks.
    """
    widths: list[int] = []
    # The first level is required, so that a file of something else fails with its name.
    while not widths or _of_level(len(widths)) in checkpoint.tensors:
        widths.append(len(checkpoint.require(_of_level(len(widths)), (None,))))
    return tuple(widths)


def _of_level(level: int) -> str:
    return f"unet.downs.{level}.1.blocks.0.block1.0.bias"


def parameters_of(checkpoint: Checkpoint, unet: TemporalUNet) -> dict[str, Tensor]:
    """Return the parameters of one network by our names.

    Args:
        checkpoint: A checkpoint of the original.
        unet: A network of the sizes that it should have.

    Raises:
        InputFileError: as :func:`_networks_of`.
    """
    wanted = {original_name(name): (name, tuple(tensor.shape)) for name, tensor in unet.state_dict().items()}
    found = {name: checkpoint.require(original, shape) for original, (name, shape) in wanted.items()}
    # A tensor too many means another architecture, even where all of ours are there.
    unknown = sorted(set(checkpoint.tensors) - set(wanted))
    if unknown:
        raise checkpoint.misfit(unknown[0], "only parameters of the network", "one more")
    return found


def original_name(name: str) -> str:
    """Return the original's name of a parameter of :class:`prbench_adapters.gmd.model.TemporalUNet`."""
    for pattern, replacement in _NAMES["renamed"]:
        name = re.sub(pattern, replacement, name)
    return name
