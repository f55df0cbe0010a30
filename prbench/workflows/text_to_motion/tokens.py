"""The text vectors of an evaluator, for the captions of some tables."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from prbench.errors import UsageError
from prbench.evaluation.text_to_motion.networks import GLOVE
from prbench.evaluation.text_to_motion.words import GloveCaptions, WordVectors
from prbench.sequences import CorpusTable, SequenceTable
from prbench.text import TextEncoder, text_encoder


def token_vectors(
    name: str, tables: Iterable[SequenceTable | CorpusTable], *, words: str = "", path: str = ""
) -> tuple[TextEncoder, str]:
    """The vectors that an evaluator reads texts with, and the digest of the vocabulary that a user supplied, if any.

    Args:
        name: ``glove``, or the name of a text encoder.
        tables: Whose captions will be read; GloVe needs the tokens that stand beside them.
        words: Folder of the word vectors and lists, for ``glove``.
        path: Folder or hub id of a text encoder that has files.

    Raises:
        UsageError: if a path is missing, or given to vectors that read no files.
        InputFileError: if the files are not what they should be.
    """
    if name != GLOVE:
        if words:
            raise UsageError(f"the text vectors '{name}' need no word vectors. Leave their folder away.")
        return text_encoder(name, path or None), ""
    if not words:
        raise UsageError(
            "a GloVe evaluator needs the folder of its word vectors (words.txt, vectors.npy and the five lists):"
            " --set model.words=DIR for training, --words DIR for evaluation."
        )
    tables = list(tables)
    vectors = WordVectors.read(Path(words))
    source = ", ".join(str(table.folder) for table in tables)
    return GloveCaptions(vectors, _tokens(tables), source=source), vectors.digest


def _tokens(tables: Iterable[SequenceTable | CorpusTable]) -> dict[str, str]:
    """The ``word/POS`` tokens of every caption; P&R tables have none."""
    corpora = (table for table in tables if isinstance(table, CorpusTable))
    rows = (row for table in corpora for row in table.scalars()["captions"].to_pylist())
    return {caption["text"]: caption["tokens"] for row in rows for caption in row}
