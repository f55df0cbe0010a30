"""How large, how deep and how far what is read may be; looked at before anything is unpacked or believed.

Each limit is far above anything that the datasets and methods hold; what exceeds it is a damaged or hostile file.
"""

from __future__ import annotations

LARGEST_UNPACKED = 4 * 2**30
"""Bytes that one compressed member or dataset of an archive may declare and unpack to."""

LONGEST_MESSAGE = 4_000
"""Characters of one message on the terminal; what is quoted in it is cut to far less where it is quoted."""

LONGEST_NAME = 150
"""Characters of a dataset's name, which becomes a folder's; file systems take 255 bytes."""

LONGEST_LINE = 2**20
"""Bytes of one line of a text file."""

LARGEST_JSON = 2**30
"""Bytes of a JSON file that is read whole."""

FARTHEST_COORDINATE = 100.0
"""Metres from the origin beyond which a coordinate of a generated motion is refused."""

LARGEST_PICKLE = 2**20
"""Bytes of one pickled pose, and of all storages that it unpacks; GIMO's have a few thousand."""

FARTHEST_POSITION = 10_000.0
"""Metres from the origin within which everything of a native recording lies; SLAM worlds begin where a walk began."""

LARGEST_OBJECT = 100.0
"""Metres from an object's own origin to the corners of its box and to its surface; rooms are objects too."""

LARGEST_ANGLE = 3.2
"""Radians to either side of straight ahead; a little more than half a turn."""

MOST_FRAMES = 10_000_000
"""Number of a video frame: ninety hours at 30 frames a second."""

LATEST_TIME = 1e10
"""Seconds; clocks of recordings count from a start, or from 1970, which was 1.8e9 s ago."""

LONGEST_RECORDING = 7 * 86_400.0
"""Seconds from the first to the last sample of one stream; a longer one has a damaged time in it."""
