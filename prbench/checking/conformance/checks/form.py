"""Checks that a method loads cheaply, declares what the harness needs, and answers in the form that was asked for."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from prbench.checking.conformance.findings import Finding, Remedy, check, failed, passed, skipped, warning
from prbench.checking.conformance.subject import Answer, MethodSubject, Subject, program_misshaped
from prbench.errors import PrbenchError
from prbench.harness.methods.installed import import_python_method, is_python_method
from prbench.harness.methods.loading import find_adapter, used_weights, weights_digest

_IMPORT_WARNING = 1.0  # seconds that importing the module of an entry point should stay below
_HEAVY = ("torch", "tensorflow", "jax", "transformers", "pytorch_lightning", "lightning")
_NO_SUCH_OPTION = "prbench-no-such-option"
_NO_SUCH_WEIGHTS = Path("prbench-no-such-weights")
_NAME = Remedy(
    "Set name to the word that users type behind --method.", "Put the name of the method under 'name' into the hello."
)
_ANSWER = 'Answer the hello with {"message": "error", "text": "…"}'
_OPTIONS = Remedy(
    "Raise ValueError in load() for keys that you do not know:", f"{_ANSWER} to options that you do not know:"
)
_WEIGHTS = Remedy(
    "Raise ValueError in load() for weights that you cannot find, or if the method has none.",
    f"{_ANSWER} to weights that you cannot find, or if the method has none.",
)
_LATE = "Import heavy packages and open weights inside load() or generate(), not at the top of the module."


@check("import", "importing its module is cheap")
def imports(subject: MethodSubject) -> Iterator[Finding]:
    """Measure the seconds, and name heavy packages that are imported with it."""
    if not subject.is_installed:
        yield skipped("a program imports nothing into the harness.")
        return
    method = subject.spec.name
    target = find_adapter(method, entry_points=subject.spec.group.entry_points).target.rpartition(":")[0]
    subject.starting(f"while importing {target}")
    # What prbench itself has imported already is not the method's doing.
    before = set(sys.modules)
    started = time.perf_counter()
    try:
        if is_python_method(method):
            import_python_method(method)
        else:
            importlib.import_module(target)
    except (Exception, SystemExit):  # told by 'load', in the words that a run would use
        yield skipped("it cannot be imported; see 'load'.")
        return
    seconds = time.perf_counter() - started
    heavy = [name for name in _HEAVY if name in sys.modules and name not in before]
    if heavy or seconds > _IMPORT_WARNING:
        along = f" and brings {', '.join(heavy)} along" if heavy else ""
        yield warning(f"importing {target} takes {seconds:.2f} s{along}.", _LATE, import_s=seconds)
    else:
        yield passed(f"importing {target} takes {seconds:.2f} s.", import_s=seconds)


@check("load", "it loads and declares what the harness needs")
def load(subject: MethodSubject) -> Iterator[Finding]:
    """Load it as a run does, fit it if it learns, and read its attributes."""
    subject.starting("while starting its program" if subject.is_program else "while loading it")
    started = time.perf_counter()
    try:
        conditions = subject.conditions
        name = subject.adapter.name
    except PrbenchError as error:
        yield failed(str(error), "Nothing else can be looked at before this is repaired.")
        return
    seconds = time.perf_counter() - started
    if not isinstance(name, str) or not name:
        yield failed(f"its attribute 'name' is {name!r}.", _NAME)
        return
    if subject.is_installed and name != subject.spec.name and not is_python_method(subject.spec.name):
        remedy = "Use one name in both places, so that messages and tables speak of the same method."
        yield warning(f"it calls itself '{name}' but is installed as '{subject.spec.name}'.", remedy)
    taken = ", ".join(condition.value for condition in conditions)
    yield passed(f"takes {taken}; ready after {seconds:.2f} s.", load_s=seconds)


@check("settings", "unknown options and weights are refused", needs=("load",))
def settings(subject: MethodSubject) -> Iterator[Finding]:
    """Require that unknown options are refused, since a misspelt one would change nothing and be recorded."""
    if _loads(subject, options=tuple(sorted((*subject.spec.options, (_NO_SUCH_OPTION, "1"))))):
        remedy = _OPTIONS.then("a misspelt option would be recorded as if it had been used.")
        yield failed(f"--option {_NO_SUCH_OPTION}=1 was taken without a word.", remedy)
    elif _loads(subject, weights=_NO_SUCH_WEIGHTS):
        yield warning(f"--weights {_NO_SUCH_WEIGHTS} was taken without a word.", _WEIGHTS)
    else:
        yield passed("refuses an unknown option and unknown weights.")


@check("weights", "the weights that it names are there", needs=("load",))
def weights(subject: MethodSubject) -> Iterator[Finding]:
    """Ask ``weights_for`` twice for each condition."""
    named = {}
    if subject.is_program:
        # The handshake has checked the form of the hello, which names the weights of a program.
        stated = getattr(subject.adapter, "weights", {})
        named = {key.value: f"{each.name} ({each.sha256[:12]})" for key, each in stated.items()}
    elif callable(getattr(subject.adapter, "weights_for", None)):
        for condition in subject.conditions:
            try:
                asked = (subject.adapter, condition, subject.spec.weights)
                first, second = (used_weights(*asked, origin=subject.origin) for _ in range(2))
                digest = weights_digest(first)
            except Exception as error:  # the method's own code
                said = str(error) if isinstance(error, PrbenchError) else f"raised {type(error).__name__}: {error}"
                remedy = "For every condition that you declare, return the path of an existing file or folder as"
                remedy += " pathlib.Path, or None if it uses none; a run asks before it generates."
                yield failed(f"weights_for({condition.value}): {said}", remedy)
                return
            if first != second:
                said = f"weights_for({condition.value}) named {first} and then {second}."
                yield failed(said, "Name the same file every time.")
                return
            named[condition.value] = f"{first.name} ({digest[:12]})" if first is not None and digest else "none"
    if not named:
        yield skipped("it names no weights; a run records the path that its user gives.")
    else:
        yield passed("; ".join(f"{condition}: {name}" for condition, name in sorted(named.items())) + ".")


def _loads(subject: MethodSubject, **changed: object) -> bool:
    """Return True if the method can be loaded with other settings."""
    spec = replace(subject.spec, fit_folder=None, table_folder=None, fit=None, **changed)  # type: ignore[arg-type]
    try:
        spec.load()
    except (PrbenchError, OSError):
        return False
    finally:
        subject.load_again()
    return True


LOADING = (imports, load, settings, weights)


_GENERATE = Remedy(
    "Run generate() on this batch and repair what it raises; a method may only refuse options, weights and goals that"
    " nobody could reach.",
    "Repair what keeps the program from answering 'generate' with 'motions': its log (stderr) is shown with the error."
    " A program may only refuse options, weights and goals that nobody could reach.",
)
_DTYPE = Remedy("Return decimals: joints.astype(np.float32), in metres.", "Send joints as list<float>, in metres.")
_COARSE = Remedy(
    "Compute the last steps (the sum of velocities above all) in float32 and return float32.",
    "Compute the last steps (the sum of velocities above all) in 32 bits and send list<float>.",
)
_LIMIT = Remedy(
    "Raise max_frames (the protocol's sequences have 41 to 241 frames at 20 a second), or set it to None.",
    "Raise max_frames in the hello (the protocol's sequences have 41 to 241 frames at 20 a second), or leave it out.",
)
_FINITE = (
    "Look for a division by zero or by a length that can be zero (an empty step, a single frame) and for weights that"
    " hold NaN. Frames behind n_frames[i] may hold anything."
)


@check("generates", "it generates under every condition that it declares", needs=("load",))
def generates(subject: Subject) -> Iterator[Finding]:
    """Generate under each declared condition; none may raise."""
    # The method takes no sequence of the cases at all, so there is nothing to ask it.
    if not len(subject.source.n_frames):
        shortest = f"{int(subject.cases.source.n_frames.min())} frames at {subject.cases.source.fps:g} a second"
        limit = f"max_frames is {subject.declared.max_frames}"
        yield failed(f"{limit}, and the shortest of the sequences has {shortest}.", _LIMIT)
        return
    yield from answered_everywhere(subject, _GENERATE, said="one motion for each sequence")


def answered_everywhere(subject: MethodSubject, remedy: str, *, said: str) -> Iterator[Finding]:
    """Fail each condition under which a method raises, and a program that ended by itself."""
    answers = {condition: subject.standard(condition) for condition in subject.conditions}

    def is_missing(answer: Answer) -> bool:
        return not answer.answered and not program_misshaped(answer)

    yield from by_condition(subject, answers, is_missing, remedy, said=said)


@check("shapes", "motions have the asked shape and lengths", needs=("load",))
def shapes(subject: MethodSubject) -> Iterator[Finding]:
    """Compare shapes and lengths with those that were asked for."""
    yield from by_condition(subject, _answered(subject), subject.is_misshapen, subject.shape_remedy, said=subject.shape)


@check("dtype", "positions are decimals of enough digits", needs=("load",))
def dtype(subject: MethodSubject) -> Iterator[Finding]:
    """Require floating point, and warn of half precision."""
    answers = {name: answer for name, answer in _answered(subject).items() if not subject.is_misshapen(answer)}
    yield from by_condition(subject, answers, lambda answer: not _is_floating(answer), _DTYPE, said="floating point")
    if coarse := [name.value for name, answer in answers.items() if _dtype_of(answer) == np.dtype(np.float16)]:
        said = f"{', '.join(coarse)}: joints come as float16, whose steps are 1 mm at 2 m from the origin."
        yield warning(said, _COARSE)


@check("finite", "no position is NaN or infinite", needs=("load",))
def finite(subject: MethodSubject) -> Iterator[Finding]:
    """Require a finite number in every valid frame."""
    answers = {name: answer for name, answer in _answered(subject).items() if not subject.is_misshapen(answer)}
    answers = {name: answer for name, answer in answers.items() if _is_floating(answer)}

    def is_broken(answer: Answer) -> bool:
        return "expected finite positions" in answer.error

    yield from by_condition(subject, answers, is_broken, _FINITE, said="all positions are numbers")


def _answered(subject: MethodSubject) -> dict[Any, Answer]:
    if not subject.n_cases:
        return {}
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    return {condition: answer for condition, answer in answers.items() if answer.answered or program_misshaped(answer)}


def by_condition(
    subject: MethodSubject, answers: Mapping[Any, Answer], is_wrong: Callable[[Answer], bool], remedy: str, *, said: str
) -> Iterator[Finding]:
    """Fail each condition whose answer is wrong, and pass them together if none is."""
    wrong = {condition: answer for condition, answer in answers.items() if is_wrong(answer)}
    for condition, answer in wrong.items():
        yield failed(f"under {condition.value}: {answer.error}", remedy)
    if not answers:
        yield skipped(f"there are no {subject.things} to look at.")
    elif not wrong:
        yield passed(f"{said}, under {', '.join(condition.value for condition in answers)}.")


def _dtype_of(answer: Answer) -> np.dtype | None:
    joints = getattr(answer.returned, "joints", None)
    return joints.dtype if isinstance(joints, np.ndarray) else None


def _is_floating(answer: Answer) -> bool:
    found = _dtype_of(answer)
    return found is None or np.issubdtype(found, np.floating)


CHECKS = (generates, shapes, dtype, finite)
