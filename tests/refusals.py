"""What loaders refuse: a text with one mistake in it, and an error that names all that a reader needs."""

from collections.abc import Callable
from pathlib import Path

import pytest

from chemlab.config.datafile import DataError


def changed(text: str, old: str, new: str) -> str:
    """A text with one piece replaced, which must be there exactly once."""
    assert text.count(old) == 1, old
    return text.replace(old, new)


def written(folder: Path, text: str) -> Path:
    """A text as a file."""
    (folder / "a.toml").write_text(text)
    return folder / "a.toml"


def refused(load: Callable[[], object], *parts: object) -> None:
    """Loading is an error that has all the parts in its message."""
    with pytest.raises(DataError) as caught:
        load()
    for part in parts:
        assert str(part) in str(caught.value), f"no {part!s} in: {caught.value}"
