"""Corpora as motion tokens with texts, which a captioner learns from (docs/specification/captions.md#files)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

import numpy as np

from prbench.errors import InputFileError, TableError
from prbench.sequences import SPLITS, CorpusTable
from prbench_adapters.training.store import encoded, frame_rate, read_rows
from prbench_benchmarks.captions.files import TokensRow, has_letters
from prbench_benchmarks.motion_tokens.network import FRAMES_OF_TOKEN, Tokeniser
from prbench_benchmarks.motion_tokens.study import reconstruct, require_rate


def joined_texts(clip: Mapping[str, Any]) -> tuple[str, ...]:
    """Return texts that each describe all of a clip.

    A caption is one. Of Nymeria's narrations of motion it is an annotator's answers on body, arms and legs, joined;
    where the wearer looks is no motion.

    Args:
        clip: Its ``kind``, and ``captions`` with ``text`` and ``kind``, an annotator's answers side by side.
    """
    if clip["kind"] != "motion_narration":
        return tuple(caption["text"] for caption in clip["captions"])
    answers: list[dict[str, str]] = [{}]
    for caption in clip["captions"]:
        if caption["kind"] in answers[-1]:  # the next annotator's
            answers.append({})
        answers[-1][caption["kind"]] = caption["text"]
    return tuple(" ".join(text for name, text in each.items() if "focus" not in name.lower()) for each in answers)


def encode_corpora(
    tokeniser: Tokeniser, tables: Sequence[CorpusTable], *, progress: Callable[[int, int, str], None]
) -> list[TokensRow]:
    """Encode whole motions, without the frames beyond a multiple of 4.

    Of several quantisers of K codes, number p has the tokens p·K to (p + 1)·K - 1; tokens of one time are neighbours.

    Args:
        tokeniser: Networks and statistics, in evaluation mode.
        tables: Corpora; their rows follow in this order.
        progress: Called after each motion.

    Returns:
        The motions, but for those that cannot be encoded or are shorter than a token.

    Raises:
        TableError: if a corpus is of another rate than the tokeniser, or of several, a motion is there twice, or no
            motion has a text.
    """
    sizes = tokeniser.configuration
    for table in tables:
        require_rate(tokeniser, table.folder, frame_rate(table, "+".join(SPLITS)))
    columns = ["sequence_id", "split", "kind", "captions"]
    clips = [clip for table in tables for clip in table.scalars(columns=columns).to_pylist()]
    clip_of = {clip["sequence_id"]: clip for clip in clips}
    folders = ", ".join(str(table.folder) for table in tables)
    if len(clip_of) < len(clips):
        raise TableError(f"{folders}: expected every motion once, found some again. Name every corpus once.")
    rows: list[TokensRow] = []
    groups = (group for table in tables for group in read_rows(table, None))
    for done, row in enumerate(chain.from_iterable(groups), start=1):
        progress(done, len(clips), "motions")
        with suppress(InputFileError):  # such a motion is left out
            features = encoded(row.motion, sizes.representation, name=row.sequence_id)
            if len(features) >= FRAMES_OF_TOKEN:
                clip = clip_of[row.sequence_id]
                tokens = reconstruct(tokeniser, features)[1] + np.arange(sizes.parts) * sizes.codes
                rows.append(TokensRow(row.sequence_id, tokens.ravel(), joined_texts(clip), clip["split"]))
    if not any(has_letters(text) for row in rows for text in row.text):
        raise TableError(f"{folders}: expected motions of {FRAMES_OF_TOKEN} frames or more with a text, found none.")
    return rows
