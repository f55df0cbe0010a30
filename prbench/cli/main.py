"""``prbench``: find the command, run it, show its answer, and turn an error into one message and an exit code.

The answer of every command has one JSON envelope, which ``--json`` prints and ``--out`` writes.
"""

from __future__ import annotations

import io
import os
import sys
import tomllib
import traceback
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import click
import msgspec

import prbench
from prbench.cli import commands, places, terminal
from prbench.entry_points import COMMANDS
from prbench.errors import MemoryFullError, PrbenchError, UsageError
from prbench.shown import quoted

program = commands.Group(
    "prbench",
    plugins=COMMANDS,
    context_settings={"max_content_width": 100},
    **tomllib.loads(files("prbench.cli").joinpath("commands.toml").read_text(encoding="utf-8")),
)
click.version_option(prbench.__version__, message="prbench %(version)s")(program)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words of the command line; by default those that the shell gave.

    Returns:
        0 on success; else one of the exit codes in docs/exit-codes.md.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a console that lacks a character shows a substitute, not a traceback
            stream.reconfigure(errors="replace")
    if "_PRBENCH_COMPLETE" in os.environ:  # set by the shell's completion, which reads what is printed here
        program.main(prog_name="prbench")
    words = sys.argv[1:] if arguments is None else list(arguments)
    now = commands.Session(from_shell=arguments is None)
    with terminal.clean_output():
        try:
            with program.make_context("prbench", words, obj=now) as context:
                code = _present(program.invoke(context), now)
        except click.exceptions.Exit as end:  # --help and --version
            return end.exit_code
        except click.exceptions.NoArgsIsHelpError as missing:
            print(missing.format_message())
            return UsageError.exit_code
        except click.ClickException as error:
            # What the parser refused, and where the options are explained.
            context = getattr(error, "ctx", None)
            where = f" `{context.command_path} --help` lists what there is." if context is not None else ""
            code = _refuse(UsageError(f"{error.format_message()}{where}"), now, words)
        except PrbenchError as error:
            code = _refuse(error, now, words)
        except (KeyboardInterrupt, click.Abort):
            kept = "; finished parts are kept, the same command resumes" if now.resumes else ""
            print(f"prbench: interrupted{kept}.", file=sys.stderr)
            return 130
        except BrokenPipeError:
            sys.stderr.close()  # the reader of our output went away, as `| head` does
            return 0
        except Exception as error:
            refusal = _of_the_machine(error, now)
            if refusal is None:
                raise
            code = _refuse(refusal, now, words)
        return code


def _of_the_machine(error: Exception, now: commands.Session) -> PrbenchError | None:
    """Return the error for a full memory or disk, with the file that was worked on; None for any other."""
    from prbench.engine.pool import is_out_of_memory
    from prbench.files.bounded import file_of
    from prbench.files.storage import storage_error

    place = str(file_of(error) or f"prbench {now.command}")
    if is_out_of_memory(error):
        return MemoryFullError(place, f"the memory of this machine does not suffice ({quoted(error)})")
    return storage_error(error, place) if isinstance(error, OSError) else None


def _present(answer: Any, now: commands.Session) -> int:
    """Print what a command returned, and return its exit code."""
    if not isinstance(answer, commands.Answer):
        return int(answer or 0)
    if now.as_json or now.report_file is not None:
        document = document_of(answer, now)
        place = now.report_file
        if place is not None:  # saved first, then printed: a report that could not be written is a failure
            from prbench.files.storage import sole_writer, write_json

            content = msgspec.json.decode(_encoded(document))
            if isinstance(place, places.Remote):
                from prbench.object_stores.outputs import written_file

                with written_file(place.url) as copy:
                    write_json(copy, content)
            else:
                with sole_writer(place):
                    write_json(place, content)
        if now.as_json:
            print_document(document)
    if not now.as_json:
        answer.show()
        if now.report_file is not None:
            print(f"report: {getattr(now.report_file, 'url', now.report_file)}")
    return answer.exit_code


def _refuse(error: PrbenchError, now: commands.Session, words: list[str]) -> int:
    """Print an error: one message on standard error and, where JSON was asked for, a document."""
    if now.verbose:
        traceback.print_exception(error)
    print(f"prbench: {error}", file=sys.stderr)
    if now.as_json or "--json" in words:  # the option itself may stand behind the word that was refused
        print_document(document_of(error, now))
    return error.exit_code


class Document(msgspec.Struct, frozen=True, kw_only=True):
    """The envelope around every report.

    Attributes:
        prbench: Version of prbench that wrote the document.
        command: Name of the command, such as ``leaderboard compare``.
        exit_code: What the command ended with.
        notes: What the command said beside its report, on standard error.
        report: The command's report; its shape is described below, command by command; null if there is an error.
        error: Why there is no report: ``kind``, the class of the error such as ``TableError``, and ``message``: what
            was expected and found, and what to do; null if there is a report.
    """

    prbench: str
    command: str
    exit_code: int
    notes: list[str]
    report: Any
    error: dict[str, str] | None


def document_of(result: commands.Answer | PrbenchError, now: commands.Session) -> Document:
    """Put a command's answer, or the error for which there is none, into the envelope."""
    failed = isinstance(result, PrbenchError)
    return Document(
        prbench=prbench.__version__,
        command=now.command,
        exit_code=result.exit_code,
        notes=now.notes,
        report=None if failed else result.report,
        error={"kind": type(result).__name__, "message": str(result)} if failed else None,
    )


def print_document(document: Document) -> None:
    """Print a document on standard output."""
    print(_encoded(document).decode("utf-8"))
    sys.stdout.flush()


def _encoded(document: Document) -> bytes:
    """Encode a document; what JSON cannot say (NaN, infinity) becomes null."""
    report = msgspec.json.encode(document.report, enc_hook=_plain).decode()
    # Messages in a report name places as well. Notes stay unchanged: some say where a local copy lies.
    document = msgspec.structs.replace(document, report=msgspec.Raw(commands.session().shown_place(report).encode()))
    return msgspec.json.format(msgspec.json.encode(document), indent=2)


def _plain(value: Any) -> Any:
    """Encode what JSON has no form for: paths, and NumPy's numbers and arrays."""
    if isinstance(value, Path):
        return commands.session().shown_place(str(value))
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")
