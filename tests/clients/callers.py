"""What the tests of seats share: the calls of a scripted episode, and the record that they make in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from chemlab.agents.seats import Room
from studies.tools.seats import play_scripted

SALT, SEED = "feedfacefeedfacefeedfacefeedface", 7
SEATS = ("manager_0", "dit_0")
Calls = list[tuple[str, str, dict[str, Any]]]


def played(seats: tuple[str, ...], folder: Path) -> tuple[Calls, bytes]:
    """An episode in this process: the calls, and its record."""
    calls = play_scripted(Room("unlabelled", seats, folder=folder, salt=SALT, seed=SEED))
    return calls, (folder / "episode-0000.jsonl").read_bytes()
