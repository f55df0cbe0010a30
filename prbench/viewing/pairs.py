"""Blind pairs: a page on which people say which of two motions is the recorded one, and what their answers say.

The page (``pairs.html`` beside this file) loads nothing and does not know the key, which stands in a file of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import structured
from prbench.files.storage import read_json, sole_writer, text_digest, write_json, write_text
from prbench.harness.intervals import clustered, rate_interval
from prbench.randomness import named_generator
from prbench.tables import Block, Column, Row, Table, metric_cell
from prbench.viewing.player.document import PlayerMotion, encoded, player_sequence
from prbench.viewing.player.page import filled, player_assets
from prbench.viewing.replay.scene import METHOD_COLOURS, Scene

PAGE = "pairs.html"
KEY = "key.json"
_SIDES = ("A", "B")


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


class PairAnswers(msgspec.Struct, frozen=True, kw_only=True):
    """The file that the page saves.

    Attributes:
        answers: The chosen side by number of the pair, from 1 on.
    """

    page: str
    judge: str
    answers: dict[str, Literal["A", "B"]]


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
        told = player_sequence(replace(scene, sequence_id=f"pair {number}", dataset="", notice=""))
        motions = told.motions[::-1] if flip else told.motions
        # Nothing but bodies: the player would tell scores, slides and gaze, too.
        bodies = [
            PlayerMotion(label=side, kind="method", colour=colour, joints=motion.joints, head_ray=motion.head_ray)
            for motion, side, colour in zip(motions, _SIDES, METHOD_COLOURS)
        ]
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
        InputFileError: if there is none, or it holds something else.
    """
    path = folder / KEY
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
        InputFileError: if a file holds no answers, those to another page, or two answers of a person to a pair.
    """
    key = read_key(folder)
    numbered = {str(number): pair for number, pair in enumerate(key.pairs, 1)}
    found: dict[tuple[str, str], str] = {}
    for path in files:
        given = structured(path, read_json(path), PairAnswers, remedy="Name the file that the page has saved.")
        if given.page != key.page:
            raise InputFileError(path, "page", expected=f"answers to the page of {folder}", found="those to another")
        for number, side in given.answers.items():
            expected = f"one answer of {given.judge!r} to each pair from 1 to {len(numbered)}"
            if number not in numbered or found.setdefault((given.judge, number), side) != side:
                raise InputFileError(path, f"answers.{number}", expected=expected, found=f"another: {side}")
    if not found:
        raise UsageError(f"{', '.join(map(str, files))}: expected answers, found none.")
    pairs = [numbered[number] for _, number in found]
    sides = list(found.values())
    right = np.array([float(pair.sides[_SIDES.index(side)] == key.right) for pair, side in zip(pairs, sides)])
    groups: dict[str, list[int]] = {"everybody": []}
    for place, ((judge, _), pair) in enumerate(zip(found, pairs, strict=True)):
        for name in ("everybody", f"by {judge}", f"of {pair.dataset}"):
            groups.setdefault(name, []).append(place)
    rows = []
    for name, places in groups.items():
        some = [pairs[place] for place in places]
        recordings = [f"{pair.dataset}/{pair.recording_id}" for pair in some]
        share = rate_interval(clustered(right[places], recordings, [pair.sequence_id for pair in some]))
        about = {"variant": name, "sequences": share.n_sequences, "recordings": share.n_recordings}
        cell = metric_cell("right", "rate", share.mean, share.low, share.high, **about)
        rows.append(Row(text={"answers": f"{len(some)} {name}"}, cells=(cell,)))
    seen = len({number for _, number in found})
    notes = (f"50 % is chance. {seen} of {len(numbered)} pairs were answered. Intervals are over recordings.",)
    columns = (Column(key="answers", title="answers", text=True), Column(key="right", title="right", unit="%"))
    title = f"{key.question} Answers that name {key.right}"
    return Table(title=title, columns=columns, blocks=(Block(rows=tuple(rows)),), notes=notes)
