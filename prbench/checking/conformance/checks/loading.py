"""Checks that a method loads cheaply, declares what the harness needs, and refuses unknown settings."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from prbench.checking.conformance.check import check
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import Observation, Remedy, failed, passed, skipped, warning
from prbench.errors import PrbenchError
from prbench.harness.methods.installed import import_python_method, is_python_method
from prbench.harness.methods.loading import find_adapter, used_weights, weights_digest

_IMPORT_WARNING = 1.0
"""Seconds that importing the module of an entry point should stay below."""
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
def imports(subject: MethodSubject) -> Iterator[Observation]:
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
def load(subject: MethodSubject) -> Iterator[Observation]:
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
        yield warning(
            f"it calls itself '{name}' but is installed as '{subject.spec.name}'.",
            "Use one name in both places, so that messages and tables speak of the same method.",
        )
    taken = ", ".join(condition.value for condition in conditions)
    yield passed(f"takes {taken}; {subject.limits}; ready after {seconds:.2f} s.", load_s=seconds)


@check("settings", "unknown options and weights are refused", needs=("load",))
def settings(subject: MethodSubject) -> Iterator[Observation]:
    """Require that unknown options are refused, since a misspelt one would change nothing and be recorded."""
    options = (*subject.spec.options, (_NO_SUCH_OPTION, "1"))
    if _loads(subject, options=tuple(sorted(options))):
        yield failed(
            f"--option {_NO_SUCH_OPTION}=1 was taken without a word.",
            _OPTIONS.then("a misspelt option would be recorded as if it had been used."),
        )
        return
    if _loads(subject, weights=_NO_SUCH_WEIGHTS):
        yield warning(
            f"--weights {_NO_SUCH_WEIGHTS} was taken without a word.",
            _WEIGHTS,
        )
        return
    yield passed("refuses an unknown option and unknown weights.")


@check("weights", "the weights that it names are there", needs=("load",))
def weights(subject: MethodSubject) -> Iterator[Observation]:
    """Ask ``weights_for`` twice for each condition."""
    if subject.is_program:
        yield _named_by_program(subject)
        return
    if not callable(getattr(subject.adapter, "weights_for", None)):
        yield skipped("it has no weights_for(); a run records the path that its user gives.")
        return
    named: dict[str, str] = {}
    for condition in subject.conditions:
        try:
            first, second = (
                used_weights(subject.adapter, condition, subject.spec.weights, origin=subject.origin) for _ in range(2)
            )
            digest = weights_digest(first)
        except PrbenchError as error:
            yield failed(
                f"weights_for({condition.value}): {error}",
                "Return the path of an existing file or folder as pathlib.Path, or None if this condition uses none.",
            )
            return
        except Exception as error:
            yield failed(
                f"weights_for({condition.value}) raised {type(error).__name__}: {error}",
                "Answer for every condition that you declare; a run asks before it generates.",
            )
            return
        if first != second:
            yield failed(
                f"weights_for({condition.value}) named {first} and then {second}.", "Name the same file every time."
            )
            return
        named[condition.value] = f"{first.name} ({digest[:12]})" if first is not None and digest else "none"
    yield passed("; ".join(f"{condition}: {name}" for condition, name in named.items()) + ".")


def _named_by_program(subject: MethodSubject) -> Observation:
    """Report the weights of a program's hello, whose form the handshake has checked."""
    named = getattr(subject.adapter, "weights", {})
    if not named:
        return skipped("its hello names no weights; a run records the path that its user gives.")
    return passed(
        "; ".join(f"{key.value}: {named[key].name} ({named[key].sha256[:12]})" for key in sorted(named)) + "."
    )


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


CHECKS = (imports, load, settings, weights)
