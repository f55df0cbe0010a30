"""A CLIP text tower of random weights and few words, in the files of the public model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_LETTERS = "!.abcdefghijklmnopqrstuvwxyz"
_MERGES = [("p", "u"), ("t", "s</w>"), ("pu", "ts</w>")]
VOCABULARY = [
    *_LETTERS,
    *(f"{letter}</w>" for letter in _LETTERS),
    *("".join(pair) for pair in _MERGES),
    "<|startoftext|>",
    "<|endoftext|>",
]
"""Of a public vocabulary it has what matters: ``!`` is piece 0, the end of a text the highest one."""
START, END = len(VOCABULARY) - 2, len(VOCABULARY) - 1


def text_configuration(**changes: Any) -> Any:
    """Two layers of width 16; ``eos_token_id`` is the wrong 2 that stands in the public model's file."""
    import transformers

    values = {
        "vocab_size": len(VOCABULARY),
        "hidden_size": 16,
        "intermediate_size": 32,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "projection_dim": 512,
        "bos_token_id": 0,
        "eos_token_id": 2,
    }
    return transformers.CLIPTextConfig(**{**values, **changes})


def model(seed: int = 0, **changes: Any) -> Any:
    """Random numbers in every parameter, the norms' too, so that each of them matters."""
    import torch
    import transformers

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        made = transformers.CLIPTextModelWithProjection(text_configuration(**changes))
        for parameter in made.parameters():
            torch.nn.init.normal_(parameter, 0.0, 0.3)
    return made.eval()


def write_vocabulary(folder: Path) -> None:
    """``vocab.json`` and ``merges.txt``."""
    pieces = {piece: number for number, piece in enumerate(VOCABULARY)}
    (folder / "vocab.json").write_text(json.dumps(pieces), encoding="utf-8")
    merges = "\n".join(" ".join(pair) for pair in _MERGES)
    (folder / "merges.txt").write_text(f"#version: 0.2\n{merges}\n", encoding="utf-8")


def write(folder: Path, **changes: Any) -> Path:
    """The folder with all that the encoder needs."""
    folder.mkdir(parents=True, exist_ok=True)
    model(**changes).save_pretrained(folder, safe_serialization=True)
    write_vocabulary(folder)
    return folder
