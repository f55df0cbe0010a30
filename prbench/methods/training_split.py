"""The part of a table that a method may learn from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import pyarrow as pa
import pyarrow.compute as pc

from prbench.errors import AdapterError
from prbench.sequences import SequenceTable
from prbench.sequences.chunk import SequenceChunk

FIT_SEED = 0
"""Of methods that a run fits by itself; the run's own seed varies what is generated, not what is learnt."""
_SPLIT = "train"


class TrainingSplit(SequenceTable):
    """A table that shows its ``train`` rows only, so that a method that forgets to ask for them learns no test row."""

    def chunks(
        self,
        *,
        split: str | None = None,
        columns: Sequence[str] | None = None,
        ids: frozenset[str] | None = None,
        rows: int = 256,
    ) -> Iterator[SequenceChunk]:
        """Stream the training rows.

        Raises:
            AdapterError: if another split is asked for.
        """
        return super().chunks(split=_of_training(split), columns=columns, ids=ids, rows=rows)

    def scalars(self, *, split: str | None = None) -> pa.Table:
        """Short values of the training rows.

        Raises:
            AdapterError: if another split is asked for.
        """
        return super().scalars(split=_of_training(split))

    def events(self) -> pa.Table:
        """The events of the training recordings; those of the others would tell where the goals of test rows are."""
        events, known = super().events(), self.recordings()["recording_id"].combine_chunks()
        return events.filter(pc.call_function("is_in", [events["recording_id"]], pc.SetLookupOptions(known)))

    def recordings(self) -> pa.Table:
        """The training recordings."""
        return super().recordings().filter(pc.field("split") == _SPLIT)

    @cached_property
    def identity(self) -> str:
        """That of the whole table."""
        return self._whole.identity

    @cached_property
    def content(self) -> str:
        """That of the whole table."""
        return self._whole.content

    @property
    def _whole(self) -> SequenceTable:
        return SequenceTable(self.folder, self.info)


def _of_training(split: str | None) -> str:
    if split not in (None, _SPLIT):
        raise AdapterError(f"a method may learn from split '{_SPLIT}' only; it asked for '{split}'.")
    return _SPLIT
