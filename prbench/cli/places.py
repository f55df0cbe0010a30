"""Options and arguments that take a path or a URL, of which a command sees a local path (docs/object-stores.md)."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import click

from prbench.errors import PrbenchError, WorkStopped

# What a command does there: read something finished, read a dataset's own files, write a folder or a file; or what has
# to lie on this machine.
Use = Literal["input", "native", "folder", "file", "local"]
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Remote:
    """A URL that was given in place of a path."""

    url: str
    use: Use


class PlaceType(click.Path):
    """A path, or a URL that :func:`local_places` turns into the path of a local copy.

    Args:
        use: What the command does there.
        dir_okay: False where a folder is refused before the command runs.
    """

    def __init__(self, use: Use, *, dir_okay: bool = True) -> None:
        super().__init__(path_type=Path, dir_okay=dir_okay)
        self.use: Use = use

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take a path, or a URL."""
        if isinstance(value, Remote):
            return value
        if not isinstance(value, str) or "://" not in value:
            return super().convert(value, param, ctx)
        from prbench.errors import UsageError
        from prbench.object_stores.store import StoreUrl, is_url

        if not is_url(value):
            return super().convert(value, param, ctx)
        url = StoreUrl.parse(value)
        if self.use == "local":
            raise UsageError(f"{url}: this has to be a path on this machine. Copy what lies there, and give that path.")
        return Remote(url.text, self.use)


class _Stopped(KeyboardInterrupt):
    """SIGTERM, which ends the work as Ctrl-C does, so that finished parts can still be uploaded."""


@dataclass
class Places:
    """The paths of a command, and how its URLs are shown in place of them.

    Attributes:
        values: Values of the options, without URLs.
        shown: Maps the path of each local copy to its URL.
        finished: Set to False where the command has ended without being done.
    """

    values: dict[str, Any]
    shown: dict[str, str]
    finished: bool = True

    def renamed(self, text: str) -> str:
        """Show URLs in place of their local copies."""
        for path, url in sorted(self.shown.items(), key=lambda item: -len(item[0])):
            text = text.replace(path, url)
        return text


@contextlib.contextmanager
def local_places(values: Mapping[str, Any], tell: Tell) -> Iterator[Places]:
    """Fetch what is read at URLs, and publish what the block writes at some when it ends well; paths stay as they are.

    Args:
        values: Values of a command's options by name.
        tell: Called with lines on what is fetched and uploaded.

    Raises:
        WorkStopped: after SIGTERM, where something is written at a URL.
        PrbenchError: whatever fetching and uploading raise, and errors of the block with URLs in place of paths.
    """
    places = Places(dict(values), {})
    if not any(map(_remotes, values.values())):
        yield places
        return
    from prbench.object_stores.inputs import fetched, fetched_native
    from prbench.object_stores.outputs import written_file, written_folder

    outcomes: list[Any] = []
    with contextlib.ExitStack() as held:
        if any(remote.use in ("folder", "file") for value in values.values() for remote in _remotes(value)):
            held.enter_context(_stopped_by_sigterm())

        def local(remote: Any) -> Any:
            """Give the local copy of a URL, or what was given in place of one."""
            if not isinstance(remote, Remote):
                return remote
            if remote.use == "folder":
                path, outcome = held.enter_context(written_folder(remote.url, tell=tell))
                outcomes.append(outcome)
            elif remote.use == "file":
                path = held.enter_context(written_file(remote.url, tell=tell))
            elif remote.use == "native":
                dataset = values.get("dataset")
                path = fetched_native(remote.url, None if dataset in (None, "all") else str(dataset), tell=tell)
            else:
                path = fetched(remote.url, tell=tell)
            places.shown[str(path)] = remote.url
            return path

        for name, value in values.items():
            if _remotes(value):
                places.values[name] = local(value) if isinstance(value, Remote) else tuple(map(local, value))
        try:
            yield places
        except PrbenchError as error:
            error.args = tuple(places.renamed(part) if isinstance(part, str) else part for part in error.args)
            raise
        for outcome in outcomes:
            outcome.finished = places.finished


def _remotes(value: Any) -> list[Remote]:
    several = value if isinstance(value, tuple | list) else [value]
    return [each for each in several if isinstance(each, Remote)]


@contextlib.contextmanager
def _stopped_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C would; a second one ends the process at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _Stopped

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except _Stopped:
        problem = "stopped by SIGTERM; what was finished is kept at the URL of --out,"
        raise WorkStopped(f"{problem} and the same command goes on there.") from None
    finally:
        signal.signal(signal.SIGTERM, before)
