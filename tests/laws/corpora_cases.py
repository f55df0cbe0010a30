"""Text-motion corpora: built from trees, and files that break a promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.engine.pool import ProcessPool
from prbench_adapters.corpora.build import build_corpus
from prbench_adapters.corpora.humanml3d.files import read_joints, read_texts
from prbench_adapters.corpora.nymeria.clock import offset_from_file
from prbench_adapters.corpora.nymeria.files import find_sequences, read_narrations
from prbench_adapters.corpora.nymeria.suit import read_suit
from tests.adapters.corpora.suits import corpus_tree, walking_suit, write_arrays
from tests.fakes import smooth_motion
from tests.laws.cases import BadInput, SameBytes, bad_files

_HEADER = "request_id,gaia_id,start_time,end_time,annotator,creation_time,Describe my activity\n"
_NARRATIONS = {
    "no start": ("gaia_id,end_time,Describe my activity\n", ["a column 'start_time'"]),
    "no answers": ("start_time,end_time,activity\n1,2,x\n", ["begins with 'Describe my'"]),
    "a word for a time": (f"{_HEADER}1,2,three,4,a,x,text\n", ["row 2", "'three'"]),
    "a time that is not finite": (f"{_HEADER}1,2,nan,4,a,x,text\n", ["row 2", "'nan'"]),
    "a row that is cut": (f"{_HEADER}1,2,3,4,a\n", ["row 2", "7 cells, found 5"]),
    "milliseconds": (f"{_HEADER}1,2,3000,6000,a,x,t\n1,2,9000,12500,a,x,t\n", ["milliseconds"]),
    "other bytes than UTF-8": (b"start_time,end_time,Describe my activity\n1,2,\xff\xfe\n", ["UTF-8"]),
}
_TEXTS = {
    "a line without parts": ("only text", ["line 1"]),
    "a word for a time": ("a#b#c#d", ["a time"]),
    "an infinite time": ("a#b#0#inf", ["finite"]),
}
_OFFSETS = {"a word for an offset": ('{"one": 1.5, "two": "soon"}', ["two"]), "a list": ("[1]", ["sequence: seconds"])}
_SUITS = {
    "no times": ({"timestamps_us": None}, ["timestamps_us"]),
    "another rate": ({"frameRate": np.array([60])}, ["frameRate: expected 240"]),
    "another count": ({"frameCount": np.array([599])}, ["frameCount: expected 600"]),
    "fewer positions": ({"segment_tXYZ": np.zeros((599, 69))}, ["for the 600 times"]),
    "rotations of three numbers": ({"segment_qWXYZ": np.zeros((600, 69))}, ["(600, 92)"]),
    "whole numbers": ({"segment_tXYZ": np.zeros((600, 69), dtype=int)}, ["int64"]),
    "times that are not finite": ({"timestamps_us": np.full(600, np.nan)}, ["finite times"]),
    "Python objects": ({"timestamps_us": np.array([{"a": 1}], object)}, ["numbers or text, found Python objects"]),
}
_JOINTS = {
    "21 joints": (np.zeros((5, 21, 3)), ["22, 3"]),
    "millimetres": (smooth_motion("a", 5) * 1000, ["metres"]),
    "no body": (np.zeros((5, 22, 3)), ["a body"]),
    "NaN": (np.where(np.arange(5)[:, None, None] == 3, np.nan, smooth_motion("a", 5)), ["frame 3"]),
}


def _written(content: str | bytes):
    return lambda path: path.write_bytes(content if isinstance(content, bytes) else content.encode())


def _text_file(name: str, good: str):
    return lambda folder: (folder / name).write_text(good) and folder / name


def _suit(folder: Path) -> Path:
    return write_arrays(folder / "xdata.npz", walking_suit(600))


def _array(folder: Path) -> Path:
    np.save(folder / "j.npy", smooth_motion("a", 5))
    return folder / "j.npy"


def _built(layout: str, **how):
    return lambda folder: build_corpus(layout, corpus_tree(layout), folder / "corpus", **how) and None


SAME_BYTES = [
    SameBytes(
        f"a corpus of {layout}",
        {"in one process": _built(layout), "by two workers": _built(layout, engine=ProcessPool(2))},
    )
    for layout in ("nymeria", "humanml3d")
]
BAD_INPUT = [
    *bad_files(
        "narrations",
        _text_file("atomic_action.csv", f"{_HEADER}1,2,3,4,a,x,text\n"),
        lambda path: read_narrations(path, "atomic_action"),
        {name: (_written(text), told) for name, (text, told) in _NARRATIONS.items()},
    ),
    *bad_files(
        "texts of HumanML3D",
        _text_file("t.txt", "a#b/X#0.0#0.0\n"),
        read_texts,
        {name: (_written(text), told) for name, (text, told) in _TEXTS.items()},
    ),
    *bad_files(
        "time_offset.json",
        _text_file("time_offset.json", '{"two": 1.5}'),
        lambda path: offset_from_file(path, "two"),
        {name: (_written(text), told) for name, (text, told) in _OFFSETS.items()},
    ),
    *bad_files(
        "xdata.npz",
        _suit,
        read_suit,
        {
            name: (lambda path, changed=changed: write_arrays(path, walking_suit(600), **changed), told)
            for name, (changed, told) in _SUITS.items()
        },
    ),
    *bad_files(
        "joints of HumanML3D",
        _array,
        read_joints,
        {name: (lambda path, array=array: np.save(path, array), told) for name, (array, told) in _JOINTS.items()},
    ),
    BadInput("a folder without sequences of Nymeria", find_sequences, ("sequence folders",)),
]
