"""Headers of the predictors' weights files: the windows that they learnt from, and the sizes of the networks."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import msgspec
import torch
from torch import nn

from prbench_adapters.prediction.belfusion import (
    BehaviourAutoencoder,
    BehaviourConfiguration,
    BeLFusion,
    PastAutoencoder,
    UNetConfiguration,
)
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion
from prbench_adapters.prediction.configuration import DiffusionConfiguration
from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration
from prbench_adapters.training.batches import WindowsDataset
from prbench_adapters.training.weights import Weights, weights_header
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.joint_sets import JointSet, joint_set
from prbench_benchmarks.motion_prediction.protocol import FrameName

Sizes = TypeVar("Sizes", bound=msgspec.Struct)
PredictorNetwork = CoefficientDiffusion | CVAE | DLow | BeLFusion


class SeenWindows(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The windows that a network was trained on, and the only ones that it can predict."""

    condition: Condition
    frame: FrameName
    joint_set: str
    fps: float
    observed: int
    predicted: int

    @classmethod
    def of(cls, data: WindowsDataset) -> SeenWindows:
        """Return those of a training split."""
        return cls(
            condition=data.choice.condition,
            frame=data.choice.frame,
            joint_set=data.shape.joint_set,
            fps=data.shape.fps,
            observed=data.shape.observed,
            predicted=data.shape.predicted,
        )

    @property
    def joints(self) -> JointSet:
        """The joints by name."""
        return joint_set(self.joint_set)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints.names)

    @property
    def direction(self) -> bool:
        """True if a direction stands behind the joints."""
        return self.condition is not Condition.POSE

    @property
    def nodes(self) -> int:
        """Joints, and the direction if there is one."""
        return self.n_joints + self.direction


class Autoencoders(nn.Module):
    """Both autoencoders of BeLFusion side by side; neither sees the other."""

    def __init__(self, configuration: BehaviourConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.past = PastAutoencoder(configuration)
        self.behaviour = BehaviourAutoencoder(configuration)


class NetworkRecord(msgspec.Struct, Generic[Sizes], frozen=True, forbid_unknown_fields=True, kw_only=True):
    """GazeMoDiff, HumanMAC, CVAE, or the two autoencoders of BeLFusion, its first stage."""

    windows: SeenWindows
    network: Sizes

    def build(self) -> Any:
        """Make the network."""
        return _NETWORKS[type(self.network)](self.network)


class DLowRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """DLow's sampler and the CVAE that it was made for."""

    windows: SeenWindows
    network: DLowConfiguration
    cvae: CVAEConfiguration

    def build(self) -> DLow:
        """Make the network."""
        return DLow(self.network, CVAE(self.cvae))


class BeLFusionRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """BeLFusion whole."""

    windows: SeenWindows
    network: UNetConfiguration
    behaviour: BehaviourConfiguration
    decoded_weight: float = 5.0

    def build(self) -> BeLFusion:
        """Make the networks."""
        return BeLFusion(self.behaviour, self.network, decoded_weight=self.decoded_weight)


Record = NetworkRecord | DLowRecord | BeLFusionRecord
DiffusionRecord = NetworkRecord[DiffusionConfiguration]
CVAERecord = NetworkRecord[CVAEConfiguration]
AutoencodersRecord = NetworkRecord[BehaviourConfiguration]
_NETWORKS: dict[type, type[nn.Module]] = {
    DiffusionConfiguration: CoefficientDiffusion,
    CVAEConfiguration: CVAE,
    BehaviourConfiguration: Autoencoders,
}
AUTOENCODERS = "belfusion-autoencoders"
# Maps each method, which is the kind of its weights, to what their header holds.
RECORDS: dict[str, Any] = {
    "gazemodiff": DiffusionRecord,
    "humanmac": DiffusionRecord,
    "cvae": CVAERecord,
    "dlow": DLowRecord,
    "belfusion": BeLFusionRecord,
}


def contents(kind: str, record: Record, network: nn.Module) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors and header entries of a network, frozen parts with it: a weights file needs no other."""
    header = weights_header(kind, record, f"windows/{record.windows.joint_set}")
    return {f"network.{name}": tensor for name, tensor in network.state_dict().items()}, header


def network_of(weights: Weights, record: Record) -> PredictorNetwork:
    """Return the network that a file holds, in evaluation mode.

    Raises:
        InputFileError: if the tensors do not fit the record in the header.
    """
    network = record.build()
    weights.load_into(network, "network")
    return network.eval().requires_grad_(False)
