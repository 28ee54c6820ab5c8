"""Time of a newcomer's path: a moving laboratory, a trained team with a curve, a scenario of one's own.

    python studies/speed/newcomer.py
    python studies/speed/newcomer.py --install --update docs/performance.md

Every command runs in a new process, and the kernel cache is empty at the beginning. With `--install` the path begins
with `pip install` of this checkout into a new virtual environment. On a busy machine only processor times (summed over
processes) are meaningful.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from chemlab.config.files import replace_between

ROOT = Path(__file__).parents[2]
LABORATORY = "wurtz_dodecane_direct"
TEAM = (
    f"train {LABORATORY} --roles all --rewards mixed --bc scripted --bc-steps 4000 --bc-rounds 2 --learning-rate 1e-4 "
    "--envs 64 --rollout 32 --batch-size 512 --steps 30000 --out team --quiet"
)
PATH = {
    "a moving laboratory": (f"run {LABORATORY} --record first.jsonl", "replay first.jsonl"),
    "a trained team with a curve": (TEAM, "plot runs team --out figures"),
    "a scenario of one's own": ("run my_lab.toml --policy random",),
}


def own_scenario() -> str:
    """Return the complete scenario of the page that teaches to write one."""
    page = (ROOT / "docs" / "how-to" / "scenario.md").read_text(encoding="utf-8")
    found = re.search(r"```toml\n# file: my_lab.toml\n(.*?)```", page, re.S)
    assert found is not None, "the page begins with a complete scenario"
    return found[1]


def timed(commands: list[list[str]], folder: Path) -> tuple[float, float]:
    """Return wall and processor seconds of commands."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    for command in commands:
        place = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
        subprocess.run(command, check=True, capture_output=True, cwd=folder, env=place)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begun, spent


def main() -> None:
    """Print or write a table of times."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--install", action="store_true", help="begin with a new virtual environment")
    parser.add_argument("--update", type=Path, metavar="PAGE", help="write the table into a page")
    arguments = parser.parse_args()
    lines = ["| step | wall, s | processor, s |", "|---|--:|--:|"]
    with tempfile.TemporaryDirectory() as kept:
        folder, python = Path(kept), sys.executable
        (folder / "my_lab.toml").write_text(own_scenario(), encoding="utf-8")
        steps = {name: [[python, "-m", "chemlab", *line.split()] for line in lines] for name, lines in PATH.items()}
        if arguments.install:
            new = str(folder / "env" / "bin" / "python")
            make = [[python, "-m", "venv", "env"], [new, "-m", "pip", "install", "-q", f"{ROOT}[train,plot]"]]
            steps = {"install": make} | {
                name: [[new, *command[1:]] for command in commands] for name, commands in steps.items()
            }
        for name, commands in steps.items():
            wall, spent = timed(commands, folder)
            lines.append(f"| {name} | {wall:.0f} | {spent:.0f} |")
            print(lines[-1], flush=True)
    if arguments.update:
        replace_between(arguments.update, "newcomer", lines)


if __name__ == "__main__":
    main()
