"""Serve an installed method over the wire protocol: what ``--isolate`` starts in place of calling it.

``python -m prbench.methods.worker NAME [--train FOLDER --fit FOLDER]`` reads requests from stdin and answers on
stdout (docs/wire-protocol.md). What the method or its libraries print goes to stderr.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from prbench.contract import Adapter, Condition, ConditionBatch, Motions, Trainable, TrainingRun
from prbench.engine import is_out_of_memory
from prbench.errors import PrbenchError
from prbench.methods.adapters import load_adapter, used_weights, weights_digest
from prbench.methods.declared import Declared
from prbench.methods.motions import own_copy, release_memory, told, well_formed
from prbench.methods.remote.messages import (
    WIRE_VERSION,
    Header,
    batch_of,
    motions_payload,
    read_message,
    write_message,
)
from prbench.methods.training_split import FIT_SEED, TrainingCopy
from prbench.methods.users_environment import computing_threads


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one method until stdin ends.

    Returns:
        0 when the harness has closed stdin; 1 if the method could not be made.
    """
    parser = argparse.ArgumentParser(prog="python -m prbench.methods.worker", description=__doc__)
    parser.add_argument("name", help="of an installed method")
    parser.add_argument("--train", type=Path, help="copy of the training rows to fit the method to")
    parser.add_argument("--fit", type=Path, help="folder of the fit")
    asked = parser.parse_args(arguments)
    requests, answers = _take_streams()
    hello = read_message(requests)
    if hello is None:
        return 0
    settings = hello[0]
    try:
        adapter = load_adapter(asked.name, _path(settings["weights"]), settings["options"], settings["device"])
        if asked.train is not None and isinstance(adapter, Trainable):
            run = TrainingRun(folder=asked.fit, seed=FIT_SEED, device=settings["device"])
            adapter.fit(TrainingCopy.open(asked.train), validation=None, run=run)
        introduction = _introduction(asked.name, adapter, _path(settings["weights"]))
    except (Exception, SystemExit) as error:
        write_message(answers, {"message": "error", "text": _reason(error)})
        return 1
    write_message(answers, introduction)
    _serve(asked.name, adapter, settings["threads"], requests, answers)
    return 0


def _take_streams() -> tuple[BinaryIO, BinaryIO]:
    """Keep stdin and stdout for the protocol; whatever else reads finds nothing, and prints appear on stderr."""
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    # A method that reads stdin would take bytes of the protocol.
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return requests, answers


def _introduction(name: str, adapter: Adapter, given: Path | None) -> Header:
    declared = Declared.by(adapter, origin=f"adapter '{name}'")
    weights = {}
    for condition in sorted(declared.conditions):
        used = _weights(name, adapter, condition, given)
        if used is not None:
            weights[condition.value] = {"name": used.name, "sha256": weights_digest(used)}
    return {
        "message": "hello",
        "wire": WIRE_VERSION,
        "name": name,
        "version": str(getattr(adapter, "version", "installed")),
        "conditions": sorted(condition.value for condition in declared.conditions),
        "max_frames": declared.max_frames,
        "native_fps": declared.native_fps,
        "motionless": declared.motionless,
        "gaze": declared.gaze,
        "weights": weights,
        "trainable": isinstance(adapter, Trainable),
    }


def _weights(name: str, adapter: Adapter, condition: Condition, given: Path | None) -> Path | None:
    """Return the weights used under a condition; None where the method has none."""
    try:
        used = used_weights(adapter, condition, given, origin=f"adapter '{name}'")
    except PrbenchError:
        return None
    return used if used is not None and used.exists() else None


def _serve(name: str, adapter: Adapter, threads: int, requests: BinaryIO, answers: BinaryIO) -> None:
    while (message := read_message(requests)) is not None:
        header, payload = message
        assert payload is not None
        answer, motions = _answered(name, adapter, threads, header, batch_of(header, payload))
        write_message(answers, {**answer, "batch": header["batch"]}, motions)


def _answered(
    name: str, adapter: Adapter, threads: int, header: Header, batch: ConditionBatch
) -> tuple[Header, bytes | None]:
    try:
        with computing_threads(threads):
            motions = adapter.generate(own_copy(batch), seed=header["seed"])
        motions = well_formed(motions, batch, method=name, sequence_ids=batch.opaque_id, farthest=math.inf)
    except (Exception, SystemExit) as error:
        if not is_out_of_memory(error):
            return {"message": "error", "text": _reason(error)}, None
        release_memory()
        return {"message": "error", "text": "out of memory", "out_of_memory": True}, None
    return _sent(motions, batch)


def _sent(motions: Motions, batch: ConditionBatch) -> tuple[Header, bytes]:
    passes = {} if motions.cost is None else {"network_passes": motions.cost.network_passes}
    return {"message": "motions", **passes}, motions_payload(batch.opaque_id, motions)


def _reason(error: BaseException) -> str:
    return str(error) if isinstance(error, PrbenchError) else told(error)


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


if __name__ == "__main__":
    os.environ.pop("PYTHONPATH", None)  # prbench's own; what the method starts finds its modules by itself
    sys.exit(main())
