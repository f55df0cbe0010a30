"""Sequence and corpus tables: schema, rows, writing, reading, digests."""

from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.corpus_table import CorpusTable
from prbench.sequences.dataset_info import CorpusInfo, DatasetInfo
from prbench.sequences.sequence import Event, Recording, Sequence
from prbench.sequences.table import SequenceTable

__all__ = [
    "CorpusInfo",
    "CorpusTable",
    "DatasetInfo",
    "Event",
    "Recording",
    "Sequence",
    "SequenceChunk",
    "SequenceTable",
]
