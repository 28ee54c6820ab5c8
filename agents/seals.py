"""Signatures of pickle files: a pickle is loaded only if this user wrote it.

Unpickling executes code. Training writes pickles (``state.pkl``, Stable-Baselines3's ``model.zip``), and run folders
are exchanged between users. Each pickle therefore has a signature beside it, ``FILE.seal``, a keyed hash of its
content. The random key is created on first use and stored in a folder of the user outside run folders:
``CHEMLAB_STATE_DIR``, else ``XDG_STATE_HOME/chemlab``, else ``~/.local/state/chemlab`` (``LOCALAPPDATA/chemlab`` on
Windows). A file that was changed, has another user's signature or has none is loaded only inside
``strangers_code(True)`` (:mod:`chemlab.config.parts`), which ``--trust`` sets.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import hmac
import os
import secrets
import shlex
import warnings
from pathlib import Path

from chemlab.config.datafile import DataError
from chemlab.config.files import read_bytes, write_text
from chemlab.config.parts import may_run

_KEY_BYTES = 32
_SEAL_BYTES = 1_000
_MOST_BYTES = 2_000_000_000
"""Maximum size of a signed file: a learner with its complete training state."""


def state_folder() -> Path:
    """Return the folder of this user's key; ``~`` is not expanded, because a user may have no home folder."""
    for name, below in (("CHEMLAB_STATE_DIR", ""), ("XDG_STATE_HOME", "chemlab"), ("LOCALAPPDATA", "chemlab")):
        if os.environ.get(name):
            return Path(os.environ[name], below)
    return Path("~/.local/state/chemlab")


@functools.cache
def _key(folder: Path) -> bytes:
    """Return the key of a folder; create it if there is none."""
    file = folder / "seal.key"
    try:
        file = file.expanduser()
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            draft = file.parent / f".draft-{secrets.token_hex(8)}"
            with open(os.open(draft, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb") as handle:
                handle.write(secrets.token_bytes(_KEY_BYTES))
                os.fsync(handle.fileno())
            try:
                # If several processes create the key concurrently, all use the first one's.
                with contextlib.suppress(FileExistsError):
                    os.link(draft, file)
            finally:
                draft.unlink()
        key = read_bytes(file, _SEAL_BYTES)
    except (OSError, RuntimeError) as error:  # without a home folder, a RuntimeError
        warnings.warn(
            f"no key for signatures ({error}): other processes need --trust to load the files of this one; set "
            "CHEMLAB_STATE_DIR to a writable folder",
            stacklevel=3,
        )
        return secrets.token_bytes(_KEY_BYTES)
    if len(key) != _KEY_BYTES:
        raise ValueError(f"{file}: must have {_KEY_BYTES} bytes, has {len(key)}; delete it, and a new one is created")
    return key


def _seal_of(content: bytes) -> str:
    return hashlib.blake2b(content, key=_key(state_folder()), digest_size=16, person=b"chemlab seal").hexdigest()


def _seal_beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.seal")


def seal_file(path: Path) -> None:
    """Write the signature of this user for a finished file."""
    write_text(_seal_beside(path), _seal_of(read_bytes(path, _MOST_BYTES)) + "\n")


def read_sealed(path: Path) -> bytes:
    """Return the content of a file if its signature is valid or the user allows untrusted code.

    Raises:
        DataError: the signature is missing or invalid; the message names the flag.
        FileNotFoundError: the file does not exist.
        OSError: the file is not a regular file, or too large.
    """
    content = read_bytes(path, _MOST_BYTES)
    try:
        seal = read_bytes(_seal_beside(path), _SEAL_BYTES).decode("utf-8", errors="replace").strip()
    except FileNotFoundError:
        seal = ""
    # compare_digest rejects non-ASCII text, which is never a signature.
    valid = seal.isascii() and hmac.compare_digest(seal, _seal_of(content))
    if not valid and not may_run(otherwise=False):
        reason = "was changed, or was written by another user" if seal else "has no signature of this user"
        raise DataError(
            f"{shlex.quote(str(path))}: {reason}: loading this file can run any code; if you trust its author, "
            "give --trust (in Python: with chemlab.config.parts.strangers_code(True))"
        )
    return content
