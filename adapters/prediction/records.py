"""Headers of the predictors' weights files: the windows that they learnt from, and the sizes of the networks."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import msgspec
from torch import nn

from prbench_adapters.prediction import belfusion
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion
from prbench_adapters.prediction.configuration import DiffusionConfiguration
from prbench_adapters.prediction.gazemotion import GazeMotion, GazeMotionConfiguration
from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration
from prbench_adapters.training.batches import SeenWindows
from prbench_adapters.training.weights import Weights

Sizes = TypeVar("Sizes", bound=msgspec.Struct)
PredictorNetwork = CoefficientDiffusion | GazeMotion | CVAE | DLow | belfusion.BeLFusion


class Autoencoders(nn.Module):
    """Both autoencoders of BeLFusion side by side; neither sees the other."""

    def __init__(self, configuration: belfusion.BehaviourConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.past = belfusion.PastAutoencoder(configuration)
        self.behaviour = belfusion.BehaviourAutoencoder(configuration)


class NetworkRecord(msgspec.Struct, Generic[Sizes], frozen=True, forbid_unknown_fields=True, kw_only=True):
    """GazeMoDiff, HumanMAC, GazeMotion, CVAE, or the two autoencoders of BeLFusion, its first stage."""

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
    network: belfusion.UNetConfiguration
    behaviour: belfusion.BehaviourConfiguration
    decoded_weight: float = 5.0

    def build(self) -> belfusion.BeLFusion:
        """Make the networks."""
        return belfusion.BeLFusion(self.behaviour, self.network, decoded_weight=self.decoded_weight)


Record = NetworkRecord | DLowRecord | BeLFusionRecord
DiffusionRecord = NetworkRecord[DiffusionConfiguration]
CVAERecord = NetworkRecord[CVAEConfiguration]
GazeMotionRecord = NetworkRecord[GazeMotionConfiguration]
AutoencodersRecord = NetworkRecord[belfusion.BehaviourConfiguration]
_NETWORKS: dict[type, type[nn.Module]] = {
    DiffusionConfiguration: CoefficientDiffusion,
    GazeMotionConfiguration: GazeMotion,
    CVAEConfiguration: CVAE,
    belfusion.BehaviourConfiguration: Autoencoders,
}
AUTOENCODERS = "belfusion-autoencoders"
# Maps each method, which is the kind of its weights, to what their header holds.
RECORDS: dict[str, Any] = dict.fromkeys(("gazemodiff", "humanmac"), DiffusionRecord)
RECORDS |= {"gazemotion": GazeMotionRecord, "cvae": CVAERecord, "dlow": DLowRecord, "belfusion": BeLFusionRecord}


def network_of(weights: Weights, record: Record) -> PredictorNetwork:
    """Return the network that a file holds, in evaluation mode.

    Raises:
        InputFileError: if the tensors do not fit the record in the header.
    """
    network = record.build()
    weights.load_into(network, "network")
    return network.eval().requires_grad_(False)
