"""The sequence table: schema, rows, writing, reading, digests."""

from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.dataset_info import DatasetInfo
from prbench.sequences.sequence import EventRecord, RecordingRecord, Sequence
from prbench.sequences.table import SequenceTable

__all__ = ["DatasetInfo", "EventRecord", "RecordingRecord", "Sequence", "SequenceChunk", "SequenceTable"]
