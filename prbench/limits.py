"""Limits of size, depth and distance for everything that is read, checked before anything is unpacked or believed.

Each limit is far above anything that the datasets and methods hold; what exceeds it is a damaged or hostile file.
"""

from __future__ import annotations

# Bytes that one compressed member or dataset of an archive may declare and unpack to.
LARGEST_UNPACKED = 4 * 2**30

# Characters of a dataset's name, which becomes a folder's; file systems take 255 bytes.
LONGEST_NAME = 150

# Bytes of one line of a text file.
LONGEST_LINE = 2**20

# Bytes of a JSON file that is read whole.
LARGEST_JSON = 2**29

# Metres from the origin beyond which a coordinate of a generated motion is refused.
FARTHEST_COORDINATE = 100.0

# Metres from the head joint beyond which the middle between the eyes lies in no head; people's are 0.1 m away.
FARTHEST_EYES = 0.3

# Bytes of a file that is read whole; the longest recordings' largest files hold half of it.
LARGEST_FILE = 2 * 2**30

# Bytes that may be declared whatever stands behind them.
HARMLESS_SIZE = 64 * 2**20

# Bytes beyond :data:`HARMLESS_SIZE` that one stored byte may unpack to; tables of numbers reach about 30.
HIGHEST_COMPRESSION = 100

# Bytes of an archive or Parquet file, of which only parts are read at once.
LARGEST_ARCHIVE = 2**36

# Bytes that the wanted columns of one text table may take in memory.
LARGEST_TABLE = 2**30

# Bytes of all arrays that are read together from one archive or file.
LARGEST_ARRAYS = 2 * 2**30

# Entries along one axis of an array, whatever stands there.
LONGEST_AXIS = 2**40

# Motions in one set of predictions, or rows of conditions.
MOST_MOTIONS = 2**21

# Rows of one Parquet file.
MOST_ROWS = 2**23

# Values of one column in one row group of a Parquet file, which are unpacked together, whatever stands behind them.
MOST_VALUES = 2**27

# Values beyond :data:`MOST_VALUES` that one stored byte may stand for; coordinates reach about 1.
MOST_VALUES_PER_BYTE = 25

# Bytes of the metadata at the end of a Parquet file, or at the beginning of a file of weights.
LARGEST_HEADER = 100 * 2**20

# Characters of a file's path in a message; a name that a file made up can be longer than any path.
LONGEST_PATH = 1000

# Characters of one message, on the terminal and in a table.
LONGEST_MESSAGE = 4000

# Bytes of an archived file that `prbench inspect` unpacks to see its last line.
LARGEST_UNPACKED_FOR_ITS_END = 32 * 2**20

# Bytes of one pickled pose, and of all storages that it unpacks; GIMO's have a few thousand.
LARGEST_PICKLE = 2**20

# Metres from the origin within which everything of a native recording lies; SLAM worlds begin where a walk began.
FARTHEST_POSITION = 10_000.0

# Metres from an object's own origin to the corners of its box and to its surface; rooms are objects too.
LARGEST_OBJECT = 100.0

# Radians to either side of straight ahead; a little more than half a turn.
LARGEST_ANGLE = 3.2

# Number of a video frame: ninety hours at 30 frames a second.
MOST_FRAMES = 10_000_000

# Seconds; clocks of recordings count from a start, or from 1970, which was 1.8e9 s ago.
LATEST_TIME = 1e10

# Seconds from the first to the last sample of one stream; a longer one has a damaged time in it.
LONGEST_RECORDING = 7 * 86_400.0

# Bytes of an archive of runs that somebody hands in; Python writes larger ones in another form.
LARGEST_PACKED = 2**31 - 1

# Members of such an archive; a batch of motions is one.
MOST_MEMBERS = 50_000
