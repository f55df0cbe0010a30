"""Signatures of finished runs, by which an organiser who ran a method vouches for what nobody can compute again.

``SHA256SUMS`` lists the files of a run that count, and ``SHA256SUMS.minisig`` signs the list. Common tools check both,
in the run folder: ``minisign -Vm SHA256SUMS -p KEY.pub`` and ``sha256sum -c SHA256SUMS``.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prbench.errors import InputFileError, MissingExtraError, RunError, UsageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import file_digest, write_bytes
from prbench.harness.run_folder.folder import MERGED, RunFolder, read_folds
from prbench.limits import HARMLESS_SIZE, LARGEST_JSON

if TYPE_CHECKING:
    from minisign import PublicKey, SecretKey, Signature

SUMS = "SHA256SUMS"
SIGNATURE = f"{SUMS}.minisig"


def secret_key(path: Path, password: Callable[[], str]) -> SecretKey:
    """Read a secret key of minisign, ready to sign.

    Args:
        path: The key's file, as ``minisign -G`` writes it.
        password: Gives the key's password; called if it has one.

    Raises:
        InputFileError: if the file is no such key.
        UsageError: if the password is wrong.
        MissingExtraError: if the package for signatures is not installed.
    """
    key = _read_key(path, "SecretKey")
    if key.is_encrypted():
        try:
            key.decrypt(password())
        except _library().Error as error:
            raise UsageError(f"--sign {path}: {error}.") from error
    return key


def sign_run(run: RunFolder, key: SecretKey, *, made: int, found: int) -> str:
    """Sign a finished run, and with a merged one the runs on folds beside it.

    Args:
        run: The run.
        key: Key of the signer.
        made: Number of batches that the signer has seen the method make.
        found: Number of batches that lay in the folder before.

    Returns:
        Id of the key, as minisign prints it.

    Raises:
        StorageError: if the signature cannot be written.
    """
    folds = read_folds(run.path) if run.path.name == MERGED else ()
    for folder in (run.path, *(run.path.parent / fold.run for fold in folds)):
        signed = RunFolder.open(folder, any_benchmark=True)
        isolation = signed.record.method.isolation or "none"
        comment = f"prbench run, isolation {isolation}, {made} of {made + found} batches made by the signing command"
        text = _sums(signed).encode()
        write_bytes(folder / SUMS, text)
        write_bytes(folder / SIGNATURE, bytes(key.sign(text, trusted_comment=comment)) + b"\n")
    return _key_id(key.get_public_key().to_base64())


def require_signed(runs: Iterable[RunFolder], public_key: Path) -> str:
    """Refuse runs that are not exactly what the owner of a key has signed.

    Args:
        runs: The runs.
        public_key: File of minisign's public key.

    Returns:
        Id of the key, as minisign prints it.

    Raises:
        RunError: naming every run that is unsigned, signed by another key or changed, and what is wrong with it.
        InputFileError: if the file is no such key.
        MissingExtraError: if the package for signatures is not installed.
    """
    key = _read_key(public_key, "PublicKey")
    signer = _key_id(key.to_base64())
    wrong = [f"{run.path}: {reason}" for run in runs if (reason := _why_not_signed(run, key, signer))]
    if wrong:
        remedy = f"{'; '.join(wrong)}. Leave them out, or ask the signer for the runs as they were signed."
        raise RunError(f"expected runs signed by {signer} ({public_key}), found {len(wrong)} that are not. {remedy}")
    return signer


def require_unchanged(run: RunFolder) -> None:
    """Refuse a signed run of which a file was changed, added or removed after it was signed; no key is needed.

    Raises:
        RunError: naming the file.
    """
    path = run.path / SUMS
    changed = _changed(run, read_whole(path, largest=LARGEST_JSON)) if path.is_file() else ""
    if changed:
        raise RunError(f"{run.path}: {changed}. Hand in the run as it was signed, or without {SUMS} and its signature.")


@foreign_input()
def _why_not_signed(run: RunFolder, key: PublicKey, signer: str) -> str:
    try:
        text = read_whole(run.path / SUMS, largest=LARGEST_JSON)
        signature: Signature = _library().Signature.from_bytes(read_whole(run.path / SIGNATURE, largest=HARMLESS_SIZE))
        found = _key_id(bytes(signature).splitlines()[1])
        if found != signer:
            return f"is signed by {found}"
        key.verify(text, signature)
    except FileNotFoundError:
        return "is not signed"
    except _library().Error as error:
        return f"its signature does not hold ({error})"
    return _changed(run, text)


def _changed(run: RunFolder, text: bytes) -> str:
    changed = set(_sums(run).encode().splitlines()) ^ set(text.splitlines())
    names = sorted({line.decode(errors="replace").partition("  ")[2] for line in changed})
    return f"{names[0]} was changed, added or removed after it was signed" if names else ""


def _sums(run: RunFolder) -> str:
    """Return the digests of all files on which a board depends, in the form of ``sha256sum``."""
    return "".join(f"{file_digest(path)}  {path.relative_to(run.path).as_posix()}\n" for path in run.files)


@foreign_input()
def _read_key(path: Path, kind: str) -> Any:
    library = _library()
    try:
        return getattr(library, kind).from_bytes(read_whole(path, largest=HARMLESS_SIZE))
    except (OSError, library.Error) as error:
        expected = f"a {kind.removesuffix('Key').lower()} key of minisign, of which `minisign -G` makes a pair"
        raise InputFileError(path, "", expected=expected, found=str(getattr(error, "strerror", "") or error)) from error


def _key_id(encoded: bytes) -> str:
    """Return the id in a public key or signature: eight bytes behind the two of the algorithm, lowest first."""
    return f"{int.from_bytes(base64.b64decode(encoded)[2:10], 'little'):016X}"


def _library() -> Any:
    try:
        import minisign
        from minisign import PublicKey  # noqa: F401 - an abandoned package of the same name lacks it

        return minisign
    except ImportError as error:
        raise MissingExtraError("py-minisign", "sign", "a signature") from error
