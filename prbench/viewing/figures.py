"""Parts that several kinds of pictures share: the figure itself, stick figures seen from the side, boxes.

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
from prbench.shown import figure_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = Float[np.ndarray, "3"]
Flat = Float[np.ndarray, "n 2"]

# Corners of a box that an edge joins, where a corner's number has a bit for each axis.
BOX_EDGES: tuple[tuple[int, int], ...] = (
    (0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7),
)  # fmt: skip


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
    columns = min(len(labels), columns)
    figure.legend(handles, labels, ncols=columns, title=figure_text(note), loc="outside lower center")


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
    axes.set_xticks([])
    axes.set_yticks([])
    for side in ("top", "right", "left", "bottom"):
        axes.spines[side].set_visible(False)


def flattened(points: Float[np.ndarray, "n 3"], pelvis: Vector, sideways: Vector, at: float) -> Flat:
    """Return picture coordinates of points around a pelvis that stands at ``at``, metres."""
    return np.stack([(points - pelvis) @ sideways + at, points[:, 1]], axis=-1)
