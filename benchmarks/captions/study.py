"""Table 6 of *Nymeria* in shape: files of captions beside the printed numbers (docs/specification/captions.md)."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import MissingExtraError, UnloadableExtraError
from prbench.files.storage import text_digest
from prbench.protocol.published import printed_rows
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_benchmarks.captions import metrics
from prbench_benchmarks.captions.files import CaptionRow, has_letters, read_captions

_COLUMNS = {"bertscore": "BERTScore", "bleu_1": "BLEU@1", "bleu_4": "BLEU@4", "cider_d": "CIDEr", "rouge_l": "ROUGE-L"}
_NOTES = (
    "All × 100; more is better. CIDEr depends on the set of references: compare files of the same motions alone.",
    "Nymeria's split and clips are unknown: approach, do not compare. What it leaves open:"
    " docs/specification/captions.md.",
)


def captions_table(paths: Sequence[Path], *, with_published: bool) -> Table:
    """Lay out files of captions, one row a file, called by its name.

    Args:
        paths: Files of captions with references.
        with_published: Show the printed rows in a block of their own.

    Raises:
        InputFileError: if a file holds no such captions.
        MissingExtraError: if the extra ``captions`` is not installed.
    """
    measured = []
    notes = list(_NOTES)
    for path in paths:
        rows = read_captions(path)
        values, odd, remarks = score_captions(rows)
        about: dict[str, Any] = {"method": path.stem, "sequences": len(rows)}
        cells = tuple(Cell(metric=name, value=value, **about) for name, value in values.items())
        measured.append(Row(text={"method": path.stem, "clips": str(len(rows))}, cells=cells))
        notes += [f"{path.name}: {odd}"] if odd else []
        notes += remarks
    printed: dict[str, list[Cell]] = {}
    for number in printed_rows("prbench_benchmarks.captions.published", "table_6") if with_published else ():
        about: dict[str, Any] = {name: number[name] for name in ("method", "metric", "note")}
        cell = Cell(value=float(number["value"]), dataset="Nymeria", origin="published: Nymeria, Table 6", **about)
        printed.setdefault(number["method"], []).append(cell)
    lines = [Row(text={"method": name}, cells=tuple(cells)) for name, cells in printed.items()]
    named = {"measured": measured, "printed in Table 6 of Nymeria": lines}
    words = [Column(key=key, title=key.capitalize(), text=True) for key in ("method", "clips")]
    numbers = [Column(key=key, title=title, better="higher") for key, title in _COLUMNS.items()]
    return Table(
        title="Captions of motions (Nymeria, Table 6)",
        columns=(*words, *numbers),
        blocks=tuple(Block(title=title, rows=tuple(rows)) for title, rows in named.items()),
        notes=tuple(dict.fromkeys(notes)),
    )


def score_captions(rows: Sequence[CaptionRow]) -> tuple[dict[str, float | None], str, list[str]]:
    """Score captions, with the wearer's names normalised.

    Returns:
        The metrics × 100, None for one that cannot be computed here; counts of odd captions, if there are some; and
        remarks: all settings with their digest, and why a metric is missing.

    Raises:
        MissingExtraError: if the extra ``captions`` is not installed.
    """
    candidates = [metrics.normalised(row.candidate) for row in rows]
    references = [[metrics.normalised(text) for text in row.references] for row in rows]
    texts = [text for each in references for text in each]
    pair = (candidates, references)
    unigrams, _ = metrics.bleu(*pair, 1)
    score, signature = metrics.bleu(*pair)
    values: dict[str, float | None] = {
        "bertscore": None,
        "bleu_1": unigrams.score,
        "bleu_4": score.score,
        "cider_d": 100.0 * float(metrics.cider_d(*pair).mean()),
        "rouge_l": 100.0 * float(metrics.rouge(*pair)[:, 2].mean()),
        "rouge_l_captioning": 100.0 * float(np.mean([metrics.captioning_rouge_l(*each) for each in zip(*pair)])),
    }
    counted = {
        "candidates without letters": sum(not has_letters(text) for text in candidates),
        f"longer than {metrics.LONGEST} words": sum(len(text.split()) > metrics.LONGEST for text in candidates + texts),
        "candidates cut at the captioner's limit": sum(row.cut for row in rows),
    }
    found = [f"{what}: {count}" for what, count in counted.items() if count]
    odd = f"of {len(rows)} motions with {len(texts)} references, {', '.join(found)}." if found else ""
    remarks = []
    bert = "none"
    try:
        each, bert = metrics.bert_score(*pair)
        values["bertscore"] = 100.0 * float(each.mean())
    except (MissingExtraError, UnloadableExtraError) as error:
        remarks.append(str(error))
    said = (
        f"BLEU {signature}; ROUGE-L β 1, rouge-score {version('rouge-score')}, no stemmer (CSV: rouge_l_captioning, β"
        f" 1.2, whitespace tokens); CIDEr-D σ 6, whitespace tokens; BERTScore {bert}; the wearer's names"
        f" ({', '.join(metrics.WEARER)}) count as {metrics.WEARER[-1]}"
    )
    return values, odd, [*remarks, f"{said}. Digest {text_digest(said)[:12]}."]
