"""Training of the captioner on motion tokens with texts, and its task of ``prbench train``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from prbench_adapters.captions.network import Captioner, CaptionerConfiguration, caption_losses
from prbench_adapters.captions.vocabulary import Gpt2, Vocabulary, Words
from prbench_adapters.prediction.training import converted
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.batches import DrawnDataset
from prbench_adapters.training.store import parts_of
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.training.weights import read_weights, start_from, weights_header
from prbench_benchmarks.captions.files import TokensFile
from prbench_benchmarks.captions.metrics import load_caption_protocol

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
        UsageError: if files have other codes than one another, or lack splits where one is to be validated on.
        TableError: if a file has no motion of this split.
        InputFileError: if a file holds no motion tokens with texts.
    """

    def __init__(self, tables: Sequence[Path | TokensFile], *, split: str, longest: int, seed: int = 0) -> None:
        self.tables = tuple(each if isinstance(each, TokensFile) else TokensFile.read(each) for each in tables)
        self.split, self.longest, self.seed = split, longest, seed
        self.codes = self.tables[0].codes
        normalised = load_caption_protocol().normalised
        self.tokens: list[Int[np.ndarray, " _"]] = []
        self.texts: list[tuple[str, ...]] = []
        counts = []
        for table in self.tables:
            if table.codes != self.codes:
                raise UsageError(f"{table.path}: expected {self.codes} codes as in the first file, found {table.codes}.")
            if split == "validation" and None in table.splits:
                problem = "expected a column 'split' to validate by, found none. Add it, or --set validation.every=0."
                raise UsageError(f"{table.path}: {problem}")
            places = table.places(*parts_of(split))
            if not places:
                raise TableError(f"{table.path}: expected motions of split '{split}', found none.")
            self.tokens += [table.tokens[place] for place in places]
            self.texts += [tuple(map(normalised, table.texts[place])) for place in places]
            counts.append(len(places))
        self.counts = tuple(counts)
        self.lengths = np.minimum([len(each) for each in self.tokens], longest)

    def collate(self, items: Sequence[tuple[Int[np.ndarray, " _"], str]]) -> CaptionBatch:
        """Pad motions, and put their texts beside them."""
        tokens, texts = zip(*items)
        return CaptionBatch(sources(tokens, self.codes, self.longest), texts)

    def __getitem__(self, index: int | tuple[int, int]) -> tuple[Int[np.ndarray, " _"], str]:
        """Return the item of a place, drawn for epoch 0, or for the epoch of a pair ``(index, epoch)``."""
        place, epoch = index if isinstance(index, tuple) else (index, 0)
        drawn = named_generator("prbench-training-tokens", self.seed, epoch, place)
        tokens, texts = self.tokens[place], self.texts[place]
        text = texts[int(drawn.integers(len(texts)))]
        if drawn.random() < _SHORTER and len(tokens) > 1:
            tokens = tokens[1:] if drawn.random() < 0.5 else tokens[:-1]
        return tokens, text


class CaptionTraining(TrainingModule):
    """The network with its loss.

    Args:
        network: The network in its state before the first step.
        vocabulary: Pieces of the texts.
        licences: Licences of the data.
        origin: Lines for the card.
    """

    def __init__(self, network: Captioner, vocabulary: Vocabulary, licences: str, origin: tuple[str, ...]) -> None:
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
        texts = [text for each in data.texts for text in each]
        words = ()
        if shape.text == "words":
            words = Words.of(texts).words
            if initial is not None:  # its words keep their places
                words = read_weights(initial, kind=KIND).configuration(CaptionerConfiguration).words
        vocabulary = Gpt2() if shape.text == "gpt2" else Words(words)
        shape = msgspec.structs.replace(shape, codes=data.codes, pieces=len(vocabulary), words=words)
        network = Captioner(shape)
        long_texts = sum(len(vocabulary.encode(text)) > shape.longest for text in texts)
        long_motions = sum(len(each) > shape.longest for each in data.tokens)
        empty = sum(table.empty_texts for table in data.tables)
        cut = f"cut at {shape.longest}: {long_texts} of {len(texts)} texts, {long_motions} of {len(data)} motions"
        origin = (f"{cut}; texts without letters, left out: {empty}", *start_from(initial, KIND, shape, network))
        licences = "; ".join(sorted({table.info.licence for table in data.tables}))
        return CaptionTraining(network, vocabulary, licences, origin)


def load_captioner(path: Path, device: torch.device) -> tuple[Captioner, Vocabulary]:
    """Read a trained captioner.

    Raises:
        InputFileError: if the file holds none, or GPT-2's files are not there or others than it was trained with.
    """
    file = read_weights(path, kind=KIND)
    shape = file.configuration(CaptionerConfiguration)
    vocabulary = Gpt2() if shape.text == "gpt2" else Words(shape.words)
    require(path, (len(vocabulary) == shape.pieces, "pieces of text", str(shape.pieces), len(vocabulary), ""))
    network = Captioner(shape)
    file.load_into(network, "network")
    return network.eval().requires_grad_(False).to(device), vocabulary
