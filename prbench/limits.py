"""How large, how deep and how far what is read may be; looked at before anything is unpacked or believed.

Each limit is far above anything that the datasets and methods hold; what exceeds it is a damaged or hostile file.
"""

from __future__ import annotations

LARGEST_UNPACKED = 4 * 2**30
"""Bytes that one compressed member or dataset of an archive may declare and unpack to."""

LONGEST_LINE = 2**20
"""Bytes of one line of a text file."""

LARGEST_JSON = 2**30
"""Bytes of a JSON file that is read whole."""

FARTHEST_COORDINATE = 100.0
"""Metres from the origin beyond which a coordinate of a generated motion is refused."""

LARGEST_UNPACKED_FOR_ITS_END = 32 * 2**20
"""Bytes of an archived file that `prbench inspect` unpacks to see its last line."""

LARGEST_PICKLE = 2**20
"""Bytes of one pickled pose, and of all storages that it unpacks; GIMO's have a few thousand."""
