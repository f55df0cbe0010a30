"""Table 6 of *Nymeria* in shape: files of captions beside the printed numbers (docs/specification/captions.md)."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from prbench.errors import MissingExtraError, UnloadableExtraError
from prbench.files.storage import text_digest
from prbench.protocol.published import printed_rows
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_benchmarks.captions import metrics
from prbench_benchmarks.captions.files import CaptionRow, has_letters, read_captions

_TITLE = "Captions of motions (Nymeria, Table 6)"
_COLUMNS = {"bertscore": "BERTScore", "bleu_1": "BLEU@1", "bleu_4": "BLEU@4", "cider_d": "CIDEr", "rouge_l": "ROUGE-L"}
_NOTES = (
    "All × 100; more is better. CIDEr depends on the set of references: compare files of the same motions alone.",
    "Nymeria's split and clips are unknown: approach its numbers, do not compare. What it leaves open:"
    " docs/specification/captions.md.",
)


def captions_table(paths: Sequence[Path], *, with_published: bool) -> Table:
    """Lay out files of captions, one row a file, called by its name.

    Args:
        paths: Files of captions with references, JSON Lines or Parquet.
        with_published: Show the printed rows in a block of their own.

    Raises:
        InputFileError: if a file holds no such captions.
        MissingExtraError: if the extra ``captions`` is not installed.
    """
    measured = []
    notes = list(_NOTES)
    for path in paths:
        rows = read_captions(path)
        values, remarks = score_captions(rows)
        about = {"method": path.stem, "sequences": len(rows)}
        cells = tuple(Cell(metric=name, value=value, **about) for name, value in values.items())
        measured.append(Row(text={"method": path.stem, "clips": str(len(rows))}, cells=cells))
        notes += [f"{path.name}: {remark}" for remark in remarks]
    blocks = [Block(title="measured", rows=tuple(measured))]
    if with_published:
        printed: dict[str, list[Cell]] = {}
        for number in printed_rows("prbench_benchmarks.captions.published", "table_6"):
            about = {name: number[name] for name in ("method", "metric", "note")}
            cell = Cell(value=float(number["value"]), dataset="Nymeria", origin="published: Nymeria, Table 6", **about)
            printed.setdefault(number["method"], []).append(cell)
        lines = [Row(text={"method": name}, cells=tuple(cells)) for name, cells in printed.items()]
        blocks.append(Block(title="printed in Table 6 of Nymeria", rows=tuple(lines)))
    words = (Column(key=key, title=key.capitalize(), text=True) for key in ("method", "clips"))
    numbers = (Column(key=key, title=title, better="higher") for key, title in _COLUMNS.items())
    return Table(title=_TITLE, columns=(*words, *numbers), blocks=tuple(blocks), notes=tuple(dict.fromkeys(notes)))


def score_captions(rows: Sequence[CaptionRow]) -> tuple[dict[str, float | None], list[str]]:
    """Score captions by the protocol.

    Returns:
        The metrics × 100, None for one that cannot be computed here; and remarks: counts of odd captions, all settings
        with their digest, and why a metric is missing.

    Raises:
        MissingExtraError: if the extra ``captions`` is not installed.
    """
    protocol = metrics.load_caption_protocol()
    candidates = [protocol.normalised(row.candidate) for row in rows]
    references = [[protocol.normalised(text) for text in row.references] for row in rows]
    values: dict[str, float | None] = dict.fromkeys(_COLUMNS)
    signature = ""
    for order in (1, 4):
        settings = {"tokenizer": protocol.tokenizer, "lowercase": protocol.lowercase}
        score, signature = metrics.bleu(candidates, references, order, **settings)
        values[f"bleu_{order}"] = score.score
    values["cider_d"] = 100.0 * float(metrics.cider_d(candidates, references, sigma=protocol.sigma).mean())
    values["rouge_l"] = 100.0 * float(metrics.rouge(candidates, references, stemmer=protocol.stemmer)[:, 2].mean())
    each = [metrics.captioning_rouge_l(*pair, beta=protocol.beta) for pair in zip(candidates, references)]
    values["rouge_l_captioning"] = 100.0 * float(np.mean(each))
    remarks = []
    bert = "none"
    try:
        found, bert = metrics.bert_score(candidates, references, language=protocol.language)
        values["bertscore"] = 100.0 * float(found.mean())
    except (MissingExtraError, UnloadableExtraError) as error:
        remarks.append(str(error))
    said = (
        f"BLEU {signature}",
        f"ROUGE-L β 1, rouge-score {version('rouge-score')}, stemmer {protocol.stemmer}; files also hold β"
        f" {protocol.beta:g} on whitespace tokens (rouge_l_captioning)",
        f"CIDEr-D σ {protocol.sigma:g}, whitespace tokens",
        f"BERTScore {bert}",
        f"names of the wearer ({', '.join(protocol.wearer)}) count as {protocol.wearer[-1]}",
    )
    remarks.append(f"{'; '.join(said)}. Digest {text_digest(protocol.digest, *said)[:12]}.")
    texts = [text for each in references for text in each]
    counted = {
        "empty candidates": sum(not text.strip() for text in candidates),
        "candidates without letters": sum(bool(text.strip()) and not has_letters(text) for text in candidates),
        f"candidates longer than {protocol.longest} words": sum(len(text.split()) > protocol.longest for text in candidates),
        f"references longer than {protocol.longest} words": sum(len(text.split()) > protocol.longest for text in texts),
        "candidates cut at the captioner's limit": sum(row.cut for row in rows),
    }
    odd = [f"{what}: {count}" for what, count in counted.items() if count]
    return values, [*([f"of {len(rows)} motions with {len(texts)} references: {', '.join(odd)}."] if odd else []), *remarks]
