"""Files of the HoloLens 2 stream recorder (docs/specification/gimo.md#gaze)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float, Int

from prbench.bounded import read_text, require_size
from prbench.errors import InputFileError
from prbench.readers.files import missing_file, require_increasing
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.coordinates import read_matrix

_WIDTH = 861
_TICK, _HEAD, _GAZE_VALID, _GAZE_ORIGIN, _GAZE_DIRECTION = 0, 1, 851, 852, 856
_VIDEO_WIDTH, _VIDEO_POSE = 18, 2


def read_hololens(stream: Path, video: Path, transform: Path) -> gimo.HoloLens:
    """Head, eyes and camera in the world of the glasses.

    Args:
        stream: ``*_head_hand_eye.csv``.
        video: ``*_pv.txt``.
        transform: ``transform_scene2scene``.

    Raises:
        InputFileError: if a file is missing, or its rows have another width, no numbers, or a clock that stands still.
    """
    ticks, rows = _read_stream(stream)
    require_increasing(stream, ticks, unit="ticks", first=1)
    video_ticks, frames = _read_video(video)
    require_increasing(video, video_ticks, unit="ticks")
    return gimo.HoloLens(
        ticks=ticks,
        head=rows[:, _HEAD : _HEAD + 16].reshape(-1, 4, 4),
        gaze_valid=rows[:, _GAZE_VALID] != 0,
        gaze_origin=rows[:, _GAZE_ORIGIN : _GAZE_ORIGIN + 3],
        gaze_direction=rows[:, _GAZE_DIRECTION : _GAZE_DIRECTION + 3],
        video_ticks=video_ticks,
        camera=frames[:, _VIDEO_POSE : _VIDEO_POSE + 16].reshape(-1, 4, 4),
        transform=read_matrix(transform),
    )


def _read_stream(path: Path) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 861"]]:
    """Ticks, and the columns that are needed, each in its place; the hands stay unread (zeros)."""
    wanted = [*range(_HEAD, _HEAD + 16), *range(_GAZE_VALID, _WIDTH)]
    names = [str(column) for column in range(_WIDTH)]
    types = {names[column]: pa.float64() for column in wanted} | {names[_TICK]: pa.int64()}
    try:
        require_size(path)
        table = pyarrow.csv.read_csv(
            path,
            read_options=pyarrow.csv.ReadOptions(column_names=names),
            convert_options=pyarrow.csv.ConvertOptions(include_columns=list(types), column_types=types),
        )
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except pa.ArrowInvalid as error:
        raise InputFileError(
            path,
            "",
            expected=f"rows of {_WIDTH} numbers without header, the first a whole one",
            found=str(error).splitlines()[0],
            remedy="The file is cut, or of another recorder.",
        ) from error
    rows = np.zeros((len(table), _WIDTH))
    for column in wanted:
        rows[:, column] = table[names[column]].to_numpy()
    return table[names[_TICK]].to_numpy(), rows


def _read_video(path: Path) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, "f 18"]]:
    """Lines after the first (which holds the principal point and the size): ticks, then focal lengths and pose."""
    try:
        lines = [line.split(",") for line in read_text(path).splitlines()[1:] if line.strip()]
        ticks = np.array([int(line[0]) for line in lines], dtype=np.int64)
        rows = np.array([[float(word) for word in line[1:]] for line in lines])
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except ValueError as error:
        raise InputFileError(path, "", expected="rows of equally many numbers", found=str(error)) from error
    if rows.ndim != 2 or rows.shape[1] != _VIDEO_WIDTH:
        width = rows.shape[1] + 1 if rows.ndim == 2 else 0
        raise InputFileError(path, "", expected=f"rows of {_VIDEO_WIDTH + 1} numbers", found=f"{width}")
    return ticks, rows
