"""Text encoders: captions to frozen token vectors, padded to the longest text of the batch.

``hashed-ngrams`` is built in: nothing learned, nothing to download. A word's vector is the scaled sum of a random
vector of its own and one for each of its character 3- to 5-grams, so that *pick* and *picks* are neighbours. The random
vectors come from SHA-256 in whole numbers; the only roundings are those of single IEEE operations. So the vectors are
the same bytes on every machine. The bundled weights are trained on them: **nothing of it may change**; another recipe
is another encoder with another name.

``distilbert`` and ``clip-vit-b32`` have weights of their own and run through transformers
(docs/specification/mdm.md#network). Weights are read from safetensors files only, and no code of a repository is run.
torch and transformers are imported, and weights loaded, with the first text. Texts go through a network one by one and
their vectors are kept, so that a vector depends on its text alone, to the last bit.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError, MissingExtraError, UsageError, did_you_mean
from prbench.files.bounded import require_size
from prbench.limits import HARMLESS_SIZE, LARGEST_UNPACKED


@dataclass(frozen=True, eq=False)
class EncodedText:
    """The token vectors of some texts.

    Attributes:
        tokens: float32; zero where there is padding.
        padding: True where a text has no token. Every text has at least one token.
    """

    tokens: Float[np.ndarray, "texts tokens dimension"]
    padding: Bool[np.ndarray, "texts tokens"]


@runtime_checkable
class TextEncoder(Protocol):
    """Frozen: the same text always has the same vectors, whatever stands beside it in a batch."""

    @property
    def name(self) -> str:
        """Name by which weights that were trained with these vectors call them."""
        ...

    @property
    def dimension(self) -> int:
        """Length of a token vector."""
        ...

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """Return the token vectors of some texts (at least one)."""
        ...


def padded(texts: Sequence[Float[np.ndarray, "_ dimension"]], dimension: int) -> EncodedText:
    """Stack the token vectors of texts of different lengths.

    Args:
        texts: The vectors of each text (tokens, dimension); at least one token each.
        dimension: Length of a vector.
    """
    lengths = np.array([len(vectors) for vectors in texts], dtype=np.int64)
    longest = int(lengths.max(initial=1))
    tokens = np.zeros((len(texts), longest, dimension), dtype=np.float32)
    for row, vectors in enumerate(texts):
        tokens[row, : len(vectors)] = vectors
    return EncodedText(tokens, np.arange(longest) >= lengths[:, None])


HASHED_NGRAMS = "hashed-ngrams"
DIMENSION = 64
MOST_WORDS = 32  # later words of a text are dropped
_NGRAMS = (3, 4, 5)
_WORD = re.compile(r"[^\W_]+")
_DIGESTS = DIMENSION * 2 // hashlib.sha256().digest_size
_UNIT = np.sqrt(3.0 / (65536.0**2 - 1.0))  # of the odd numbers -65535, -65533 … 65535: makes their variance 1


class HashedNgrams:
    """One token a word; words know nothing of each other or of their place. An empty text is one zero token."""

    name = HASHED_NGRAMS
    dimension = DIMENSION

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """Return the vectors of the first 32 words of each text (see :class:`TextEncoder`)."""
        vectors = []
        for text in texts:
            found = words(text)
            empty = np.zeros((1, DIMENSION), dtype=np.float32)
            vectors.append(np.stack([_word_vector(word) for word in found]) if found else empty)
        return padded(vectors, DIMENSION)


def words(text: str) -> list[str]:
    """Return the lower-case runs of letters and digits of a text, at most 32."""
    return _WORD.findall(unicodedata.normalize("NFC", text).lower())[:MOST_WORDS]


@lru_cache(maxsize=65536)
def _word_vector(word: str) -> Float[np.ndarray, " 64"]:
    """Return the sum of the parts over the root of their number: mean 0 and variance 1 over words."""
    grams = ngrams(word)
    integers = sum((_random_integers("ngram", gram) for gram in grams), start=_random_integers("word", word))
    vector = (integers * (_UNIT / np.sqrt(1.0 + len(grams)))).astype(np.float32)
    vector.flags.writeable = False
    return vector


def ngrams(word: str) -> tuple[str, ...]:
    """Return the distinct runs of 3, 4 and 5 characters of ``<word>``, in the order of their first places."""
    marked = f"<{word}>"
    return tuple(dict.fromkeys(marked[at : at + n] for n in _NGRAMS for at in range(len(marked) - n + 1)))


def _random_integers(kind: str, text: str) -> np.ndarray:
    """Return the odd numbers from -65535 to 65535 that belong to a text (64,), int64."""
    seeds = (f"prbench/{HASHED_NGRAMS}/{kind}/{part}/{text}" for part in range(_DIGESTS))
    digest = b"".join(hashlib.sha256(seed.encode("utf-8")).digest() for seed in seeds)
    return 2 * np.frombuffer(digest, dtype="<u2").astype(np.int64) - 65535


CLIP = "clip-vit-b32"
CLIP_VARIABLE = "PRBENCH_CLIP"  # environment variable: a local folder or a hub id
DISTILBERT = "distilbert"
DISTILBERT_VARIABLE = "PRBENCH_DISTILBERT"  # environment variable: a local folder or a hub id
_CLIP_HUB_ID = "openai/clip-vit-base-patch32"
_DISTILBERT_HUB_ID = "distilbert/distilbert-base-uncased"
# Distinct texts whose vectors are kept in memory (2 kB each of CLIP, about 35 kB each of DistilBERT)
_MOST_KEPT = 65536
_OF_IMAGES = [r"vision_model\.", r"visual_projection\.", r"logit_scale", r"position_ids"]
_HUB_ID = re.compile(r"[\w.-]+(/[\w.-]+)?")


class _Pretrained:
    """A frozen network on the CPU in float32.

    Args:
        path: A local folder or a hub id; by default what the environment variable names, else the public model's id.

    Raises:
        MissingExtraError: if transformers is not installed.

    Attributes:
        _expected: Content of the files, as a message says it.
    """

    name: str
    dimension: int
    _variable: str
    _hub_id: str
    _expected: str
    _remedy: str
    _most_pieces: int

    def __init__(self, path: Path | str | None = None) -> None:
        if importlib.util.find_spec("transformers") is None:
            raise MissingExtraError("transformers", "text", f"the text encoder '{self.name}'")
        self.source = str(path or os.environ.get(self._variable) or self._hub_id)
        self._loaded: tuple[Any, Any] | None = None
        self._vectors = lru_cache(maxsize=_MOST_KEPT)(self._encode_one)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """Return the token vectors of each text (see :class:`TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are those of another model.
        """
        return padded([self._vectors(text) for text in texts], self.dimension)

    def _encode_one(self, text: str) -> Float[np.ndarray, "tokens dimension"]:
        import torch

        if self._loaded is None:
            self._loaded = self._load()
        tokenizer, model = self._loaded
        pieces = tokenizer([text], truncation=True, max_length=self._most_pieces, return_tensors="pt")
        with torch.inference_mode():
            return self._vectors_of(model, pieces).float().numpy()

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        raise NotImplementedError

    def _classes(self) -> tuple[Any, Any]:
        """Return the classes of tokenizer and model in transformers."""
        raise NotImplementedError

    def _load(self) -> tuple[Any, Any]:
        """Load tokenizer and model without running code of a repository; a folder is read without asking the hub."""
        local = Path(self.source).is_dir()
        if not local and _HUB_ID.fullmatch(self.source) is None:
            raise self._unusable("no such folder")
        if not local:
            local = self._is_in_the_hubs_cache()
        careful = {"trust_remote_code": False, "local_files_only": local}
        tokenizer_class, model_class = self._classes()
        for file in Path(self.source).iterdir() if Path(self.source).is_dir() else ():
            if not file.is_dir():
                require_size(file, largest=HARMLESS_SIZE if file.suffix in (".json", ".txt") else LARGEST_UNPACKED)
        try:
            tokenizer = tokenizer_class.from_pretrained(self.source, **careful)
            loaded = model_class.from_pretrained(self.source, **careful, use_safetensors=True, output_loading_info=True)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            why = str(error).strip().partition("\n")[0].rstrip(".")[:300] or type(error).__name__
            raise self._unusable(f"none that can be loaded ({why})") from error
        model, report = loaded
        if missing := sorted(report["missing_keys"]):  # they would be random numbers
            raise self._unusable(f"a model without '{missing[0]}'")
        dimension = getattr(model.config, "projection_dim", None) or model.config.dim
        if dimension != self.dimension:
            raise self._unusable(f"a model of dimension {dimension}")
        # A vocabulary may be made up: transformers takes a missing one for an empty one.
        if self.name == CLIP and len(tokenizer) != model.config.vocab_size:
            raise self._unusable(f"a vocabulary of {len(tokenizer)} pieces for a model of {model.config.vocab_size}")
        return tokenizer, model.eval().requires_grad_(False)

    def _is_in_the_hubs_cache(self) -> bool:
        """Return True if the model was downloaded before; else ask once whether the hub answers.

        Raises:
            InputFileError: if it does not. Loading would ask six times for each of a dozen files, which takes minutes.
        """
        from huggingface_hub import HfApi, try_to_load_from_cache

        wanted = ("config.json", "model.safetensors")
        if all(isinstance(try_to_load_from_cache(self.source, name), str) for name in wanted):
            return True
        try:
            HfApi().model_info(self.source, timeout=10)
        except Exception as error:  # of whichever HTTP library the hub's client uses
            problem = "no answer from the model hub"
            raise self._unusable(f"{problem} ({str(error)[:200] or type(error).__name__})") from error
        return False

    def _unusable(self, found: str) -> InputFileError:
        return InputFileError(self.source, "", expected=self._expected, found=found, remedy=self._remedy)


class DistilBert(_Pretrained):
    """DistilBERT (base, uncased), the paper's text encoder: the last hidden states of all word pieces.

    The two special pieces are among them. A local folder has ``config.json``, ``model.safetensors``,
    ``tokenizer.json`` or ``vocab.txt``.
    """

    name = DISTILBERT
    dimension = 768
    _variable = DISTILBERT_VARIABLE
    _hub_id = _DISTILBERT_HUB_ID
    _expected = f"DistilBERT base uncased (dimension {dimension}) as safetensors"
    _remedy = (
        "Download config.json, model.safetensors, tokenizer.json, tokenizer_config.json and vocab.txt of"
        f" '{_DISTILBERT_HUB_ID}' on a machine with internet, put them into one folder, and name that folder with the"
        f" environment variable {DISTILBERT_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 512  # DistilBERT has no more positions; longer texts are cut

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        return model(input_ids=pieces["input_ids"], attention_mask=pieces["attention_mask"]).last_hidden_state[0]

    def _classes(self) -> tuple[Any, Any]:
        from transformers import DistilBertModel, DistilBertTokenizerFast

        return DistilBertTokenizerFast, DistilBertModel


class Clip(_Pretrained):
    """Text tower of CLIP ViT-B/32, which MDM and GMD were released with; they compute it in half precision.

    A text has **one** vector, so it is one token: the mean over its tokens is that vector. It is what OpenAI's
    ``encode_text`` gives: the state of the last layer at the end-of-text piece (the one with the highest id), after the
    final normalisation, times the projection into the space of images; it is not scaled to unit length. Attention looks
    back only, so the zeros behind that piece, which the original pads with, make no difference and are left away.
    Captions are taken as they are; the original also mends broken Unicode and HTML entities first.

    A local folder has ``config.json``, ``model.safetensors`` of the text tower or of all of CLIP, and
    ``tokenizer.json`` or ``vocab.json`` with ``merges.txt``.
    """

    name = CLIP
    dimension = 512
    _variable = CLIP_VARIABLE
    _hub_id = _CLIP_HUB_ID
    _expected = f"CLIP ViT-B/32 (text vectors of {dimension} numbers) as safetensors"
    _remedy = (
        "Save text tower and vocabulary into one folder on a machine with internet: "
        'python -c "from transformers import CLIPTextModelWithProjection as M, CLIPTokenizerFast as T; '
        f"[part.from_pretrained('{_CLIP_HUB_ID}').save_pretrained('clip-vit-b32') for part in (M, T)]\" "
        f"and name that folder with the environment variable {CLIP_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 22  # the two special ones among them; MDM and GMD cut longer captions there

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        ids = pieces["input_ids"]
        return model.text_projection(model(input_ids=ids).last_hidden_state[0][int(ids[0].argmax())])[None]

    def _classes(self) -> tuple[Any, Any]:
        from transformers import (
            CLIPTextModelWithProjection,
            CLIPTokenizerFast,  # pyright: ignore[reportAttributeAccessIssue] - an alias made late
        )

        # Silent about the parts of a whole CLIP that it does not need.
        silent = {"_keys_to_ignore_on_load_unexpected": _OF_IMAGES}
        return CLIPTokenizerFast, type("TextTower", (CLIPTextModelWithProjection,), silent)


NAMES = (HASHED_NGRAMS, DISTILBERT, CLIP)


def text_encoder(name: str, path: Path | str | None = None) -> TextEncoder:
    """Return the frozen text encoder of this name.

    Args:
        name: ``hashed-ngrams`` (built in), ``distilbert`` (the paper's; extra ``text``) or ``clip-vit-b32`` (one
            vector a text, for released weights of MDM and GMD; extra ``text``).
        path: A local folder or a hub id of a pretrained encoder; by default what ``PRBENCH_DISTILBERT`` or
            ``PRBENCH_CLIP`` names, else the public id. Weights are loaded when the first text is encoded.

    Raises:
        UsageError: if there is no such encoder, or it has no files to be found under a path.
    """
    if name == HASHED_NGRAMS:
        if path is not None:
            raise UsageError(f"the text encoder '{name}' is built in and reads no files. Leave its path away.")
        return HashedNgrams()
    if name == DISTILBERT:
        return DistilBert(path)
    if name == CLIP:
        return Clip(path)
    raise UsageError(f"there is no text encoder '{name}'.{did_you_mean(name, NAMES)} Known: {', '.join(NAMES)}.")
