"""Sequence and corpus tables: schema, rows, writing, reading, digests."""

from prbench.sequences.corpus import CorpusTable
from prbench.sequences.dataset_info import CorpusInfo, DatasetInfo
from prbench.sequences.sequence import Event, Recording, Sequence, SequenceChunk
from prbench.sequences.table import SPLITS, SequenceTable, by_share, find_sequence_id
