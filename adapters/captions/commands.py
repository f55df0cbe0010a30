"""``prbench caption``: describe motions in words."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress
from prbench.errors import TableError


class CaptionReport(msgspec.Struct, frozen=True, kw_only=True):
    """Captions that were written.

    Attributes:
        captions: The file, one motion a line.
        motions: Number of motions.
        left_out: Number of motions without a text to compare with.
        cut_motions: Number of motions that are longer than the captioner reads.
        cut_captions: Number of captions that reach its limit before their end.
    """

    captions: Path
    motions: int
    left_out: int
    cut_motions: int
    cut_captions: int


@command(
    "caption",
    section="run",
    example="prbench caption --weights trained/tm2t --tokens tokens/nymeria.parquet --split test --out tm2t.jsonl",
    report=CaptionReport,
)
@opt.path_option("--weights", "Weights of `prbench train --method tm2t`.", required=True)
@opt.path_option("--tokens", "Motion tokens with texts: a Parquet file (docs/captions.md).", required=True)
@opt.out_file_option("Captions with their references.", required=True, metavar="FILE.jsonl")
@opt.split_option(None, help="Only motions of this split (default: all).")
@opt.number_option("--beam", "Texts that beam search keeps (default 1: the likeliest piece follows).", default=1)
@opt.number_option("--batch-size", "Motions at once, without beam search (default 64).", default=64)
@opt.device_option
@opt.threads_option
def caption(
    *, weights: Path, tokens: Path, out: Path, split: str | None, device: str, threads: int, **given: int
) -> Answer:
    """Describe motions, given as tokens, in words, for `prbench study nymeria-table-6`."""
    import torch

    from prbench_adapters.captions.training import describe, load_captioner
    from prbench_benchmarks.captions.files import TokensFile, write_captions

    torch.set_num_threads(threads)
    network, vocabulary = load_captioner(weights, device)
    shape = network.configuration
    read = TokensFile.read(tokens)
    rows = [row for row in read.rows if split in (None, row.split)]
    if read.codes != shape.codes or not rows:
        found = f"{len(rows)} motions of {read.codes} codes"
        raise TableError(f"{tokens}: expected motions of {shape.codes} codes, split '{split or 'any'}', found {found}.")
    captions = {}
    with progress("describing") as tell:
        for row in describe(network, vocabulary, rows, **given):
            captions[row.motion_id] = row
            tell(len(captions), len(rows), "motions")
    write_captions(out, [captions[row.motion_id] for row in rows])
    report = CaptionReport(
        captions=out,
        motions=len(rows),
        left_out=read.left_out,
        cut_motions=sum(len(row.tokens) > shape.longest for row in rows),
        cut_captions=sum(row.cut for row in captions.values()),
    )
    cut = f"longer than {shape.longest} tokens: {report.cut_motions}, captions cut there: {report.cut_captions}"
    said = f"{report.motions} motions; {cut}; left out, without a text: {report.left_out}\nwritten: {out}"
    return Answer(report, lambda: print(said))
