"""``prbench caption``: describe motions in words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress


class CaptionReport(msgspec.Struct, frozen=True, kw_only=True):
    """Captions that were written.

    Attributes:
        captions: The file, one motion a line.
        motions: Number of motions.
        left_out: Number of motions without a text to compare with.
        longest: Most tokens of a motion, and most pieces of a caption.
        cut_motions: Number of motions that are longer.
        cut_captions: Number of captions that reach the limit before their end.
    """

    captions: Path
    motions: int
    left_out: int
    longest: int
    cut_motions: int
    cut_captions: int


@command(
    "caption",
    section="run",
    example="prbench caption --weights trained/tm2t --tokens tokens/nymeria.parquet --split test --out tm2t.jsonl",
    report=CaptionReport,
)
@click.option("--weights", type=opt.PATH, required=True, metavar="FILE", help="Weights of `prbench train --method tm2t`.")
@opt.path_option("--tokens", "Motion tokens with texts: a Parquet file (docs/captions.md).", required=True)
@opt.out_file_option("Captions with their references.", required=True, metavar="FILE.jsonl")
@opt.split_option(None, help="Only motions of this split (default: all).")
@opt.number_option("--beam", "Texts that beam search keeps (default 1: the likeliest word after the other).", default=1)
@opt.number_option("--batch-size", "Motions that are described at once, without beam search (default 64).", default=64)
@opt.device_option
@opt.threads_option
def caption(*, out: Path, **given) -> Answer:
    """Describe motions, given as tokens, in words, for `prbench study captions`."""
    with progress("describing") as tell:
        report = _write(out, tell, **given)

    def show() -> None:
        cut = f"{report.cut_captions} captions and {report.cut_motions} motions longer than {report.longest} tokens"
        print(f"{report.motions} motions; {cut}, {report.left_out} motions without a text left out")
        print(f"written: {out}")

    return Answer(report, show)


def _write(
    out: Path,
    tell: Callable[[int, int, str], None],
    *,
    weights: Path,
    tokens: Path,
    split: str | None,
    beam: int,
    batch_size: int,
    device: str,
    threads: int,
) -> CaptionReport:
    import torch

    from prbench.errors import TableError
    from prbench_adapters.captions.network import beam_search, greedy
    from prbench_adapters.captions.training import load_captioner, sources
    from prbench_adapters.diffusion.method import resolve
    from prbench_adapters.diffusion.model import torch_device
    from prbench_benchmarks.captions.files import CaptionRow, TokensFile, write_captions

    torch.set_num_threads(threads)
    where = torch_device(device)
    network, vocabulary = load_captioner(resolve(weights, "tm2t-small"), where)
    shape = network.configuration
    read = TokensFile.read(tokens)
    if read.codes != shape.codes:
        raise TableError(f"{tokens}: expected {shape.codes} codes, as in the training, found {read.codes}.")
    places = read.places(*([split] if split else []))
    if not places:
        raise TableError(f"{tokens}: expected motions of split '{split}', found none.")
    places.sort(key=lambda place: len(read.tokens[place]))  # motions of similar length need little padding
    decoding = {"start": shape.pieces, "end": shape.pieces + 1, "longest": shape.longest + 1}
    rows = {}
    together = 1 if beam > 1 else batch_size
    for first in range(0, len(places), together):
        batch = places[first : first + together]
        source = sources([read.tokens[place] for place in batch], shape.codes, shape.longest).to(where)
        if beam > 1:
            found = [beam_search(network, source, width=beam, **decoding)[1:].tolist()]
        else:
            found = greedy(network, source, **decoding)[0][:, 1:].tolist()
        for place, ids in zip(batch, found, strict=True):
            cut = decoding["end"] not in ids
            pieces = ids if cut else ids[: ids.index(decoding["end"])]
            text = vocabulary.decode([each for each in pieces if each < shape.pieces])
            about = {"motion_id": read.motion_ids[place], "references": read.texts[place]}
            rows[place] = CaptionRow(candidate=text, cut=cut, **about)
        tell(len(rows), len(places), "motions")
    write_captions(out, [rows[place] for place in sorted(rows)])
    return CaptionReport(
        captions=out,
        motions=len(rows),
        left_out=read.left_out,
        longest=shape.longest,
        cut_motions=sum(len(read.tokens[place]) > shape.longest for place in places),
        cut_captions=sum(row.cut for row in rows.values()),
    )
