"""Training of the captioner on motion tokens with texts, and its task of ``prbench train``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor, nn

from prbench.errors import TableError, UsageError
from prbench.files.bounded import require
from prbench.randomness import named_generator
from prbench_adapters.captions.network import Captioner, CaptionerConfiguration, beam_search, caption_losses, greedy
from prbench_adapters.captions.vocabulary import vocabulary_of, words_of
from prbench_adapters.diffusion.method import resolve
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.prediction.training import converted
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.batches import DrawnDataset
from prbench_adapters.training.store import parts_of
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.training.weights import read_weights, start_from, weights_header
from prbench_benchmarks.captions.files import CaptionRow, TokensFile, TokensRow
from prbench_benchmarks.captions.metrics import normalised

KIND = "tm2t"
_SHORTER = 1 / 3  # of the draws lose one token at either end


@dataclass(frozen=True)
class CaptionBatch(TensorRecord):
    """Motions, padded, and their texts."""

    source: Int[Tensor, "batch length"]
    text: tuple[str, ...]


def sources(tokens: Sequence[Int[np.ndarray, " _"]], codes: int, longest: int) -> Int[Tensor, "batch length"]:
    """Return motions as the network reads them: at most ``longest`` tokens between start and end, padded."""
    framed = [torch.tensor([codes, *each[:longest].tolist(), codes + 1]) for each in tokens]
    return nn.utils.rnn.pad_sequence(framed, batch_first=True, padding_value=codes + 2)


class TokensDataset(DrawnDataset):
    """The motions of some files of tokens and a split; each draw takes one of a motion's texts.

    Args:
        tables: Files of tokens, or what was read from them.
        split: ``train``, ``validation``, or ``train+validation``.
        longest: Tokens of a motion beyond which it is cut.
        seed: Seed of the draws.

    Raises:
        UsageError: if a file has other codes than the first one.
        TableError: if a file has no motion of this split.
        InputFileError: if a file holds no motion tokens with texts.
    """

    def __init__(self, tables: Sequence[Path | TokensFile], *, split: str, longest: int, seed: int = 0) -> None:
        self.tables = tuple(each if isinstance(each, TokensFile) else TokensFile.read(each) for each in tables)
        self.split, self.longest, self.seed = split, longest, seed
        self.codes = self.tables[0].codes
        self.rows: list[TokensRow] = []
        counts = []
        for table in self.tables:
            if table.codes != self.codes:
                raise UsageError(f"{table.path}: expected {self.codes} codes as in the first, found {table.codes}.")
            chosen = [row for row in table.rows if row.split in parts_of(split)]
            if not chosen:
                remedy = "The column 'split' decides; without it all is train: --set validation.every=0."
                raise TableError(f"{table.path}: expected motions of split '{split}', found none. {remedy}")
            self.rows += chosen
            counts.append(len(chosen))
        self.counts = tuple(counts)
        self.lengths = np.minimum([len(row.tokens) for row in self.rows], longest)

    def collate(self, items: Sequence[tuple[Int[np.ndarray, " _"], str]]) -> CaptionBatch:
        """Pad motions, and put their texts beside them."""
        tokens, texts = zip(*items)
        return CaptionBatch(sources(tokens, self.codes, self.longest), texts)

    def __getitem__(self, index: int | tuple[int, int]) -> tuple[Int[np.ndarray, " _"], str]:
        """Return the item of a place, drawn for epoch 0, or for the epoch of a pair ``(index, epoch)``."""
        place, epoch = index if isinstance(index, tuple) else (index, 0)
        drawn = named_generator("prbench-training-tokens", self.seed, epoch, place)
        row = self.rows[place]
        text = normalised(row.text[int(drawn.integers(len(row.text)))])
        shorter, at_head = drawn.random(2) < (_SHORTER, 0.5)
        if not shorter or len(row.tokens) < 2:
            return row.tokens, text
        return row.tokens[1:] if at_head else row.tokens[:-1], text


class CaptionTraining(TrainingModule):
    """The network with its loss.

    Args:
        network: The network in its state before the first step.
        vocabulary: Pieces of the texts.
        licences: Licences of the data.
        origin: Lines for the card.
    """

    def __init__(self, network: Captioner, vocabulary: Any, licences: str, origin: tuple[str, ...]) -> None:
        super().__init__()
        self.network, self.vocabulary, self.licences, self.origin = network, vocabulary, licences, origin

    def forward(self, batch: CaptionBatch, step: int) -> dict[str, Tensor]:  # pyright: ignore[reportIncompatibleMethodOverride]  # fed with tokens
        """Return the summed loss of a batch; in validation its mean over texts, which batches of any size share."""
        shape = self.network.configuration
        start, end = shape.pieces, shape.pieces + 1
        framed = [torch.tensor([start, *self.vocabulary.encode(text)[: shape.longest], end]) for text in batch.text]
        target = nn.utils.rnn.pad_sequence(framed, batch_first=True, padding_value=self.network.padding)
        target = target.to(batch.source.device)
        logits = self.network(batch.source, target[:, :-1])
        found = caption_losses(logits, target[:, 1:], self.network.padding, shape.smoothing)
        loss = found["loss"] if step >= 0 else found["loss"] / len(target)
        per_piece = (found["loss"] / found["pieces"]).detach()
        return {"loss": loss, "loss_per_piece": per_piece, "accuracy": found["right"] / found["pieces"]}

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the network and the header of its file."""
        shape = self.network.configuration
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        return tensors, weights_header(KIND, shape, f"motion-tokens/{shape.codes}") | {"licence": self.licences}


@dataclass(frozen=True)
class CaptionTask:
    """A training task that is fed motion tokens (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str = KIND
    stages: tuple[str, ...] = ("train",)
    configurations: str = "prbench_adapters.captions"

    def items(self, tables: Sequence[Any], split: str, model: Mapping[str, Any], seed: int) -> TokensDataset:
        """Return the motions of some files, cut as the network needs them."""
        longest = converted(model, CaptionerConfiguration, "model").longest
        return TokensDataset(tables, split=split, longest=longest, seed=seed)

    def build(self, model: Mapping[str, Any], *, data: Any, initial: Path | None, stage: str) -> CaptionTraining:  # noqa: ARG002
        """Make the network in its state before the first step, or in that of weights to go on from.

        Raises:
            UsageError: if the table does not describe such a network.
            InputFileError: if the initial weights do not fit it, or GPT-2's files are not there.
        """
        shape = converted(model, CaptionerConfiguration, "model")
        texts = [normalised(text) for row in data.rows for text in row.text]
        words = words_of(texts) if shape.text == "words" else ()
        if initial is not None:  # its words keep their places
            words = read_weights(initial, kind=KIND).configuration(CaptionerConfiguration).words
        vocabulary = vocabulary_of(shape.text, words)
        shape = msgspec.structs.replace(shape, codes=data.codes, pieces=len(vocabulary), words=words)
        network = Captioner(shape)
        long_texts = sum(len(vocabulary.encode(text)) > shape.longest for text in texts)
        long_motions = sum(len(row.tokens) > shape.longest for row in data.rows)
        cut = f"cut at {shape.longest}: {long_texts} of {len(texts)} texts, {long_motions} of {len(data)} motions"
        origin = (cut, *start_from(initial, KIND, shape, network))
        licences = "; ".join(sorted({table.info.licence for table in data.tables}))
        return CaptionTraining(network, vocabulary, licences, origin)


def load_captioner(path: Path, device: str) -> tuple[Captioner, Any]:
    """Read a trained captioner: a file of weights, or the folder of its training.

    Raises:
        AdapterError: if there is no such file or device.
        InputFileError: if the file holds none, or GPT-2's files are not there or others than it was trained with.
    """
    where = torch_device(device)
    file = read_weights(resolve(path, f"{KIND}-small"), kind=KIND)
    shape = file.configuration(CaptionerConfiguration)
    vocabulary = vocabulary_of(shape.text, shape.words)
    require(path, (len(vocabulary) == shape.pieces, "pieces of text", str(shape.pieces), len(vocabulary), ""))
    network = Captioner(shape)
    file.load_into(network, "network")
    return network.eval().requires_grad_(False).to(where), vocabulary


def describe(
    network: Captioner, vocabulary: Any, rows: Sequence[TokensRow], *, beam: int, batch_size: int
) -> Iterator[CaptionRow]:
    """Write a caption of each motion, those of few tokens first.

    Args:
        network: The network in evaluation mode.
        vocabulary: Its pieces of text.
        rows: The motions.
        beam: Texts that beam search keeps; with 1 the likeliest piece follows the other.
        batch_size: Motions that are described at once without beam search.
    """
    shape = network.configuration
    device = next(network.parameters()).device
    end = shape.pieces + 1
    decoding = {"start": shape.pieces, "end": end, "longest": shape.longest + 1}
    rows = sorted(rows, key=lambda row: len(row.tokens))  # similar lengths need little padding
    together = 1 if beam > 1 else batch_size
    for batch in (rows[first : first + together] for first in range(0, len(rows), together)):
        source = sources([row.tokens for row in batch], shape.codes, shape.longest).to(device)
        written = (
            beam_search(network, source, beam, **decoding)[None] if beam > 1 else greedy(network, source, **decoding)
        )
        for row, ids in zip(batch, written[:, 1:].tolist(), strict=True):
            pieces = ids[: ids.index(end)] if end in ids else ids
            text = vocabulary.decode([each for each in pieces if each < shape.pieces])
            yield CaptionRow(motion_id=row.motion_id, candidate=text, references=row.text, cut=end not in ids)
