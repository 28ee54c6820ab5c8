"""Processor time of a live page at 60 turns a second, with one spectator.

    python studies/speed/live.py
    python studies/speed/live.py --scenario failing --episodes 2
    python studies/speed/live.py --update docs/how-to/live.md

The server and the spectator are two processes. The spectator receives every scene, and begins a new episode where one
ends. The processor time of the server alone is counted, which holds on a busy machine, too: `core` is its time a turn
times 60, as a share of a core. The bound is a quarter of a core.
"""

from __future__ import annotations

import argparse
import http.client
import json
import multiprocessing
import os
import socket
import tempfile
import threading
import time
from pathlib import Path

from report import arguments, report

from chemlab import load_scenario
from chemlab.agents.live import Live, live_app, live_server

TURNS_A_SECOND = 60


def watch(port: int, episodes: int) -> None:
    """Read the news of a laboratory through so many episodes."""
    for number in range(episodes):
        stream = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
        stream.request("GET", "/lab/0/events")
        answer = stream.getresponse()
        while b'"over":true' not in answer.readline():
            pass
        stream.close()
        if number + 1 < episodes:
            order = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
            order.request("POST", "/control", json.dumps({"do": "new"}), {"Content-Type": "application/json"})
            order.getresponse().read()
            order.close()


def measure(scenario: str, episodes: int) -> dict[str, float]:
    """Return turns, milliseconds of processor time a turn, and the share of a core at 60 turns a second."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
        probe.close()
        live = Live(load_scenario(scenario), "scripted", 0, "train", Path(folder))
        while not live.room.over:  # compiles, and is not counted
            live.step()
        live.check()
        live.begin(1)
        server = live_server(live_app([live], ["scripted"], speed=TURNS_A_SECOND), "127.0.0.1", port)
        thread = threading.Thread(target=server.run)
        turns, whole = 0, live.begin

        def begin(seed: int) -> None:
            nonlocal turns
            turns += live.film.turns
            whole(seed)

        live.begin = begin  # type: ignore[method-assign]
        before = time.process_time()
        thread.start()
        while not server.started:
            time.sleep(0.01)
        spectator = multiprocessing.get_context("spawn").Process(target=watch, args=(port, episodes))
        spectator.start()
        spectator.join()
        spent = time.process_time() - before
        turns += live.film.turns
        server.should_exit = True
        thread.join()
    return {"turns": turns, "ms": 1000 * spent / turns, "core": TURNS_A_SECOND * spent / turns}


def main() -> None:
    """Print a row for each scenario."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenario", action="append", help="default: wurtz_dodecane and relay")
    parser.add_argument("--episodes", type=int, default=4)
    given = arguments(parser)
    results = {name: measure(name, given.episodes) for name in given.scenario or ("wurtz_dodecane", "relay")}
    table = ["| scenario | turns | processor time of a turn (ms) | share of a core |", "|---|--:|--:|--:|"]
    for name, found in results.items():
        table.append(f"| `{name}` | {found['turns']:.0f} | {found['ms']:.2f} | {found['core']:.2f} |")
    report(given, results, {"live": [*table, "", f"Load average {os.getloadavg()[0]:.1f}."]})


if __name__ == "__main__":
    main()
