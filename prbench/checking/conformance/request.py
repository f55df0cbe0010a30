"""What a user asks of a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

TIME_LIMIT = 600.0
"""Seconds for each call of the method, unless it is told."""


START_LIMIT = 120.0
"""Seconds for importing and for loading a method, as programs have to introduce themselves."""


@dataclass(frozen=True)
class CheckRequest:
    """What to check."""

    method: str
    """Installed name, ``cmd:`` and a command, or a TOML file."""
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    data: Path | None = None
    """A dataset whose test sequences are asked about; None for invented people."""
    time_limit: float = TIME_LIMIT
    """Seconds for each call of the method."""
    start_limit: float = START_LIMIT
    """Seconds for importing it, and for loading it; a program's own are in its TOML file."""

    def as_json(self) -> dict[str, object]:
        """The request as plain values; it crosses into another process."""
        return {
            "method": self.method,
            "weights": None if self.weights is None else str(self.weights),
            "options": dict(self.options),
            "device": self.device,
            "threads": self.threads,
            "isolate": self.isolate,
            "data": None if self.data is None else str(self.data.absolute()),
            "time_limit": self.time_limit,
            "start_limit": self.start_limit,
        }

    @classmethod
    def of_json(cls, values: Mapping[str, Any]) -> CheckRequest:
        """The request that :meth:`as_json` wrote."""
        paths = {name: None if values[name] is None else Path(values[name]) for name in ("weights", "data")}
        return cls(**{**values, **paths})
