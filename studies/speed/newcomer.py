"""Time of a newcomer's first steps: install, a moving laboratory, a trained team with its curve, an added scenario.

    python studies/speed/newcomer.py --update docs/getting-started.md

Every step runs in a new clone of the last commit, in a new virtual environment and with an empty kernel cache. Wall
time includes downloads and depends on what else the machine does; processor time (summed over processes) does less.
"""

from __future__ import annotations

import argparse
import functools
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from report import arguments, children_seconds, report

ROOT = Path(__file__).parents[2]
STEPS = {
    "install": ("python -m pip install .",),
    "first episode, which compiles the kernels": ("chemlab run wurtz_dodecane --record first.jsonl",),
    "replay page of the episode": ("chemlab replay first.jsonl -o first.html",),
    "install the learners": ("python -m pip install TORCH .[train,plot]",),
    "train a team from nothing": ("chemlab train wurtz_dodecane --roles all --steps 500000 --out runs/team --quiet",),
    "its curve, and an episode of it": (
        "chemlab plot curves runs/team -o curve.png",
        "chemlab run wurtz_dodecane --policy runs/team",
    ),
    "a scenario of your own, checked and played": (
        "chemlab check my_lab.toml",
        "chemlab run my_lab.toml --policy random",
    ),
    "train in it": ("chemlab train my_lab.toml --bench rxn --goals dodecane --steps 20000 --out runs/mine --quiet",),
}
"""Steps and their commands; ``my_lab.toml`` is the first block of ``docs/how-to/scenario.md``."""


def run(commands: tuple[str, ...], folder: Path, torch: str) -> None:
    """Run commands in the clone."""
    programs = str(folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin"))
    # Nothing of this process's environment is found, and no kernels are.
    given = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    given |= {"PATH": os.pathsep.join((programs, given["PATH"])), "NUMBA_CACHE_DIR": str(folder / "kernels")}
    for command in commands:
        words = [torch if word == "TORCH" else word for word in command.split()]
        done = subprocess.run(words, cwd=folder / "chemlab", env=given, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{' '.join(words)}: {done.stdout[-2000:]}{done.stderr[-2000:]}")


def measure(torch: str) -> list[str]:
    """Return the table of steps."""
    lines = ["| step | wall (s) | processor (s) |", "|---|--:|--:|"]
    total = [0.0, 0.0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(["git", "clone", "-q", str(ROOT), str(folder / "chemlab")], check=True)
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        page = (folder / "chemlab" / "docs" / "how-to" / "scenario.md").read_text(encoding="utf-8")
        block = re.search(r"^```toml\n(# file: my_lab\.toml\n.*?)^```", page, re.S | re.M)
        assert block is not None, "the page has the scenario"
        (folder / "chemlab" / "my_lab.toml").write_text(block[1], encoding="utf-8")
        for step, commands in STEPS.items():
            wall, processor = children_seconds(functools.partial(run, commands, folder, torch))
            total = [total[0] + wall, total[1] + processor]
            lines.append(f"| {step} | {wall:.0f} | {processor:.0f} |")
            print(lines[-1], flush=True)
    return [*lines, f"| together | {total[0]:.0f} | {total[1]:.0f} |", "", f"Load average {os.getloadavg()[0]:.1f}."]


def main() -> None:
    """Print the table, and write it into a page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--torch", default="torch", help="PyTorch as pip is given it, for instance torch==2.13.0")
    given = arguments(parser)
    table = measure(given.torch)
    report(given, table, {"newcomer": table})


if __name__ == "__main__":
    main()
