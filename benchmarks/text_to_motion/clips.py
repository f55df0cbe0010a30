"""Motions as the evaluator takes them, and the features that it extracts from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.errors import TableError, UsageError
from prbench.randomness import named_generator
from prbench.representation import Statistics
from prbench.sequences import CorpusTable, SequenceTable
from prbench.text import EncodedText, text_encoder
from prbench.text import TextEncoder as TokenVectors
from prbench_adapters.training.store import Row, cut, encoded, frame_rate, open_table, read_rows
from prbench_benchmarks.text_to_motion import networks
from prbench_benchmarks.text_to_motion.metrics import BATCH

_SHORTER = 1 / 3


@dataclass(frozen=True)
class Pass:
    """The settings by which one pass draws crops and captions, as a function of these and of a clip's id alone.

    Attributes:
        name: ``reference``, ``real`` or ``generated``.
    """

    seed: int
    repetition: int
    name: str

    def generator(self, *parts: str) -> np.random.Generator:
        """Return the pass's own generator for one purpose, or for one clip."""
        path = "/".join(parts).split("/")  # the id of a clip holds slashes
        return named_generator("prbench-text-to-motion", self.seed, self.repetition, self.name, *path)


@dataclass(frozen=True)
class Draw:
    """The crop and caption of a clip in one pass.

    Attributes:
        n_frames: A multiple of 4.
    """

    caption: str
    start: int
    n_frames: int


@dataclass(frozen=True)
class EvaluatedClips:
    """The clips of a split that can be evaluated.

    Attributes:
        left_out: Number of clips without a caption of the kinds asked for, or shorter than 4 frames.
    """

    table: SequenceTable | CorpusTable
    split: str
    clips: tuple[Row, ...]
    left_out: int

    @classmethod
    def read(cls, folder: Path, *, split: str, kinds: frozenset[str], fps: float) -> EvaluatedClips:
        """Read the clips of a corpus, or the sequences of a P&R table.

        Args:
            folder: The table's folder.
            split: ``train``, ``validation`` or ``test``.
            kinds: Kinds of captions; empty for all. P&R tables know no kinds.
            fps: What the evaluator was trained for.

        Raises:
            TableError: if the table is of another rate, or has fewer than 32 such clips.
            UsageError: if kinds are asked of a P&R table.
        """
        table = open_table(folder)
        rate = frame_rate(table, split)
        if rate != fps:
            problem = f"expected {fps:g} frames per second, as the evaluator was trained, found {rate:g}."
            raise TableError(f"{folder}: {problem}")
        allowed = None
        if kinds:
            if not isinstance(table, CorpusTable):
                why = "is a table of sequences, whose texts are of one kind. Leave --kind away."
                raise UsageError(f"{folder} {why}")
            scalars = table.scalars()
            rows = scalars["captions"].to_pylist()
            known = {caption["kind"] for row in rows for caption in row}
            if not kinds & known:
                remedy = f"there are {', '.join(sorted(known))}."
                raise UsageError(f"{folder}: no caption is of kind {', '.join(sorted(kinds))}; {remedy}")
            texts = [tuple(caption["text"] for caption in row if caption["kind"] in kinds) for row in rows]
            allowed = dict(zip(scalars["sequence_id"].to_pylist(), texts))
        clips = []
        left_out = 0
        for rows in read_rows(table, split):
            for row in rows:
                # P&R tables have one text a sequence; corpora have captions of several kinds.
                captions = row.texts if allowed is None else allowed.get(row.sequence_id, ())
                if captions and row.motion.n_frames >= networks.SNIPPET:
                    motion = row.motion  # copied, so as not to keep the chunk alive from which it was read
                    names = ("joints", "previous_joints", "next_joints")
                    motion = replace(motion, **{name: getattr(motion, name).copy() for name in names})
                    clips.append(replace(row, texts=captions, motion=motion))
                else:
                    left_out += 1
        if len(clips) < BATCH:
            raise TableError(
                f"{folder}: expected {BATCH} clips or more of split '{split}' with a caption"
                f"{' of kind ' + ', '.join(sorted(kinds)) if kinds else ''}, found {len(clips)}."
            )
        # Sorted by id, so that draws depend on nothing but seed and id, not on how the table was written.
        return cls(table, split, tuple(sorted(clips, key=lambda clip: clip.sequence_id)), left_out)

    def captions(self) -> tuple[str, ...]:
        """Return all distinct captions, sorted."""
        return tuple(sorted({caption for clip in self.clips for caption in clip.texts}))


def longest(clip: Row, configuration: networks.EvaluatorConfiguration) -> int:
    """Return the most frames that are evaluated of a clip, a multiple of 4."""
    return min(clip.motion.n_frames, configuration.max_frames) // networks.SNIPPET * networks.SNIPPET


def draw(clip: Row, taken: Pass, configuration: networks.EvaluatorConfiguration) -> Draw:
    """Choose a caption and a crop: a multiple of 4 frames, one time in three 4 fewer.

    Source: docs/specification/mdm.md#training.
    """
    generator = taken.generator(clip.sequence_id)
    caption = clip.texts[int(generator.integers(len(clip.texts)))]
    n_frames = longest(clip, configuration)
    # HumanML3D's own loader shortens one clip in three, so that lengths vary beyond multiples of 4.
    if generator.random() < _SHORTER and n_frames > networks.SNIPPET:
        n_frames -= networks.SNIPPET
    return Draw(caption, int(generator.integers(clip.motion.n_frames - n_frames + 1)), n_frames)


def recorded_features(
    clip: Row, drawn: Draw, configuration: networks.EvaluatorConfiguration
) -> Float[np.ndarray, "n 263"]:
    """Return the crop, encoded anew in its own canonical frame."""
    motion = cut(clip.motion, drawn.start, drawn.n_frames, name=clip.sequence_id)
    return encoded(motion, configuration.representation, name=clip.sequence_id)


def token_vectors(
    name: str, tables: Iterable[SequenceTable | CorpusTable], *, words: str = "", path: str = ""
) -> tuple[TokenVectors, str]:
    """Return an evaluator's vectors of words, and the digest of the vocabulary that a user supplied, if any.

    Args:
        name: ``glove``, or the name of a text encoder.
        tables: Whose captions will be read; GloVe needs the tokens that stand beside them.
        words: Folder of the word vectors and lists, for ``glove``.
        path: Folder or hub id of a text encoder that has files.

    Raises:
        UsageError: if a path is missing, or given to vectors that read no files.
        InputFileError: if the files are not what they should be.
    """
    if name != networks.GLOVE:
        if words:
            raise UsageError(f"the text vectors '{name}' need no word vectors. Leave their folder away.")
        return text_encoder(name, path or None), ""
    if not words:
        raise UsageError(
            "a GloVe evaluator needs the folder of its word vectors (words.txt, vectors.npy and the five lists):"
            " --set model.words=DIR for training, --words DIR for evaluation."
        )
    tables = list(tables)
    vectors = networks.WordVectors.read(Path(words))
    source = ", ".join(str(table.folder) for table in tables)
    # The ``word/POS`` tokens of every caption; P&R tables have none.
    corpora = (table for table in tables if isinstance(table, CorpusTable))
    captions = (caption for table in corpora for row in table.scalars()["captions"].to_pylist() for caption in row)
    tokens = {caption["text"]: caption["tokens"] for caption in captions}
    return networks.GloveCaptions(vectors, tokens, source=source), vectors.digest


_AT_ONCE = 128


@dataclass(eq=False)
class Extractor:
    """Embeds motions and texts with its own statistics: every evaluator input goes through here, and only here.

    Args:
        configuration: Sizes and representation.
        movement: Encoder of snippets.
        motion: Encoder of motions.
        text: Encoder of texts.
        statistics: Already weighted for an evaluator (:meth:`prbench.representation.Statistics.for_evaluator`).
        tokens: Vectors of the words of a text.
        device: Device that the networks run on.
        digest: SHA-256 of the weights.
        words_digest: Digest of the user's word vectors and lists; empty if it needs none.
    """

    configuration: networks.EvaluatorConfiguration
    movement: networks.MovementEncoder
    motion: networks.SequenceEncoder
    text: networks.TextEncoder
    statistics: Statistics
    tokens: TokenVectors
    device: str = "cpu"
    digest: str = ""
    words_digest: str = ""

    def __post_init__(self) -> None:
        for network in (self.movement, self.motion, self.text):
            network.eval().requires_grad_(False).to(self.device)

    @property
    def vectorisation(self) -> str:
        """Name of the way in which it reads texts; numbers of different ways never stand in one column."""
        name = self.configuration.text
        return f"{name}/{self.words_digest[:12]}" if self.words_digest else name

    @torch.inference_mode()
    def embed_motions(self, features: Sequence[Float[np.ndarray, "_ 263"]]) -> Float[np.ndarray, "motions dimension"]:
        """One embedding a motion, float32.

        Args:
            features: Raw features of each motion, 4 frames or more; what exceeds a multiple of 4 is left out.

        Raises:
            ValueError: if a motion is shorter than 4 or longer than ``max_frames`` frames.
        """
        lengths = np.array([len(rows) for rows in features], dtype=np.int64)
        for row in np.flatnonzero((lengths < networks.SNIPPET) | (lengths > self.configuration.max_frames)):
            limits = f"{networks.SNIPPET} to {self.configuration.max_frames}"
            raise ValueError(f"motion {row}: expected {limits} frames, found {lengths[row]}")
        snippets = lengths // networks.SNIPPET
        embeddings = np.empty((len(lengths), self.configuration.embedding), dtype=np.float32)
        # Similar lengths together: batches differ in padding, never in what they embed.
        order = np.argsort(snippets, kind="stable")
        for start in range(0, len(order), _AT_ONCE):
            rows = order[start : start + _AT_ONCE]
            # Standardised without the contacts, then padded with zeros to the longest.
            frames = int(snippets[rows].max()) * networks.SNIPPET
            batch = np.zeros((len(rows), frames, networks.MOVEMENT_FEATURES), dtype=np.float32)
            for place, row in enumerate(rows):
                n = snippets[row] * networks.SNIPPET
                batch[place, :n] = self.statistics.standardise(features[row][:n])[:, : networks.MOVEMENT_FEATURES]
            counts = torch.from_numpy(snippets[rows]).to(self.device)
            steps = self.movement(torch.from_numpy(batch).to(self.device), counts * networks.SNIPPET)
            embeddings[rows] = self.motion(steps, counts).float().cpu().numpy()
        return embeddings

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> Float[np.ndarray, "texts dimension"]:
        """One embedding a text, float32."""
        embeddings = np.empty((len(texts), self.configuration.embedding), dtype=np.float32)
        for start in range(0, len(texts), _AT_ONCE):
            tokens, lengths = cut_tokens(self.tokens.encode(texts[start : start + _AT_ONCE]), self.configuration)
            embedded = self.text(tokens.to(self.device), lengths)
            embeddings[start : start + len(tokens)] = embedded.float().cpu().numpy()
        return embeddings


def cut_tokens(
    encoded: EncodedText, configuration: networks.EvaluatorConfiguration
) -> tuple[Float[torch.Tensor, "texts tokens dimension"], Int[torch.Tensor, " texts"]]:
    """Token vectors as tensors, and how many each text has: at most ``most_tokens``."""
    lengths = np.minimum((~encoded.padding).sum(axis=1), configuration.most_tokens)
    return torch.from_numpy(encoded.tokens[:, : int(lengths.max(initial=1))]), torch.from_numpy(lengths)
