"""Parts that several kinds of pictures share: the figure itself, bodies, boxes.

The limbs of bodies are as thick as a person's, the nearer ones over the farther ones, left limbs lighter.

matplotlib is imported when something is drawn, so that commands which draw nothing start quickly.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.files.storage import sole_file
from prbench.geometry.skeleton import BONES, Joint, head_forward
from prbench.shown import figure_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

Vector = Float[np.ndarray, "3"]
Flat = Float[np.ndarray, "n 2"]
Flatten = Callable[[np.ndarray], np.ndarray]  # maps points (..., 3) to a picture's coordinates

# Corners of a box that an edge joins, where a corner's number has a bit for each axis.
BOX_EDGES = tuple((corner, corner | bit) for corner in range(8) for bit in (1, 2, 4) if not corner & bit)


# Metres; each bone has the thickness of the joint at its end.
_TRUNK = {"HIP": 0.17, "SPINE1": 0.26, "SPINE2": 0.25, "SPINE3": 0.27, "NECK": 0.12, "HEAD": 0.11, "COLLAR": 0.19}
_LIMBS = {"KNEE": 0.15, "ANKLE": 0.10, "FOOT": 0.08, "SHOULDER": 0.13, "ELBOW": 0.09, "WRIST": 0.075}
_HAND = 0.09  # metres from the wrist to the middle of the hand
_SKULL = (0.02, 0.09, 0.17)  # metres before and above the head joint, and across
_NOSE = (0.115, 0.075, 0.035)
_OUTLINE = 0.7  # points of white around each part of a limb
_LIGHTER = 0.45  # share of white in left limbs

STYLE = Path(__file__).with_name("prbench.mplstyle")
# Kinds of files that a figure is written as.
FORMATS = (".png", ".svg", ".pdf")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def styled(draw: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function draw in the style of all figures, whatever settings of matplotlib the user has."""

    @functools.wraps(draw)
    def drawing(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        import matplotlib.style

        with matplotlib.style.context(["default", STYLE]):
            return draw(*args, **kwargs)

    return drawing


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return an empty figure outside pyplot, which would keep it in memory and might open a window.

    Args:
        width: Inches.
        height: Inches.
        options: Further arguments of :class:`matplotlib.figure.Figure`.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), **options)


def require_drawable(path: Path) -> None:
    """Refuse kinds of files that a figure is not written as, before anything is computed.

    Raises:
        UsageError: for any but PNG, SVG and PDF.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: the figure is written as .png, .svg or .pdf, not as '{path.suffix}'.")


def write_figure(figure: Figure, path: Path | str, caption: str = "") -> None:
    """Write a figure as PNG, SVG or PDF, by the suffix of the file; a file that exists is replaced.

    Args:
        figure: What to write.
        path: The file.
        caption: Text below the figure in a paper; it stands in the file's metadata.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    path = Path(path)
    require_drawable(path)
    kind = path.suffix.lower().removeprefix(".")
    # No date and no version of matplotlib in the file: equal pictures are equal bytes.
    absent = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}[kind]
    metadata = dict.fromkeys(absent) | ({"Subject" if kind == "pdf" else "Description": caption} if caption else {})
    with sole_file(path) as draft:
        figure.savefig(draft, format=kind, metadata=metadata)


def grid_shape(n: int, columns: int) -> tuple[int, int]:
    """Return rows and columns of a sheet of ``n`` cells, at most ``columns`` of them side by side."""
    columns = min(columns, n)
    return -(-n // columns), columns


def legend_below(figure: Figure, axes: Axes, note: str, *, columns: int) -> None:
    """Put the legend of one panel below all panels, with a note.

    Args:
        figure: The figure.
        axes: Panel whose labels are listed.
        note: Text for readers.
        columns: Most labels side by side.
    """
    handles, labels = axes.get_legend_handles_labels()
    # The note is the legend's title, because a note of its own at the lower edge would be drawn over the legend.
    figure.legend(handles, labels, ncols=min(len(labels), columns), title=figure_text(note), loc="outside lower center")


def horizontal_direction(offset: Vector) -> Vector:
    """Return the unit vector of the horizontal part of an offset; +z where there is hardly any, so that it is unit."""
    flat = offset * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(flat))
    # A body right under its goal has no direction to it; any is as good, as long as pictures agree.
    return flat / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])


def draw_chains(axes: Axes, flat: Flat, chains: Sequence[Sequence[int]], colour: Any, **style: Any) -> None:
    """Draw one pose that is already flat as a line a chain of joints, in one colour.

    Args:
        axes: Panel to draw into.
        flat: Picture coordinates of the joints, metres.
        chains: Joints of each line.
        colour: Colour of all lines.
        style: Further arguments of a matplotlib line.
    """
    for chain in chains:
        axes.plot(*flat[list(chain)].T, **{"color": colour, "linewidth": 1.5, "solid_capstyle": "round", **style})


def side_by_side(clouds: Sequence[Float[np.ndarray, "_n 2"]], *, spacing: float) -> list[float]:
    """Return how far each cloud of points is moved so that it begins ``spacing`` metres behind the one before it."""
    shifts = []
    right = -spacing
    for points in clouds:
        shifts.append(right + spacing - float(points[:, 0].min()))
        right = float(points[:, 0].max()) + shifts[-1]
    return shifts


def shades(colour: str, n: int) -> list[tuple[float, float, float]]:
    """Return ``n`` shades of a colour, from dark to light."""
    from matplotlib.colors import to_rgb

    base = np.array(to_rgb(colour))
    return [tuple(base + (1 - base) * share) for share in np.linspace(0.0, 0.62, n)]


def square_limits(points: Flat, *, margin: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of a square panel around points, so that panels with the same ones compare; metres."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    half = float((high - low).max()) / 2 + margin
    x, z = (low + high) / 2
    return (float(x) - half, float(x) + half), (float(z) - half, float(z) + half)


def without_frame(axes: Axes) -> None:
    """Take ticks and frame from a panel."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def frame_side_view(
    axes: Axes, clouds: Sequence[Float[np.ndarray, "_n 2"]], shifts: Sequence[float], margin: float, floor: float
) -> None:
    """Show all points of a view from the side, each cloud at its place, on the line of the floor.

    Args:
        axes: The panel.
        clouds: Picture coordinates before they are shifted, metres.
        shifts: How far each cloud is moved to the right.
        margin: Room beside the outermost points, metres.
        floor: Height of the floor; the names of the moments stand below it.
    """
    everything = np.concatenate([points + np.array([shift, 0.0]) for points, shift in zip(clouds, shifts, strict=True)])
    axes.set_xlim(everything[:, 0].min() - margin, everything[:, 0].max() + margin)
    axes.set_ylim(min(floor, float(everything[:, 1].min())) - 0.32, everything[:, 1].max() + 0.15)
    axes.axhline(floor, color="0.8", linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    without_frame(axes)


def flattened(points: Float[np.ndarray, "n 3"], pelvis: Vector, sideways: Vector, at: float) -> Flat:
    """Return picture coordinates of points around a pelvis that stands at ``at``, metres."""
    return np.stack([(points - pelvis) @ sideways + at, points[:, 1]], axis=-1)


def body_lines(
    axes: Axes,
    joints: Float[np.ndarray, "poses 22 3"],
    colour: str,
    flat: Flatten,
    towards: Vector,
    *,
    head_tilt_deg: float,
) -> dict[str, Any]:
    """Return what :func:`draw_bodies` draws as properties of a ``LineCollection``, by which a film moves it.

    Args:
        axes: Panel with its final place and limits, by which thickness is told in points.
        joints: Canonical frame, metres; a pose is drawn over those before it.
        colour: ``#rrggbb``.
        flat: Maps points (poses, n, 3) to the panel's coordinates (poses, n, 2), metres.
        towards: Unit vector that points to whoever looks at the picture.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
    """
    from matplotlib.colors import to_rgb

    # Both ends of every part (parts, poses, 2, 3), its thickness, and whether it is one of the left: bones, hands from
    # the wrists on, the skull, and a nose that shows where the head points.
    names = [Joint(child).name.removeprefix("LEFT_").removeprefix("RIGHT_") for _, child in BONES]
    ends = list(np.moveaxis(joints[:, np.array(BONES)], 1, 0))
    widths = [_TRUNK.get(name) or _LIMBS[name] for name in names]
    is_left = [name in _LIMBS and Joint(child).name.startswith("LEFT") for name, (_, child) in zip(names, BONES)]
    for side in ("LEFT", "RIGHT"):
        wrist = joints[:, Joint[f"{side}_WRIST"]]
        forearm = wrist - joints[:, Joint[f"{side}_ELBOW"]]
        forearm = forearm / np.maximum(np.linalg.norm(forearm, axis=-1, keepdims=True), 1e-9)
        ends.append(np.stack([wrist, wrist + _HAND * forearm], axis=1))
        widths.append(_LIMBS["WRIST"])
        is_left.append(side == "LEFT")
    forward, _ = head_forward(joints, head_tilt_deg)
    head = joints[:, Joint.HEAD]
    up = head - joints[:, Joint.NECK]
    up = up - (up * forward).sum(axis=-1, keepdims=True) * forward
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    middle = head + _SKULL[0] * forward
    ends.append(np.stack([middle + 0.03 * up, middle + _SKULL[1] * up], axis=1))
    nose = head + _NOSE[1] * up
    ends.append(np.stack([nose + 0.06 * forward, nose + _NOSE[0] * forward], axis=1))
    parts = np.stack(ends, axis=1)
    thickness = np.array([*widths, _SKULL[2], _NOSE[2]])
    left = np.array([*is_left, False, False])
    axes.apply_aspect()
    (_, low), (_, high) = axes.transData.transform([(0.0, 0.0), (0.0, 1.0)])
    points = thickness * (high - low) * 72 / axes.figure.dpi
    full = np.array(to_rgb(colour))
    colours = np.where(left[:, None], full + _LIGHTER * (1 - full), full)
    shown = flat(parts.reshape(len(parts), -1, 3)).reshape(*parts.shape[:3], 2)
    # Farther parts come first; limbs have a white outline, by which they are told from what is behind them.
    outline = np.array([0.0 if width in _TRUNK.values() else 2 * _OUTLINE for width in thickness])
    order = np.argsort((parts.mean(axis=2) @ towards), axis=1, kind="stable")
    segments = np.take_along_axis(shown, order[:, :, None, None], axis=1).reshape(-1, 2, 2)
    order = order.ravel()
    outlined = np.stack([points[order] + outline[order], points[order]], axis=1).ravel()
    edges = np.where(outline[order, None] > 0, 1.0, colours[order])
    shades = np.stack([edges, colours[order]], axis=1).reshape(-1, 3)
    return {"segments": list(segments.repeat(2, axis=0)), "linewidths": outlined, "color": shades}


def draw_bodies(axes: Axes, *body: Any, zorder: float = 3.0, **options: Any) -> LineCollection:
    """Draw bodies into a panel; the arguments are those of :func:`body_lines`."""
    from matplotlib.collections import LineCollection

    lines = LineCollection(**body_lines(axes, *body, **options), capstyle="round", zorder=zorder)
    axes.add_collection(lines, autolim=False)
    return lines
