"""GazeMotion: a convolution forecasts gaze, and a graph network makes one future of the past pose and that forecast.

Source: docs/specification/gazemotion.md. Joints are in metres.
"""

from __future__ import annotations

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.prediction.coefficient_diffusion import Graph, GraphEncoder, WindowDCT, gaze_encoder, padded
from prbench_adapters.prediction.recurrent import Future, Futures, Losses, Seeds
from prbench_adapters.training.configuration import require_within

# Joints in metres, and behind them a unit direction, if there is one.
Observed = Float[Tensor, "windows observed nodes 3"]


class GazeMotionConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes; the defaults are those of the public program, but for the frames.

    Attributes:
        gaze: A direction stands behind the joints: gaze, or the head's in its place. Without, nodes are joints alone.
        forecast: Show the graph network the forecast of the direction; false shows the observed one, as the program
            does on GIMO and ADT.
        gaze_nodes: Copies of the direction among the nodes; 0 for as many as joints.
        coefficients: DCT coefficients that the graph network sees and changes; 0 for all of a window.
        width: Channels between the first and the last layer of the graph network.
        blocks: Its residual blocks.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    n_joints: int
    gaze: bool = True
    forecast: bool = True
    observed: int = 15
    predicted: int = 60
    gaze_nodes: int = 0
    coefficients: int = 0
    width: int = 16
    blocks: int = 16
    dropout: float = 0.3

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "n_joints", "observed", "width", "blocks")
        require_within(self, "at least 0", "gaze_nodes", "coefficients")
        require_within(self, "at least 0 and below 1", "dropout")
        # A forecast is as long as the observation, and one frame has no velocity.
        least = max(2, self.observed if self.gaze and self.forecast else 0)
        if self.predicted < least:
            raise ValueError(f"'predicted' must be at least {least} with these settings, found {self.predicted}")
        if self.coefficients > self.frames:
            raise ValueError(f"'coefficients' must be at most the {self.frames} frames, found {self.coefficients}")

    @property
    def frames(self) -> int:
        """Frames of a window, N = observed + predicted."""
        return self.observed + self.predicted

    @property
    def copies(self) -> int:
        """Nodes of the direction."""
        return (self.gaze_nodes or self.n_joints) if self.gaze else 0


class GraphConvolution(nn.Module):
    """Learnt mixtures of steps, channels and nodes, the same for every window, and a bias for each step.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
        nodes: Number of nodes of the graph.
        steps: Length of each node's sequence.
    """

    def __init__(self, inputs: int, outputs: int, nodes: int, steps: int) -> None:
        super().__init__()
        self.over_steps = nn.Parameter(torch.empty(steps, steps))  # column: the step that is made
        self.channels = nn.Parameter(torch.empty(inputs, outputs))
        self.over_nodes = nn.Parameter(torch.empty(nodes, nodes))  # row: the node that is made
        self.bias = nn.Parameter(torch.empty(steps))
        bound = nodes**-0.5
        for parameter in self.parameters():
            nn.init.uniform_(parameter, -bound, bound)

    def forward(self, stream: Graph) -> Tensor:
        """Apply to every graph by itself."""
        mixed = torch.einsum("bcns,cd->bdns", stream @ self.over_steps, self.channels)
        return self.over_nodes @ mixed + self.bias


class GazeMotion(nn.Module):
    """The forecaster of gaze and the graph network, which does not train it.

    Args:
        configuration: Sizes, and whether gaze is forecast.
    """

    def __init__(self, configuration: GazeMotionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        steps = configuration.coefficients or configuration.frames
        nodes = configuration.n_joints + configuration.copies
        self.transform = WindowDCT(steps, configuration.observed, configuration.frames)
        forecasts = configuration.gaze and configuration.forecast
        self.forecaster = gaze_encoder(configuration.observed) if forecasts else None
        sizes = (nodes, steps, configuration.width, configuration.blocks, configuration.dropout)
        self.graph = GraphEncoder(*sizes, GraphConvolution)

    def shown(self, observed: Observed) -> Observed:
        """Return what the graph network sees: row t of the direction is the forecast for row t + observed."""
        if self.forecaster is None:
            return observed
        gaze = observed[:, :, -1]
        ahead = gaze[:, -1:] + self.forecaster(gaze.transpose(1, 2)).transpose(1, 2)
        return torch.cat([observed[:, :, :-1], functional.normalize(ahead, dim=-1)[:, :, None]], dim=2)

    def forward(self, shown: Observed) -> Future:
        """Return the joints after what :meth:`shown` returned."""
        configuration = self.configuration
        joints = configuration.n_joints
        known = self.transform(padded(shown, configuration.frames))
        nodes = known.unflatten(-1, (-1, 3)).permute(0, 3, 2, 1)
        direction = nodes[:, :, joints:].expand(-1, -1, configuration.copies, -1)
        nodes = torch.cat([nodes[:, :, :joints], direction], dim=2)
        # The change alone goes back to frames: with fewer coefficients than frames the last pose stays as it is.
        change = (self.graph(nodes) - nodes)[:, :, :joints].permute(0, 3, 2, 1).flatten(2)
        return shown[:, -1:, :joints] + self.transform.inverse(change)[:, configuration.observed :]

    def loss(self, motion: Float[Tensor, "windows frames nodes 3"]) -> Losses:
        """Mean distances of the joints and of their velocities, and the angle of the forecast gaze.

        Args:
            motion: Whole windows.

        Returns:
            ``loss``, the sum, and its parts: ``joints``, metres; ``velocity``, metres a frame; ``gaze``, radians, where
            gaze is forecast. Graph network and forecaster share no parameter, and none learns from the other's part.
        """
        observed, future = motion.split([self.configuration.observed, self.configuration.predicted], dim=1)
        shown = self.shown(observed)
        predicted = self(shown.detach())
        wanted = future[:, :, : self.configuration.n_joints]
        parts = {
            "joints": (predicted - wanted).norm(dim=-1).mean(),
            "velocity": (predicted.diff(dim=1) - wanted.diff(dim=1)).norm(dim=-1).mean(),
        }
        if self.forecaster is not None:
            ahead = shown[:, :, -1]
            actual = future[:, : self.configuration.observed, -1]
            # The angle of unit vectors, with a gradient where an arc cosine has none.
            angle = 2.0 * torch.atan2((ahead - actual).norm(dim=-1), (ahead + actual).norm(dim=-1))
            parts["gaze"] = angle.mean()
        return {"loss": torch.stack(list(parts.values())).sum(), **parts}

    @torch.no_grad()
    def predict(self, observed: Observed, seeds: Seeds) -> Futures:
        """Return the one continuation of each window as often as samples are wanted: there is no noise."""
        return self(self.shown(observed))[:, None].expand(-1, len(seeds[0]), -1, -1, -1)
