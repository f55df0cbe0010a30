"""A user's own protocol: the file that is given with ``--protocol``, and the copy beside what it was used for.

The file has every key of ``benchmarks/prime_and_reach/protocol.toml`` and a name of its own. A copy of its values lies
beside every table, run and submission that follows it; what follows prbench's own protocol holds no such file.

Source: docs/specification/protocol.md#a-protocol-of-ones-own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from prbench.errors import PrbenchError, TableError, UsageError
from prbench.files.bounded import foreign_input, read_toml, require, structured
from prbench.files.storage import write_text
from prbench.protocol.manifests import PROTOCOL_NAME, BenchmarkProtocol, load_protocol

# Name of the copy in the folder of a table or run.
FILE_NAME = "protocol.toml"
# Key of ``dataset.json``, ``options``, that names a user's own protocol.
OPTION = "protocol"
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_ABOVE_ZERO = ("fps", "curation.priming_window", "metrics.prime_window")
_SHARES = ("splits.test", "splits.validation", "splits.tolerance")
# Parts that may differ between a table's protocol and a run's: nothing of the table depends on them.
_SCORING = ("name", "version", "metrics", "breakdown")
_START = "Start from a copy of benchmarks/prime_and_reach/protocol.toml and give it a name."


@foreign_input()
def read_protocol(path: Path) -> BenchmarkProtocol:
    """Read a protocol of one's own.

    Args:
        path: A TOML file with every key of prbench's own protocol, and ``name``.

    Raises:
        InputFileError: if it cannot be read, a key is missing, unknown, of another type or out of range, or the name is
            prbench's; names the key.
    """
    values = read_toml(path, "a protocol's TOML file", _START)
    protocol = structured(path, values, BenchmarkProtocol, remedy=_START)
    keys = [dict(_leaves(msgspec.to_builtins(each))).keys() for each in (protocol, load_protocol())]
    odd = ", ".join(sorted(keys[0] ^ keys[1]))
    require(path, (not odd, odd, "the keys of prbench's protocol", "a missing or an unknown one", _START))
    is_name = _NAME.fullmatch(protocol.name) is not None and protocol.name != PROTOCOL_NAME
    name = f"small letters, digits, '.', '_' and '-', and not '{PROTOCOL_NAME}', which is prbench's own"
    conditions = load_protocol().conditions
    splits = protocol.splits
    fewest = protocol.breakdown.fewest_recordings
    numbers = [item for item in _leaves(msgspec.to_builtins(protocol)) if isinstance(item[1], int | float)]
    bins = []
    for key in ("bearing", "distance", "height"):
        ends = getattr(protocol.breakdown, key)
        ascend = all(0 < end < math.inf for end in ends) and list(ends) == sorted(set(ends))
        bins.append((ascend, f"breakdown.{key}", "finite numbers above 0, ascending", list(ends)))
    four = f"the four conditions: {', '.join(conditions)}"
    left = f"at most what splits.test leaves ({1 - splits.test:g})"
    checks: list[tuple[Any, str, str, object]] = [
        (is_name, "name", name, f"'{protocol.name}'"),
        (protocol.version >= 1, "version", "1 or more", protocol.version),
        (protocol.conditions == conditions, "conditions", four, ", ".join(protocol.conditions) or "none"),
        *((0 <= value <= 1, key, "a share from 0 to 1", f"{value:g}") for key, value in numbers if key in _SHARES),
        *((value > 0, key, "a finite number above 0", f"{value:g}") for key, value in numbers if key in _ABOVE_ZERO),
        *((0 <= value < math.inf, key, "a finite number 0 or more", f"{value:g}") for key, value in numbers),
        *bins,
        (fewest >= 2, "breakdown.fewest_recordings", "2 or more", fewest),
        (splits.test + splits.validation <= 1, "splits.validation", left, f"{splits.validation:g}"),
    ]
    require(path, *((*check, "") for check in checks))
    return protocol


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each value under its dotted key."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def write_protocol(folder: Path, protocol: BenchmarkProtocol) -> None:
    """Write the copy of a user's own protocol into the folder of a table or run; nothing of prbench's own."""
    if protocol.is_own:
        write_text(folder / FILE_NAME, tomli_w.dumps(msgspec.to_builtins(protocol)))


def protocol_beside(folder: Path, *, digest: str, wrong: type[PrbenchError]) -> BenchmarkProtocol | None:
    """Return the protocol that a table or run follows; None where it is one of prbench's own of another version.

    Args:
        folder: Folder of the table or run.
        digest: Digest of the protocol that the table or run records.
        wrong: Error to raise.

    Raises:
        wrong: if the copy that lies there is not the protocol that is recorded.
        InputFileError: if the copy is no protocol.
    """
    file = folder / FILE_NAME
    if not file.is_file():
        return load_protocol() if load_protocol().digest == digest else None
    protocol = read_protocol(file)
    if protocol.digest != digest:
        raise wrong(
            f"{file}: expected the protocol that was followed here (digest {digest[:12]}…), found another one"
            f" ({protocol.digest[:12]}…). It was changed: put the file back, or make table or run again."
        )
    return protocol


def protocol_for(file: Path | None, tables: Iterable[DescribedTable]) -> BenchmarkProtocol:
    """Return the protocol of a run on some tables: the user's own, or prbench's.

    Args:
        file: The user's own; None for prbench's.
        tables: What the tables say of the protocol that they follow.

    Raises:
        InputFileError: if a file is no protocol.
        UsageError: if a table follows other rules.
        TableError: if the copy beside a table is missing or another one.
    """
    wanted = load_protocol() if file is None else read_protocol(file)
    for described in tables:
        folder = described.folder
        table = described.protocol()
        if not wanted.is_own:
            # Tables of earlier versions stay usable; their digests keep them in blocks of their own.
            if table is not None and table.is_own:
                refusal = f"{folder}: follows a protocol of its own, {table.label}. Name it:"
                raise UsageError(f"{refusal} --protocol {folder / FILE_NAME}")
            continue
        if table is None:
            problem = f"--protocol {wanted.label}: {folder} was built under a protocol of another version of prbench,"
            raise UsageError(f"{problem} which cannot be compared with it. Build the table again, with --protocol.")
        found = dict(_leaves(msgspec.to_builtins(table)))
        for key, value in _leaves(msgspec.to_builtins(wanted)):
            if key.partition(".")[0] not in _SCORING and found.get(key, value) != value:
                problem = f"--protocol {wanted.label}, {key}: {value!r}, but the table {folder} was built with"
                problem += f" {found[key]!r}. Build it again with the same --protocol; only [metrics] and [breakdown]"
                raise UsageError(f"{problem} may differ.")
    return wanted


@dataclass(frozen=True)
class DescribedTable:
    """What a table says of its protocol.

    Attributes:
        digest: Digest of the protocol that it was built with.
        options: Options in ``dataset.json``; those of a table of one's own protocol name it.
    """

    folder: Path
    digest: str
    options: Mapping[str, str]

    def protocol(self) -> BenchmarkProtocol | None:
        """Return the protocol; None for prbench's own of another version.

        Raises:
            TableError: if the copy beside the table is missing or another one.
        """
        if OPTION in self.options and not (self.folder / FILE_NAME).is_file():
            problem = f"{self.folder}: follows the protocol {self.options[OPTION]}, and its {FILE_NAME} is missing."
            raise TableError(f"{problem} Put the file back, or build the table again.")
        return protocol_beside(self.folder, digest=self.digest, wrong=TableError)
