"""URLs of folders and files: recognised, taken apart, and refused where they hold a password or a token."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import UsageError
from prbench.files.storage import cache_folder, is_path_part, text_digest
from prbench.shown import clean, quoted

_URL = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+(::[^/]*)?://")
_SWALLOWED = re.compile(r"(s3a?|gs|gcs|az|abfss?|hf|https?|memory):/(?!/)")
"""How ``pathlib.Path`` spells the URL of a store: it makes one slash of two."""
_ACCOUNT_BEHIND_AT = frozenset({"abfs", "abfss", "az"})
"""Protocols that write ``container@account`` where others write ``user:password@host``."""


def is_url(text: object) -> bool:
    """Return True for text such as ``s3://bucket/folder``; paths of this machine are none.

    Raises:
        UsageError: for a URL that went through :class:`pathlib.Path`, which makes one slash of two.
    """
    if isinstance(text, Path):
        text = str(text)
        if _SWALLOWED.match(text):
            raise UsageError(f"{clean(text)}: give a URL as text, not as a Path, which makes one slash of two.")
        return False
    return isinstance(text, str) and _URL.match(text) is not None


@dataclass(frozen=True)
class StoreUrl:
    """The URL of a folder or file, without anything secret.

    Args:
        text: The URL, without a slash at the end.
    """

    text: str

    @classmethod
    def parse(cls, text: str) -> StoreUrl:
        """Check a URL.

        Raises:
            UsageError: if it holds a password, a query or a fragment, chains protocols, or names nothing; what might be
                secret is not repeated.
        """
        protocol, _, rest = text.partition("://")
        server, slash, path = rest.partition("/")
        # The container of abfs stands where the password might.
        place = re.split(r"[?#]", server.rpartition("@")[2] + slash + path)[0]
        shown = f"{clean(protocol)}://{quoted(place)}"
        if "::" in protocol:
            raise UsageError(f"{shown}: expected one protocol, found several joined by '::'.")
        if ("@" in server and protocol not in _ACCOUNT_BEHIND_AT) or ":" in server.rpartition("@")[0]:
            raise UsageError(
                f"{shown}: the URL holds a name or a password. Leave it out: credentials are those of the protocol's"
                " own library, from its environment variables and files (docs/object-stores.md#credentials)."
            )
        if "?" in rest or "#" in rest:
            raise UsageError(
                f"{shown}: expected a URL without '?' and '#', which could hold a token. Leave what follows out:"
                " credentials come from the environment (docs/object-stores.md#credentials)."
            )
        if not rest.strip("/") or any(part in (".", "..") for part in rest.split("/")):
            raise UsageError(f"{shown}: expected a bucket and a folder or file, such as s3://bucket/folder.")
        return cls(text.rstrip("/"))

    def __str__(self) -> str:
        return clean(self.text)

    @property
    def protocol(self) -> str:
        """What stands before ``://``."""
        return self.text.partition("://")[0]

    @property
    def name(self) -> str:
        """Last part of the path, as the name of a local folder or file."""
        name = self.text.rpartition("/")[2]
        return name if is_path_part(name) else "copy"

    @property
    def parent(self) -> StoreUrl:
        """The URL one level up."""
        return StoreUrl(self.text.rpartition("/")[0])

    @property
    def cache(self) -> Path:
        """Folder of the local copies of what lies there."""
        return cache_folder() / "object-stores" / text_digest(self.text)[:32]
