"""Blind pairs: a page on which people say which of two motions is the recorded one, and what their answers say.

The page (``pairs.html`` beside this file) loads nothing and does not know the key, which stands in a file of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import structured
from prbench.files.storage import read_json, sole_writer, text_digest, write_json, write_text
from prbench.harness.intervals import clustered, rate_interval
from prbench.randomness import named_generator
from prbench.tables import Block, Column, Row, Table, metric_cell
from prbench.viewing.player.document import encoded, player_sequence
from prbench.viewing.player.page import filled, player_assets
from prbench.viewing.replay.scene import METHOD_COLOURS, Scene

PAGE = "pairs.html"
KEY = "key.json"
_SIDES = ("A", "B")
# What the player would tell of a motion beside its body.
_UNTOLD: dict[str, Any] = {"gaze": None, "gaze_valid": None, "wrist": None, "head": None, "scores": []}
_UNTOLD |= {"on_target": [], "within_reach": [], "sliding": []}


class KeptPair(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one pair has shown.

    Attributes:
        sides: Whose motion stood left (A) and whose right (B).
    """

    sequence_id: str
    dataset: str
    recording_id: str
    sides: tuple[str, str]


class PairsKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The key of a page of pairs.

    Attributes:
        page: Digest of what the page shows, which stands in each file of answers.
        question: What people are asked.
        right: Whose motion is the right answer.
        pairs: The pairs in the order of the page.
    """

    page: str
    question: str
    right: str
    seed: int
    pairs: tuple[KeptPair, ...]


class PairAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The side that was chosen, of the pair of this number, from 1 on."""

    pair: int
    choice: Literal["A", "B"]


class PairAnswers(msgspec.Struct, frozen=True, kw_only=True):
    """The file that the page saves."""

    page: str
    judge: str
    answers: tuple[PairAnswer, ...]


def write_pairs(scenes: Sequence[Scene], folder: Path, *, question: str, right: str, seed: int) -> PairsKey:
    """Write the page of some pairs, and its key.

    Args:
        scenes: Two motions each; their order leaves no trace.
        folder: Gets ``pairs.html`` and ``key.json``; a page of the same pairs in it is written again.
        question: What people are asked.
        right: Label of the motion that is the right answer.
        seed: Decides the order of the pairs and the side of each motion; as many stand left as right.

    Raises:
        UsageError: if the folder holds the key of another page, whose answers it would make worthless.
        StorageError: if a file cannot be written.
    """
    generator = named_generator("blind pairs", seed)
    flipped = generator.permutation(np.arange(len(scenes)) % 2)
    shown = []
    pairs = []
    for number, (place, flip) in enumerate(zip(generator.permutation(len(scenes)), flipped, strict=True), 1):
        scene = scenes[place]
        motions = scene.motions[::-1] if flip else scene.motions
        named = zip(motions, _SIDES, METHOD_COLOURS, strict=False)
        blind = tuple(replace(motion, label=side, colour=c, kind="method", gaze=None) for motion, side, c in named)
        told = player_sequence(replace(scene, sequence_id=f"pair {number}", dataset="", notice="", motions=blind))
        bodies = [msgspec.structs.replace(motion, **_UNTOLD) for motion in told.motions]
        shown.append(encoded(msgspec.structs.replace(told, motions=bodies)).decode())
        about = {name: getattr(scene, name) for name in ("sequence_id", "dataset", "recording_id")}
        pairs.append(KeptPair(sides=(motions[0].label, motions[1].label), **about))
    page = text_digest(question, *shown)
    key = PairsKey(page=page, question=question, right=right, seed=seed, pairs=tuple(pairs))
    notice = " ".join(dict.fromkeys(scene.notice for scene in scenes if scene.notice))
    parts = {"STYLE": player_assets().style}
    parts["DATA"] = encoded({"page": page, "question": question, "notice": notice}).decode()
    parts["PAIRS"] = "\n".join(f'<script type="application/json" class="pair">{each}</script>' for each in shown)
    parts["PLAYER"] = player_assets().scripts
    with sole_writer(folder / PAGE):
        if (folder / KEY).is_file() and read_key(folder).page != page:
            raise UsageError(f"{folder / KEY}: is the key of another page, whose answers need it. Choose a new folder.")
        write_json(folder / KEY, msgspec.to_builtins(key))
        write_text(folder / PAGE, filled(Path(__file__).with_name(PAGE), parts))
    return key


def read_key(folder: Path) -> PairsKey:
    """Read the key of the pairs in a folder.

    Raises:
        UsageError: if there is none.
        InputFileError: if it holds something else.
    """
    path = folder / KEY
    if not path.is_file():
        raise UsageError(f"{folder}: holds no {KEY}. Name the folder that `prbench analyse pairs --out` has written.")
    return structured(path, read_json(path), PairsKey, remedy="Write the page again, into a new folder.")


def answers_table(folder: Path, files: Sequence[Path]) -> Table:
    """Count how often people found the right motion.

    Args:
        folder: Holds the key.
        files: Answers that the page has saved, one or more a person.

    Returns:
        A row for everybody, for each person and for each dataset: the share of right answers in %, of which half is
        chance, with its interval over recordings.

    Raises:
        InputFileError: if a file holds no answers, those to another page, or a person's second answer to a pair.
    """
    key = read_key(folder)
    found: dict[tuple[str, int], str] = {}
    for path in files:
        given = structured(path, read_json(path), PairAnswers, remedy="Name the file that the page has saved.")
        if given.page != key.page:
            raise InputFileError(path, "page", expected=f"answers to the page of {folder}", found="those to another")
        for place, answer in enumerate(given.answers):
            where = f"answers[{place}]"
            if not 1 <= answer.pair <= len(key.pairs):
                raise InputFileError(path, where, expected=f"a pair from 1 to {len(key.pairs)}", found=answer.pair)
            if (given.judge, answer.pair) in found:
                second = f"a second one of {given.judge!r} to pair {answer.pair}"
                raise InputFileError(path, where, expected="one answer a person and pair", found=second)
            found[given.judge, answer.pair] = answer.choice
    if not found:
        raise UsageError(f"{', '.join(map(str, files))}: expected answers, found none.")
    pairs = [key.pairs[number - 1] for _, number in found]
    right = np.array([pair.sides[_SIDES.index(side)] == key.right for pair, side in zip(pairs, found.values())])
    groups = {"everybody": np.ones(len(right), dtype=bool)}
    judges = np.array([judge for judge, _ in found])
    groups |= {judge: judges == judge for judge in sorted(set(judges))} if len(set(judges)) > 1 else {}
    layouts = np.array([pair.dataset for pair in pairs])
    groups |= {layout: layouts == layout for layout in sorted(set(layouts))} if len(set(layouts)) > 1 else {}
    rows = []
    for name, chosen in groups.items():
        some = [pair for pair, kept in zip(pairs, chosen, strict=True) if kept]
        recordings = [f"{pair.dataset}/{pair.recording_id}" for pair in some]
        share = rate_interval(clustered(right[chosen].astype(float), recordings, [pair.sequence_id for pair in some]))
        counts = {"sequences": share.n_sequences, "recordings": share.n_recordings}
        cell = metric_cell("right", "rate", share.mean, share.low, share.high, variant=name, **counts)
        rows.append(Row(text={"of": name, "answers": str(len(some))}, cells=(cell,)))
    left = np.mean([side == "A" for side in found.values()])
    notes = (
        "50 % is chance: an interval that holds it means that nobody can tell. Intervals are over recordings.",
        f"{len(set(map(id, pairs)))} of {len(key.pairs)} pairs were answered; {100 * left:.0f} % chose the left side.",
    )
    columns = (Column(key="of", title="of", text=True), Column(key="answers", title="answers"))
    columns += (Column(key="right", title="right", unit="%", digits=1),)
    title = f"{key.question} Answers that name {key.right}"
    return Table(title=title, columns=columns, blocks=(Block(rows=tuple(rows)),), notes=notes)
