"""Blind pairs: a page on which people choose between two sides, such as motion and recording, and what they chose.

The page (``pairs.html`` beside this file) loads nothing and does not know the key, which stands in a file of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import structured
from prbench.files.storage import read_json, sole_writer, text_digest, write_json, write_text
from prbench.harness.intervals import clustered, rate_interval
from prbench.protocol.manifests import PROTOCOL_NAME
from prbench.randomness import named_generator
from prbench.tables import Block, Column, Row, Table, metric_cell
from prbench.viewing.player.document import PlayerMotion, encoded, player_sequence
from prbench.viewing.player.page import filled, player_assets
from prbench.viewing.replay.scene import METHOD_COLOURS, Scene

PAGE = "pairs.html"
KEY = "key.json"
SIDES = ("A", "B")


class Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What people are asked of each pair.

    Attributes:
        name: One word, which is the title of its column.
        text: The question.
        beside_recorded: What was recorded is shown beside the pair, where the pair has it.
    """

    name: str
    text: str
    beside_recorded: bool = False


@dataclass(frozen=True, eq=False)
class BlindPair:
    """Two sides that people choose between.

    Attributes:
        labels: Whose they are.
        document: Returns what the page is told, which :func:`encoded` can write, of a pair with this name and these
            sides left and right: ``(0, 1)``, or ``(1, 0)``.
        notice: Sentence that the dataset's terms ask for; empty where they ask for none.
    """

    sequence_id: str
    dataset: str
    recording_id: str
    labels: tuple[str, str]
    document: Callable[[str, tuple[int, int]], Any]
    notice: str = ""

    @classmethod
    def of(cls, scene: Scene) -> BlindPair:
        """Return a sequence with two motions: nothing but bodies, since the player would tell scores and gaze, too."""

        def document(name: str, order: tuple[int, int]) -> Any:
            told = player_sequence(replace(scene, sequence_id=name, dataset="", notice=""))
            bodies = []
            for place, side, colour in zip(order, SIDES, METHOD_COLOURS):
                shown = {field: getattr(told.motions[place], field) for field in ("joints", "head_ray")}
                bodies.append(PlayerMotion(label=side, kind="method", colour=colour, **shown))
            return msgspec.structs.replace(told, motions=bodies)

        about = {name: getattr(scene, name) for name in ("sequence_id", "dataset", "recording_id", "notice")}
        first, second = (motion.label for motion in scene.motions)
        return cls(labels=(first, second), document=document, **about)


class KeptPair(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one pair has shown.

    Attributes:
        sides: Who stood left (A) and who right (B).
    """

    sequence_id: str
    dataset: str
    recording_id: str
    sides: tuple[str, str]


class PairsKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The key of a page of pairs.

    Attributes:
        page: Digest of what the page shows, which stands in each file of answers.
        benchmark: Name of the benchmark whose runs are shown.
        questions: What people are asked of each pair.
        counted: Labels whose share of the answers is told: that of the right answer, or those of both sides.
        pairs: The pairs in the order of the page.
    """

    page: str
    benchmark: str
    questions: tuple[Question, ...]
    counted: tuple[str, ...]
    seed: int
    pairs: tuple[KeptPair, ...]

    @property
    def numbered(self) -> dict[str, tuple[KeptPair, Question]]:
        """Pair and question by the number that they have in files of answers, from 1 on."""
        asked = itertools.product(self.pairs, self.questions)
        return {str(number): each for number, each in enumerate(asked, 1)}


class PairAnswers(msgspec.Struct, frozen=True, kw_only=True):
    """The file that the page saves.

    Attributes:
        answers: The chosen side by number: of each pair the questions in their order, from 1 on.
    """

    page: str
    judge: str
    answers: dict[str, Literal["A", "B"]]


def write_pairs(
    shown: Sequence[BlindPair],
    folder: Path,
    *,
    questions: Sequence[Question],
    counted: tuple[str, ...],
    seed: int,
    benchmark: str = PROTOCOL_NAME,
) -> PairsKey:
    """Write the page of some pairs, and its key.

    Args:
        shown: The pairs; neither their order nor that of their sides leaves a trace.
        folder: Gets ``pairs.html`` and ``key.json``; a page of the same pairs in it is written again.
        questions: What people are asked of each.
        counted: See :class:`PairsKey`.
        seed: Decides the order of the pairs and the sides; of each two labels as many stand left as right.
        benchmark: See :class:`PairsKey`.

    Raises:
        UsageError: if the folder holds the key of another page, whose answers it would make worthless.
        StorageError: if a file cannot be written.
    """
    generator = named_generator("blind pairs", seed)
    flipped = generator.permutation(np.arange(len(shown)) % 2)
    documents = []
    pairs = []
    for number, (place, flip) in enumerate(zip(generator.permutation(len(shown)), flipped, strict=True), 1):
        pair = shown[place]
        order = (1, 0) if flip else (0, 1)
        documents.append(encoded(pair.document(f"pair {number}", order)).decode())
        about = {name: getattr(pair, name) for name in ("sequence_id", "dataset", "recording_id")}
        pairs.append(KeptPair(sides=(pair.labels[order[0]], pair.labels[order[1]]), **about))
    page = text_digest(*(question.text for question in questions), *documents)
    about = {"benchmark": benchmark, "questions": tuple(questions), "counted": counted, "seed": seed}
    key = PairsKey(page=page, pairs=tuple(pairs), **about)
    notice = " ".join(dict.fromkeys(pair.notice for pair in shown if pair.notice))
    parts = {"STYLE": player_assets().style}
    parts["DATA"] = encoded({"page": page, "questions": questions, "notice": notice}).decode()
    parts["PAIRS"] = "\n".join(f'<script type="application/json" class="pair">{each}</script>' for each in documents)
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
    """Count whom people have chosen.

    Args:
        folder: Holds the key.
        files: Answers that the page has saved, one or more a person.

    Returns:
        A row for each counted label by everybody, each person and of each dataset, and a column for each question: the
        label's share of the answers in %, of which half is chance, with its interval over recordings.

    Raises:
        InputFileError: if a file holds no answers, those to another page, or two answers of a person to a question.
    """
    key = read_key(folder)
    numbered = key.numbered
    found: dict[tuple[str, str], str] = {}
    for path in files:
        given = structured(path, read_json(path), PairAnswers, remedy="Name the file that the page has saved.")
        if given.page != key.page:
            raise InputFileError(path, "page", expected=f"answers to the page of {folder}", found="those to another")
        for number, side in given.answers.items():
            expected = f"one answer of {given.judge!r} to each number from 1 to {len(numbered)}"
            if number not in numbered or found.setdefault((given.judge, number), side) != side:
                raise InputFileError(path, f"answers.{number}", expected=expected, found=f"another: {side}")
    if not found:
        raise UsageError(f"{', '.join(map(str, files))}: expected answers, found none.")
    # Pair and chosen label of each answer, by group and question.
    groups: dict[str, dict[str, list[tuple[KeptPair, str]]]] = {"everybody": {}}
    for (judge, number), side in found.items():
        pair, question = numbered[number]
        for name in ("everybody", f"by {judge}", f"of {pair.dataset}"):
            answer = (pair, pair.sides[SIDES.index(side)])
            groups.setdefault(name, {}).setdefault(question.name, []).append(answer)
    rows = []
    for (name, asked), label in itertools.product(groups.items(), key.counted):
        cells = []
        for question, answers in asked.items():
            chosen = np.array([float(answer == label) for _, answer in answers])
            recordings = [f"{pair.dataset}/{pair.recording_id}" for pair, _ in answers]
            share = rate_interval(clustered(chosen, recordings, [f"{p.dataset}/{p.sequence_id}" for p, _ in answers]))
            about = {"variant": name, "sequences": share.n_sequences, "recordings": share.n_recordings}
            cells.append(metric_cell(question, "rate", share.mean, share.low, share.high, method=label, **about))
        given = f"{sum(map(len, asked.values()))} {name}"
        rows.append(Row(text={"answers": given, "chosen": label}, cells=tuple(cells)))
    seen = len({number for _, number in found})
    asked = "pairs" if len(key.questions) == 1 else "questions"
    notes = (f"50 % is chance. {seen} of {len(numbered)} {asked} were answered. Intervals are over recordings.",)
    heads = {"answers": "answers"} if len(key.counted) == 1 else {"answers": "answers", "chosen": "chosen"}
    columns = [Column(key=name, title=title, text=True) for name, title in heads.items()]
    columns += [Column(key=question.name, title=question.name, unit="%") for question in key.questions]
    title = " ".join(question.text for question in key.questions)
    title += f" Answers that name {' or '.join(key.counted)}"
    return Table(title=title, columns=tuple(columns), blocks=(Block(rows=tuple(rows)),), notes=notes)
