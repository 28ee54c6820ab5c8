"""What the tests of seats share: the calls of a scripted episode, and the record that they make in this process."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from helpers import until

from chemlab.agents.seats import Room
from studies.tools.seats import play_scripted

SALT, SEED = "feedfacefeedfacefeedfacefeedface", 7
SEATS = ("manager_0", "dit_0")
Calls = list[tuple[str, str, dict[str, Any]]]


@contextmanager
def serving(server: Any) -> Iterator[int]:
    """The port of a server of uvicorn's that runs in a thread."""
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    until(lambda: server.started or not thread.is_alive())
    yield server.servers[0].sockets[0].getsockname()[1]
    server.should_exit = True
    thread.join(20)


def played(seats: tuple[str, ...], folder: Path) -> tuple[Calls, bytes]:
    """An episode in this process: the calls, and its record."""
    calls = play_scripted(Room("unlabelled", seats, folder=folder, salt=SALT, seed=SEED))
    return calls, (folder / "episode-0000.jsonl").read_bytes()
