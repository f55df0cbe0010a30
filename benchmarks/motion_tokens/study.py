"""Table 5 of *Nymeria* in shape: trained tokenisers on tables beside the printed rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.errors import TableError
from prbench.protocol.published import printed_rows
from prbench.representation import decode
from prbench.tables import Block, Cell, Column, Row, Table, note_of
from prbench_adapters.training import SequenceDataset
from prbench_benchmarks.motion_tokens.metrics import error_sums, pooled
from prbench_benchmarks.motion_tokens.network import FRAMES_OF_TOKEN, Tokeniser, perplexity
from prbench_benchmarks.motion_tokens.training import load_tokeniser

_LONGEST = 1_000_000  # frames: no motion is cut
_TITLE = "Motion reconstruction from tokens (Nymeria, Table 5)"
_WORDS = {"dataset": "Dataset", "fps": "Frames/s", "parts": "Quantisers", "codes": "Codebook", "latent": "Latent"}
_COLUMNS = (
    *(Column(key=key, title=title, text=True) for key, title in _WORDS.items()),
    Column(key="mpjpe", title="MPJPE", better="lower", unit="mm"),
    Column(key="pa_mpjpe", title="PA-MPJPE", better="lower", unit="mm"),
    Column(key="acc", title="ACC", better="lower", unit="mm/frame²"),
    Column(key="acc_seconds", title="ACC", better="lower", unit="m/s²"),
    Column(key="codebook_use", title="Codebook use", better="higher", unit="%"),
    Column(key="dead_codes", title="Dead codes", better="lower", unit="%"),
)
_NOTES = (
    "Means over the frames of all sequences. Frames/s: ACC per frame² falls with the square of the rate, so only its"
    " m/s² compare; those of printed rows are ours. AMASS's row is MotionGPT's, whose program works at 20 frames/s.",
    "Codebook use: perplexity / codes; dead codes: chosen nowhere on this split; means over quantisers.",
    "Printed rows are of other features and unknown splits: approach, do not compare.",
)


def nymeria_table_5(
    inputs: Sequence[Path],
    data: Sequence[Path],
    *,
    with_published: bool,
    device: str = "cpu",
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> Table:
    """Reconstruct the test split of some tables with some tokenisers, one row a pair.

    Args:
        inputs: Weights of ``motion-tokens``.
        data: Folders of built corpora or datasets.
        with_published: Show the printed rows in a block of their own.
        device: Device that the networks run on.
        progress: Called after each row.

    Raises:
        InputFileError: if weights are none of a tokeniser.
        TableError: if a table is of another rate than the weights, or has no motion of this split.
    """
    rows = []
    pairs = [(path, folder) for path in inputs for folder in data]
    for done, (path, folder) in enumerate(pairs, start=1):
        tokeniser, digest = load_tokeniser(path, device=device)
        rows.append(_measured(tokeniser, folder, origin=f"weights {path.name}, sha256 {digest}"))
        progress(done, len(pairs), f"{path} on {folder}")
    blocks = [Block(title="measured", rows=tuple(rows))]
    if with_published:
        printed = printed_rows("prbench_benchmarks.motion_tokens.published", "tables")
        about: dict[str, Any] = {"origin": "published: Nymeria, Table 5"}
        lines = []
        for row in printed:
            errors = (float(row["mpjpe"]), float(row["pa_mpjpe"]), float(row["acc"]))
            lines.append(_row(row, errors, about | {"note": row["note"]}))
        blocks.append(Block(title="printed in Table 5 of Nymeria", rows=tuple(lines)))
    return Table(title=_TITLE, columns=_COLUMNS, blocks=tuple(blocks), notes=_NOTES)


def reconstruct(
    tokeniser: Tokeniser, features: Float[np.ndarray, "frames 263"]
) -> tuple[Float[np.ndarray, "frames 263"], Int[np.ndarray, "tokens parts"]]:
    """Return raw features after a way through tokens, and the tokens.

    Args:
        tokeniser: Networks and statistics, in evaluation mode.
        features: Raw features of one whole motion; frames beyond a multiple of 4 are left out.
    """
    whole = len(features) // FRAMES_OF_TOKEN * FRAMES_OF_TOKEN
    given = torch.from_numpy(features[:whole].copy()).to(tokeniser.mean)
    with torch.inference_mode():
        made, quantised = tokeniser(((given - tokeniser.mean) / tokeniser.std)[None])
        made = made[0] * tokeniser.std + tokeniser.mean
    return made.cpu().numpy(), quantised.tokens.cpu().numpy()


def require_rate(tokeniser: Tokeniser, folder: Path, fps: float) -> None:
    """Raise a TableError if a table is of another frame rate than the tokeniser."""
    if fps != tokeniser.configuration.fps:
        expected = f"{tokeniser.configuration.fps:g} frames per second, as the tokeniser was trained"
        raise TableError(f"{folder}: expected {expected}, found {fps:g}. Build it again with --fps.")


def _measured(tokeniser: Tokeniser, folder: Path, *, origin: str) -> Row:
    """Return the row of one tokeniser on one table."""
    sizes = tokeniser.configuration
    data = SequenceDataset([folder], split="test", max_frames=_LONGEST, mode=sizes.representation)
    require_rate(tokeniser, folder, data.fps)
    sums = []
    counts = np.zeros((sizes.parts, sizes.codes))
    for place in np.flatnonzero(data.lengths >= FRAMES_OF_TOKEN).tolist():
        features = data[place].features
        made, tokens = reconstruct(tokeniser, features)
        # Both ways through the features, so that what they lose is not the tokens' error.
        sums.append(error_sums(decode(made), decode(features[: len(made)])))
        for part, chosen in enumerate(tokens.T):
            counts[part] += np.bincount(chosen, minlength=sizes.codes)
    if not sums:
        raise TableError(f"{folder}: expected motions of {FRAMES_OF_TOKEN} frames or more, found none.")
    shares = torch.from_numpy(counts / counts.sum(axis=1, keepdims=True))
    use = float(np.mean([perplexity(part) for part in shares])) / sizes.codes
    info = data.tables[0].info
    left_out = len(data.left_out) + len(data) - len(sums)
    about: dict[str, Any] = {"origin": "measured on synthetic data" if info.synthetic else "measured"}
    about |= {"note": note_of(origin, f"{left_out} motions left out" if left_out else ""), "sequences": len(sums)}
    words = {"dataset": info.dataset, "fps": f"{data.fps:g}"}
    words |= {name: str(getattr(sizes, name)) for name in ("parts", "codes", "latent")}
    codes = {"codebook_use": 100 * use, "dead_codes": 100 * float((counts == 0).mean())}
    return _row(words, pooled(sums), about, **codes)


def _row(words: Any, errors: tuple[float, float, float], about: dict[str, Any], **codes: float) -> Row:
    """Lay out one row; ACC stands in both units."""
    values = dict(zip(("mpjpe", "pa_mpjpe", "acc"), errors))
    values |= {"acc_seconds": errors[2] * float(words["fps"]) ** 2 / 1000, **codes}
    units = {column.key: column.unit for column in _COLUMNS}
    said = [f"{_WORDS[key].lower()} {words[key] or 'not printed'}" for key in ("parts", "codes", "latent")]
    about = {"dataset": words["dataset"], "method": "VQ-VAE", "variant": "; ".join(said), **about}
    cells = [Cell(metric=name, value=value, unit=units[name], **about) for name, value in values.items()]
    converted = note_of("mm/frame² times the square of the rate", cells[3].note)
    cells[3] = msgspec.structs.replace(cells[3], note=converted)
    return Row(text={key: words[key] for key in _WORDS}, cells=tuple(cells))
