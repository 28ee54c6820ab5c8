"""Seals: pickles are loaded if this user wrote them.

Loading a pickle runs what is in it. Training leaves some (``state.pkl``, Stable-Baselines3's ``model.zip``), and run
folders are passed around, so each gets a seal beside it: a keyed hash of its content, ``FILE.seal``. The key is random,
made when it is first needed, and lies in a folder of the user's that no run folder has: ``CHEMLAB_STATE_DIR``, else
``XDG_STATE_HOME/chemlab``, else ``~/.local/state/chemlab`` (``LOCALAPPDATA/chemlab`` on Windows). A file that was
changed, that somebody else's key sealed or that nobody sealed is loaded only inside ``strangers_code(True)``
(:mod:`chemlab.config.parts`), which ``--trust`` is for.
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

__all__ = ["read_sealed", "seal_file", "state_folder"]

_KEY_BYTES = 32
_SEAL_BYTES = 1_000
_MOST_BYTES = 2_000_000_000
"""Of a sealed file: a learner with all that it needs to go on."""


def state_folder() -> Path:
    """Where this user's key lies."""
    for name, below in (("CHEMLAB_STATE_DIR", ""), ("XDG_STATE_HOME", "chemlab"), ("LOCALAPPDATA", "chemlab")):
        if os.environ.get(name):
            return Path(os.environ[name], below)
    return Path.home() / ".local" / "state" / "chemlab"


@functools.cache
def _key(folder: Path) -> bytes:
    """The key in a folder, made where there is none."""
    file = folder / "seal.key"
    try:
        if not file.exists():
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            draft = folder / f".draft-{secrets.token_hex(8)}"
            with open(os.open(draft, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb") as handle:
                handle.write(secrets.token_bytes(_KEY_BYTES))
                os.fsync(handle.fileno())
            try:
                # Of several processes that make one at once, all have the first one's.
                with contextlib.suppress(FileExistsError):
                    os.link(draft, file)
            finally:
                draft.unlink()
        key = read_bytes(file, _SEAL_BYTES)
    except OSError as error:
        warnings.warn(
            f"{file}: no key for seals ({error.strerror}): another process loads what this one leaves only with "
            "--trust; CHEMLAB_STATE_DIR names another folder",
            stacklevel=3,
        )
        return secrets.token_bytes(_KEY_BYTES)
    if len(key) != _KEY_BYTES:
        raise ValueError(f"{file}: must have {_KEY_BYTES} bytes, has {len(key)}; delete it, and a new one is made")
    return key


def _seal_of(content: bytes) -> str:
    return hashlib.blake2b(content, key=_key(state_folder()), digest_size=16, person=b"chemlab seal").hexdigest()


def _seal_beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.seal")


def seal_file(path: Path) -> None:
    """Say of a file that is finished that this user wrote it."""
    write_text(_seal_beside(path), _seal_of(read_bytes(path, _MOST_BYTES)) + "\n")


def read_sealed(path: Path) -> bytes:
    """A file's content, if this user wrote it or trusts it.

    Raises:
        DataError: neither; the message names the flag.
        FileNotFoundError: no such file.
        OSError: it is not a regular file, or too large.
    """
    content = read_bytes(path, _MOST_BYTES)
    try:
        found = read_bytes(_seal_beside(path), _SEAL_BYTES).decode("utf-8", errors="replace").strip()
    except FileNotFoundError:
        found = ""
    # Not ASCII is an error to compare_digest, and no seal.
    sealed = found.isascii() and hmac.compare_digest(found, _seal_of(content))
    if not sealed and not may_run(otherwise=False):
        what = "has been changed, or was written by somebody else" if found else "has no seal of yours"
        raise DataError(
            f"{shlex.quote(str(path))}: {what}: loading such a file runs what is in it; if you trust whoever made it, "
            "say --trust (in Python: with chemlab.config.parts.strangers_code(True))"
        )
    return content
