"""``prbench build-tokens``: motions of corpora as tokens beside their texts."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress


class TokensReport(msgspec.Struct, frozen=True, kw_only=True):
    """Motions as tokens.

    Attributes:
        tokens: The file.
        codes: Number of different tokens, over all quantisers.
        motions: Number of motions.
        left_out: Number of motions that cannot be encoded or are shorter than a token.
    """

    tokens: Path
    codes: int
    motions: int
    left_out: int


@command(
    "build-tokens",
    section="data",
    example="prbench build-tokens --weights trained/tokens --data corpora/nymeria --out tokens/nymeria.parquet",
    report=TokensReport,
)
@opt.path_option("--weights", "Weights of `prbench train --method motion-tokens`.", required=True)
@opt.data_option(required=True, help="Folder(s) of `prbench build-corpus`, of the weights' frame rate.")
@opt.out_file_option("The motions' tokens and texts.", required=True, metavar="FILE.parquet")
@opt.device_option
@opt.threads_option
def build_tokens(*, weights: Path, data: opt.Paths, out: Path, device: str, threads: int) -> Answer:
    """Turn the motions of corpora into tokens beside their texts, for `prbench train --method tm2t` and `caption`."""
    import torch

    from prbench.sequences import CorpusTable
    from prbench_adapters.diffusion.method import resolve
    from prbench_benchmarks.captions.files import write_tokens
    from prbench_benchmarks.motion_tokens.encoding import encode_corpora
    from prbench_benchmarks.motion_tokens.training import KIND, load_tokeniser

    torch.set_num_threads(threads)
    tokeniser, digest = load_tokeniser(resolve(weights, KIND), device=device)
    tables = [CorpusTable.open(folder) for folder in data]
    with progress("encoding") as tell:
        rows = encode_corpora(tokeniser, tables, progress=tell)
    codes = tokeniser.configuration.parts * tokeniser.configuration.codes
    about = {"dataset": "+".join(dict.fromkeys(table.info.dataset for table in tables))}
    about["licence"] = "; ".join(dict.fromkeys(table.info.licence for table in tables))
    about["synthetic"] = str(any(table.info.synthetic for table in tables)).lower()
    write_tokens(out, rows, codes=codes, tokeniser=digest, **about)
    left_out = sum(table.n_rows for table in tables) - len(rows)
    report = TokensReport(tokens=out, codes=codes, motions=len(rows), left_out=left_out)
    said = f"{len(rows)} motions; {codes} codes; left out, short or not encodable: {left_out}\nwritten: {out}"
    return Answer(report, lambda: print(said))
