"""Serve an installed method over the wire protocol: what ``--isolate`` starts in place of calling it.

``python -m prbench.harness.methods.worker NAME [--benchmark NAME] [--train FOLDER --fit FOLDER]`` reads requests from
stdin and answers on stdout (docs/wire-protocol.md). What the method or its libraries print goes to stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prbench.contract import TrainingRun
from prbench.engine import is_out_of_memory
from prbench.errors import PrbenchError
from prbench.harness.methods import messages, motions, process, remote
from prbench.harness.methods.loading import load_adapter, used_weights, weights_digest
from prbench.harness.methods.training_split import FIT_SEED
from prbench.protocol.manifests import default_benchmark


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one method until stdin ends.

    Returns:
        0 when the harness has closed stdin; 1 if the method could not be made.
    """
    parser = argparse.ArgumentParser(prog="python -m prbench.harness.methods.worker", description=__doc__)
    parser.add_argument("name", help="of an installed method")
    parser.add_argument("--benchmark", default=default_benchmark().name, help="that it is a method of")
    parser.add_argument("--train", type=Path, help="copy of what it may learn from, to fit it to")
    parser.add_argument("--fit", type=Path, help="folder of the fit, if one is kept")
    asked = parser.parse_args(arguments)
    # Keep stdin and stdout for the protocol; whatever else reads finds nothing, and prints appear on stderr.
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    # A method that reads stdin would take bytes of the protocol.
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    hello = messages.read_message(requests)
    if hello is None:
        return 0
    settings = hello[0]

    def failed(error: BaseException) -> dict[str, Any]:
        return {"message": "error", "text": str(error) if isinstance(error, PrbenchError) else motions.told(error)}

    try:
        group = remote.group_of(asked.benchmark)
        weights = None if settings["weights"] is None else Path(settings["weights"])
        adapter = load_adapter(asked.name, weights, settings["options"], settings["device"], group=group)
        if asked.train is not None and group.fit is not None:
            group.fit(adapter, asked.train, TrainingRun(folder=asked.fit, seed=FIT_SEED, device=settings["device"]))
        introduction = _introduction(asked.name, adapter, weights, group)
    except (Exception, SystemExit) as error:
        messages.write_message(answers, failed(error))
        return 1
    messages.write_message(answers, introduction)
    while (message := messages.read_message(requests)) is not None:
        header, payload = message
        assert payload is not None
        sent = None
        try:
            with process.computing_threads(settings["threads"]):
                answer, sent = group.serve(asked.name, adapter, header, payload)
        except (Exception, SystemExit) as error:
            answer = failed(error)
            if is_out_of_memory(error):
                answer = {"message": "error", "text": "out of memory", "out_of_memory": True}
        if "out_of_memory" in answer:  # outside of the handler, whose traceback would hold the tensors
            motions.release_memory()
        messages.write_message(answers, {**answer, "batch": header["batch"]}, sent)
    return 0


def _introduction(name: str, adapter: Any, given: Path | None, group: remote.MethodGroup) -> messages.Header:
    declared = motions.Declared.by(adapter, origin=f"adapter '{name}'", conditions=group.conditions)
    weights = {}
    for condition in sorted(declared.conditions):
        used = None
        with contextlib.suppress(PrbenchError):  # the method has none for it
            used = used_weights(adapter, condition, given, origin=f"adapter '{name}'")
        if used is not None and used.exists():
            weights[condition.value] = {"name": used.name, "sha256": weights_digest(used)}
    same = ("max_frames", "native_fps", "motionless", "gaze", "one_design")
    return {
        "message": "hello",
        "wire": messages.WIRE_VERSION,
        "name": name,
        "version": str(getattr(adapter, "version", "installed")),
        "conditions": sorted(condition.value for condition in declared.conditions),
        **{name: getattr(declared, name) for name in same},
        "weights": weights,
        "trainable": hasattr(adapter, "fit"),
    }


if __name__ == "__main__":
    os.environ.pop("PYTHONPATH", None)  # prbench's own; what the method starts finds its modules by itself
    sys.exit(main())
