"""Commands, groups of commands, and what all of them have in common: help, notes, JSON.

A command is a function that returns an :class:`Answer`: a report, and how it is printed for people. The same report is
printed as JSON with ``--json`` (docs/command-line.md#json), and written to a file with ``--out`` where the command has
no other use for that option.

Progress of long work: a bar on a terminal, plain lines in a log. Everything goes to standard error.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
import textwrap
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from prbench.cli.places import PlaceType, Remote, local_places
from prbench.cli.terminal import renamed_output
from prbench.entry_points import InstalledEntry, installed_entries
from prbench.errors import did_you_mean
from prbench.progress_bar import ProgressCallback, progress_bar
from prbench.shown import clean, quoted

# Columns that a help page takes at most: longer lines are hard to read.
_WIDEST_HELP = 100
Report = type | str | list | Mapping[str, Any] | None


@dataclass
class Session:
    """One call of the command line: how much it says, and what it has said beside its report.

    Attributes:
        quiet: Neither notes nor progress are shown.
        verbose: Every finished item is a line, and a user's error has its traceback.
        as_json: The report is printed as JSON.
        from_shell: The command line was not called as a function, so that nobody but the shell sees how it ends.
        resumes: The chosen command takes up what an interruption has left.
        command: Name of the chosen command, such as ``leaderboard export``.
        report_file: The report is also written to this file.
        notes: What was said beside the report.
        shown_place: Shows URLs in place of their local copies.
        all_metrics: Metrics beside the main ones are printed, too.
        strict: Motions that are certainly wrong end the command with exit code 1.
    """

    quiet: bool = False
    verbose: bool = False
    as_json: bool = False
    from_shell: bool = False
    resumes: bool = False
    command: str = ""
    report_file: Path | Remote | None = None
    notes: list[str] = field(default_factory=list)
    shown_place: Callable[[str], str] = str
    all_metrics: bool = False
    strict: bool = False


@dataclass(frozen=True)
class Answer:
    """The result of a command.

    Attributes:
        report: An instance of the command's documented shape.
        show: Prints the report for people, on standard output.
    """

    report: Any
    show: Callable[[], None]
    exit_code: int = 0


def session() -> Session:
    """Return the session of the command that runs, or an ordinary one outside of commands."""
    context = click.get_current_context(silent=True)
    found = context.find_object(Session) if context is not None else None
    return found or Session()


def note(text: str) -> None:
    """Say something beside the report, on standard error; ``--quiet`` leaves it out, ``--json`` lists it, too."""
    now = session()
    now.notes.append(text)
    if not now.quiet:
        print(text, file=sys.stderr, flush=True)


class Command(click.Command):
    """A command with an example, the options of all commands, and options that take several values.

    Args:
        name: Name on the command line.
        example: A command line of it.
        resumes: The command takes up what an interruption has left.
        report: Data class or msgspec struct that it prints with ``--json``, or ``module:class`` of one whose module
            takes long to import; a list of one, where it prints a list; one for each value of the first argument or
            option that chooses it; None for no report. ``--out FILE`` writes that JSON, too, unless the command has an
            ``--out`` of its own.
        section: Section of ``prbench --help`` that lists the command of another package, named by the word before its
            colon, such as ``train``.
        first: Options that help shows first, for a command with many; the others follow under "advanced".
        former: Maps options of earlier versions, or those that people write for another, to the present ones.
        items: Maps values of the first argument to what they mean, which help lists behind its text.
        settings: Further arguments of :class:`click.Command`.
    """

    example: str
    resumes: bool = False
    report: Report = None
    section: str = ""
    first: Collection[str] = ()
    former: Mapping[str, str] = MappingProxyType({})
    items: Mapping[str, str] = MappingProxyType({})

    def __init__(self, name: str | None, *, example: str, **settings: Any) -> None:
        own = {key: settings.pop(key) for key in Command.__annotations__ if key in settings}
        super().__init__(name, **settings)
        vars(self).update(own, example=example)
        if self.report is not None:
            as_json = "Print the report as JSON (docs/command-line.md#json); notes stay on standard error."
            self.params.append(_shared_option(["--json", "as_json"], as_json, is_flag=True, is_eager=True))
        if self.report is not None and not any("--out" in option.opts for option in self.params):
            to_file = "Write the report as JSON to this file, too."
            place = PlaceType("file", dir_okay=False)
            self.params.append(_shared_option(["--out", "report_file"], to_file, type=place, metavar="FILE"))
        self.params += _telling_options()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words; one option may be followed by several values, as in ``--data A B``."""
        several = {name for option in self.params if getattr(option, "several", False) for name in option.opts}
        try:
            return super().parse_args(ctx, _one_value_an_option(args, several))
        except click.UsageError as error:
            if isinstance(error, click.BadParameter) and error.param and isinstance(error.param.type, click.Choice):
                word = error.message.partition("' is not one of")[0].removeprefix("'")
                nearest = did_you_mean(word, list(error.param.type.choices))
                raise click.BadParameter(error.message + nearest, error.ctx or ctx, error.param) from error
            if isinstance(error, click.NoSuchOption) and error.option_name in self.former:
                now = self.former[error.option_name]
                raise click.UsageError(f"No such option '{error.option_name}'. Did you mean '{now}'?", ctx) from error
            error.ctx = error.ctx or ctx  # click forgets here and there which command it was
            raise

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        now = session()
        now.command = " ".join(ctx.command_path.split()[1:])
        now.resumes = self.resumes
        with local_places(ctx.params, note) as places:
            ctx.params = places.values
            now.shown_place = places.renamed
            answer = super().invoke(ctx)
            # A number comes from a command that was run in another process, or that had nothing to write.
            places.finished = isinstance(answer, Answer) or not answer
        if not isinstance(answer, Answer) or not places.shown:
            return answer

        def show_urls() -> None:
            with renamed_output(places.renamed):
                answer.show()

        return replace(answer, show=show_urls)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the values of the first argument, the options that are shown first, and those of seldom use."""
        if self.items:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_dl(list(self.items.items()))
        parts: dict[str, list[tuple[str, str]]] = {"Options": [], "advanced": []}
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx)
            if record is not None:
                is_first = not self.first or not {"--help", *self.first}.isdisjoint(option.opts)
                parts["Options" if is_first else "advanced"].append(record)
        for title, records in parts.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the example."""
        _write_example(self.example, formatter)


class SeveralValues(click.Option):
    """An option that may be repeated or followed by several values: ``--data A B`` is ``--data A --data B``."""

    several = True

    def __init__(self, *names: Any, **settings: Any) -> None:
        super().__init__(*names, multiple=True, **settings)


class Group(click.Group):
    """Commands in sections, each imported when it is asked for.

    Args:
        name: Name of the group on the command line.
        sections: The title of each section, and the commands in it: name and where its function stands
            (``module:function``).
        example: Command lines, and comments that begin with ``#``, a line each.
        section: Section of ``prbench --help`` that lists the group of another package.
        renamed: Maps former command lines, without ``prbench``, to what to write in their place.
        usual: Command that is meant where the first word names none; empty for none.
        plugins: Entry-point group whose commands stand beside those of ``sections``; empty for none.
        closing: Paragraph at the end of its help.
        settings: Further arguments of :class:`click.Group`.
    """

    sections: Mapping[str, Mapping[str, str]]
    example: str
    section: str = ""
    renamed: Mapping[str, str] = MappingProxyType({})
    usual: str = ""
    plugins: str = ""
    closing: str = ""

    def __init__(
        self, name: str | None = None, *, sections: Mapping[str, Mapping[str, str]], example: str, **settings: Any
    ) -> None:
        own = {key: settings.pop(key) for key in Group.__annotations__ if key in settings}
        super().__init__(name, **settings)
        vars(self).update(own, sections=sections, example=example)
        self.params += _telling_options()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words in front of the command, and put in the usual command where there is none."""
        own = {word for option in self.get_params(ctx) for word in option.opts}
        first = next((word for word in args if word not in own), "")
        if self.usual and args != ["--help"] and not ctx.resilient_parsing and self.get_command(ctx, first) is None:
            args = [self.usual, *args]
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, section by section, those that cannot be loaded left out."""
        return [name for commands in self._listed(ctx).values() for name in commands]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command, or return None for an unknown name.

        Raises:
            click.UsageError: for a command of another package that cannot be loaded.
        """
        for commands in self.sections.values():
            if cmd_name in commands:
                module, _, function = commands[cmd_name].partition(":")
                return getattr(importlib.import_module(module), function)
        entry = self._plugins.get(cmd_name)
        return None if entry is None else self._loaded(entry, ctx)

    @cached_property
    def _plugins(self) -> dict[str, InstalledEntry]:
        """The commands that packages register, by name; those of prbench's own packages come first."""
        found: dict[str, InstalledEntry] = {}
        if self.plugins:
            for entry in sorted(installed_entries(self.plugins, kind="command"), key=lambda each: not each.built_in):
                found.setdefault(entry.name, entry)
        return found

    def _loaded(self, entry: InstalledEntry, ctx: click.Context) -> click.Command:
        problem = entry.problem
        if not problem:
            module, _, function = entry.target.partition(":")
            try:
                found = getattr(importlib.import_module(module.strip()), function.strip())
            except Exception as error:  # whatever another package raises, it breaks its own command only
                problem = f"{type(error).__name__}: {quoted(error)}"
            else:
                if isinstance(found, Command | Group):
                    return found
                problem = f"expected a Command or Group of prbench.cli.commands, found {type(found).__name__}"
        raise click.UsageError(
            f"the command '{quoted(entry.name)}' of the package {entry.package} {entry.version} cannot be used:"
            f" {problem}.",
            ctx,
        )

    def _listed(self, ctx: click.Context) -> dict[str, list[str]]:
        """Return the title of each section and the names of its commands, those of packages behind the others."""
        titles = {title.partition(":")[0]: title for title in self.sections}
        listed = {title: list(commands) for title, commands in self.sections.items()}
        for name, entry in self._plugins.items():
            try:
                command = self._loaded(entry, ctx)
            except click.UsageError:
                continue  # named with its problem when it is called
            names = listed.setdefault(titles.get(getattr(command, "section", ""), "more: from packages"), [])
            if name not in names:
                names.append(name)
        return listed

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the first word names.

        Raises:
            click.UsageError: for an unknown one, naming what it is called now or the nearest, also one inside a group.
        """
        name = args[0]
        if self.get_command(ctx, name) is None and not name.startswith("-") and not ctx.resilient_parsing:
            renamed = getattr(ctx.find_root().command, "renamed", {})
            for words in (args[:2], args[:1]):
                former = " ".join([*ctx.command_path.split()[1:], *words])
                if former in renamed:
                    raise click.UsageError(f"'prbench {former}' is now `prbench {renamed[former]}`.", ctx)
            nearest = did_you_mean(name, self.list_commands(ctx))
            within = [full for full, _ in self.walk(ctx) if full.split()[-1] == name]
            where = f" Did you mean '{within[0]}'?" if within else nearest
            raise click.UsageError(f"No such command '{name}'.{where}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands of each section with their summaries."""
        for title, commands in self._listed(ctx).items():
            if commands:
                with formatter.section(title):
                    formatter.write_dl([(name, summary(self.get_command(ctx, name))) for name in commands])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples and the last paragraph."""
        _write_example(self.example, formatter)
        if self.closing:
            formatter.write_paragraph()
            formatter.write_text(self.closing)

    def walk(self, ctx: click.Context) -> Iterator[tuple[str, click.Command]]:
        """Yield every command of the group and of the groups in it, with its name, such as ``leaderboard export``."""
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if isinstance(command, Group):
                yield from ((f"{name} {below}", found) for below, found in command.walk(ctx))
            elif command is not None:
                yield name, command


def summary(command: click.Command | None) -> str:
    """Return the first sentence of a command's help."""
    return (command.help or "").partition("\n\n")[0].replace("\n", " ").rstrip(".") if command else ""


def command(name: str, *, example: str, **settings: Any) -> Callable[[Callable[..., Any]], Command]:
    """Turn a function into a :class:`Command`; its docstring becomes the help, its parameters are the options.

    Args:
        name: Name on the command line.
        example: A command line of it.
        settings: Further arguments of :class:`Command`.
    """
    widest = {"max_content_width": _WIDEST_HELP}
    return click.command(name, cls=Command, example=example, context_settings=widest, **settings)


def _write_example(example: str, formatter: click.HelpFormatter) -> None:
    """Write command lines and comments, folded as a shell reads them."""
    settings = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": "      "}
    formatter.write("\nexample:\n")
    for line in example.splitlines():
        parts = textwrap.wrap(line, formatter.width - 2, initial_indent="  ", **settings)
        formatter.write(" \\\n".join(parts) + "\n")


def _one_value_an_option(words: Sequence[str], several: set[str]) -> list[str]:
    """Repeat the name of an option before its second and later values."""
    result: list[str] = []
    option: str | None = None
    awaited = False
    for index, word in enumerate(words):
        if word == "--":
            return [*result, *words[index:]]
        if word.startswith("-") and word != "-":
            option = word if word in several else None
            awaited = option is not None
        elif option is not None and not awaited:
            result.append(option)
        else:
            awaited = False
        result.append(word)
    return result


def in_session(ctx: click.Context, parameter: click.Parameter, value: Any) -> None:
    """Keep the value of an option in the session."""
    if value:
        setattr(ctx.ensure_object(Session), str(parameter.name), value)


def _shared_option(words: list[str], help: str, **settings: Any) -> click.Option:
    """Make an option of all commands, whose value goes to the session."""
    return click.Option(words, help=help, expose_value=False, callback=in_session, **settings)


def _telling_options() -> list[click.Option]:
    quiet = "Show neither notes nor progress, only the result and errors."
    verbose = "Show every finished item, and the traceback of an error."
    return [
        _shared_option(["-q", "--quiet"], quiet, is_flag=True),
        _shared_option(["-v", "--verbose"], verbose, is_flag=True),
    ]


_SECONDS_BETWEEN_LINES = 5.0


@contextlib.contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """Show the progress of one piece of work while the block runs: each item as a line with ``--verbose``."""
    now = session()
    last_line = 0.0

    def line(done: int, total: int, last: str) -> None:
        nonlocal last_line
        time_now = time.monotonic()
        if now.verbose or done == total or time_now - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = time_now
            print(f"{description}: {done}/{total} {clean(last)}".rstrip(), file=sys.stderr, flush=True)

    if now.quiet:
        yield lambda *_: None
    elif now.verbose or not sys.stderr.isatty():
        yield line
    else:
        from prbench.cli.terminal import console

        with progress_bar(description, console(stderr=True)) as callback:
            yield callback
