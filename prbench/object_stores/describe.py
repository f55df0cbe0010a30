"""``python -m prbench.object_stores.describe DIR``: the manifest of a folder, for programs that copy it.

Copy the folder to a store, the manifest last; ``--data`` and others then read it there.
"""

from __future__ import annotations

import sys
from pathlib import Path

from prbench.errors import InputFileError
from prbench.files.storage import file_digest, write_bytes
from prbench.object_stores.manifest import FINISHED, FolderManifest, StoredFile


def describe(folder: Path) -> FolderManifest:
    """Write the manifest of all files in a folder into it.

    Args:
        folder: The folder; hidden files and folders are left out.

    Raises:
        InputFileError: if it is no folder.
        StorageError: if it cannot be written.
    """
    if not folder.is_dir():
        raise InputFileError(folder, "", expected="a folder", found="none")
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != FINISHED and not any(part.startswith(".") for part in name.split("/")):
            files[name] = StoredFile(size=path.stat().st_size, sha256=file_digest(path))
    manifest = FolderManifest.of(files)
    write_bytes(folder / FINISHED, manifest.encoded())
    return manifest


if __name__ == "__main__":
    for each in sys.argv[1:]:
        describe(Path(each))
