"""Cost of verifying a record compared with another commit: the same episodes, verified in alternating pairs.

    git worktree add ../before <commit>
    python -m venv ../before.venv && ../before.venv/bin/pip install -e "../before[test]"
    python studies/speed/verify_pairs.py --before ../before ../before.venv/bin/python

Each process records its own episodes of the common scenarios and reports the processor time of verifying 24 of them;
only the ratio (after / before) is meaningful. Exits with 1 if its median is above ``--most``.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
from pathlib import Path
from typing import IO, cast

WORKER = """
import sys, tempfile, time
from pathlib import Path
sys.path[:0] = ["tests", "studies/speed"]
from verify import POLICIES, Recorder, play_episode, policies, raw_env, scenario_names, verify_record
print(*scenario_names(), flush=True)
names = sys.stdin.readline().split()
envs, paths = {name: raw_env(name) for name in names}, []
with tempfile.TemporaryDirectory() as folder:
    for e in range(240):
        env, path = envs[names[e % len(names)]], Path(folder) / f"{e}.jsonl"
        policy = policies(POLICIES[e // len(names) % len(POLICIES)], env, e)
        play_episode(env, policy, e, recorder=Recorder(path, env.laboratories))
        paths.append(path)
    for path in paths[:24]:
        verify_record(path)
    print("ready", flush=True)
    for line in sys.stdin:
        first, begun = 24 * int(line), time.process_time()
        assert all(verify_record(path).status == "ok" for path in paths[first : first + 24])
        print(time.process_time() - begun, flush=True)
"""


class Worker:
    """A process of one checkout."""

    def __init__(self, python: str, checkout: Path) -> None:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = subprocess.Popen([python, "-c", WORKER], cwd=checkout, text=True, **pipes)

    def said(self) -> str:
        """Return its next line."""
        return cast(IO[str], self._process.stdout).readline().strip()

    def tell(self, line: str) -> None:
        """Send it a line."""
        print(line, file=cast(IO[str], self._process.stdin), flush=True)


def main() -> int:
    """Measure and report; return 1 if verification has become slower than allowed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", nargs=2, required=True, metavar=("CHECKOUT", "PYTHON"))
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--most", type=float, default=1.1)
    arguments = parser.parse_args()
    checkout, python = arguments.before
    workers = [Worker(python, Path(checkout)), Worker(sys.executable, Path(__file__).parents[2])]
    known = [worker.said().split() for worker in workers]
    for worker in workers:
        worker.tell(" ".join(sorted(set(known[0]) & set(known[1]))))
    for worker in workers:
        worker.said()
    ratios = []
    for pair in range(arguments.pairs):
        seconds = {}
        for worker in workers if pair % 2 else workers[::-1]:
            worker.tell(str(pair % 10))
            seconds[worker] = float(worker.said())
        ratios.append(seconds[workers[1]] / seconds[workers[0]])
    low, median, high = statistics.quantiles(ratios, n=4)
    print(f"{len(ratios)} pairs of 24 records, after / before: {median:.3f} (quartiles {low:.3f}, {high:.3f})")
    return int(median > arguments.most)


if __name__ == "__main__":
    sys.exit(main())
