"""Which SLAM archive holds which video (``vrs_to_multi_slam.json``)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import msgspec

from prbench.readers.files import decode_json, missing_file

_MAP = msgspec.json.Decoder(dict[str, str | int])


def slam_number(path: Path) -> dict[str, str]:
    """Number of the archive by name of the video; keys of the file are ``P01/<video>.vrs``.

    Raises:
        InputFileError: if the file is missing or damaged.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise missing_file(path) from error
    return _numbers(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=32)
def _numbers(path: Path, _size: int, _changed_ns: int) -> dict[str, str]:
    entries = decode_json(path, _MAP)
    return {key.rpartition("/")[2].removesuffix(".vrs"): str(number) for key, number in entries.items()}
