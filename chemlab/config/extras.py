"""A readable error where a package of an extra is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Make an ImportError in the block say ``what`` needs a package, and how to install the extra that has it."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f'{what} ({error}): pip install ".[{extra}]"') from error
