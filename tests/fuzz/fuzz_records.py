"""Records as a stranger might send them: every reader must say what is wrong with them, and none may die or hang.

    python tests/fuzz/attacks.py records --tries 5000 --seed 0 --look

Each file is an honest record with a few changes: of the values in it, of its lines, or of its text. It is verified and
given to the other readers: replay page, charts, demonstrations, command line. It fails if

- a reader raises anything but ``RecordError`` or ``DataError``, or with a message that a terminal should not be given,
- all of them together take too long,
- it is found right though it says something else than the record it was made from.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_files import campaign, change, scribble
from typer.testing import CliRunner

from chemlab.agents.demonstrations import demonstrations
from chemlab.agents.episodes import record_episode
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.config.datafile import DataError
from chemlab.envs.aec import raw_env
from chemlab.record import RecordError, read_record, verify_record
from chemlab.render.charts import draw_moles, draw_spectra, draw_timeline
from chemlab.render.replay_page import replay_page

SOURCES = (
    ("salt_from_oil", "scripted", None), ("wurtz_dodecane", "random", 40), ("wurtz_safe", "scripted", 25),
    ("failing", "scripted", 40), ("rush", "random", 30), ("relay", "scripted", 30), ("crude", "scripted", 20),
)  # fmt: skip
"""Scenario, policy, and after how many lines the record is torn: short ones, so that many can be tried. Between them
they have every kind of table: wear, drift, orders over time, grades, what benches are told and report, a tier of its
own."""
CLAIMS = ("policies", "environment")
"""Keys of the header that a record which is found right may have otherwise."""
READERS: dict[str, Callable[[Path], Any]] = {
    "replay": lambda path: replay_page(read_record(path)),
    "timeline": lambda path: draw_timeline(read_record(path)),
    "spectra": lambda path: draw_spectra(read_record(path)),
    "moles": lambda path: draw_moles(read_record(path)),
    "demonstrations": lambda path: demonstrations(read_record(path)),
}
COMMANDS = (["verify"], ["verify", "--json"], ["replay", "--force"], ["plot", "timeline", "--force"])
_LONGEST = 1500
"""characters of a message"""


def within(table: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A table, or one inside it: uppermost ones, on which much depends, have few values."""
    inner = [value for value in table.values() if isinstance(value, dict) and value]
    return within(inner[rng.integers(len(inner))], rng) if inner and rng.random() < 0.6 else table


def mutate_values(content: bytes, rng: np.random.Generator) -> bytes:
    """A few values changed, most of them in the header and its scenario."""
    lines = [json.loads(line) for line in content.splitlines()]
    for _ in range(int(rng.integers(1, 4))):
        change(within(lines[0] if rng.random() < 0.7 else lines[rng.integers(len(lines))], rng), rng)
    return "".join(json.dumps(x, separators=(",", ":"), ensure_ascii=False) + "\n" for x in lines).encode()


def mutate_lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Lines gone, doubled, swapped or from elsewhere."""
    lines = content.splitlines(keepends=True)
    strange = [b"\n", b"{}\n", b"[]\n", b"null\n", b'{"end":{}}\n', b'{"end":1}\n', b"\xff\n"]
    for _ in range(int(rng.integers(1, 4))):
        i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
        kind = rng.integers(4)
        if kind == 0 and len(lines) > 1:
            del lines[i]
        elif kind == 1:
            lines[i], lines[j] = lines[j], lines[i]
        else:
            lines.insert(i, lines[j] if kind == 2 else strange[rng.integers(len(strange))])
    return b"".join(lines)


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """A record with a few changes."""
    kind = rng.random()
    if kind < 0.65:
        return mutate_values(content, rng)
    return mutate_lines(content, rng) if kind < 0.8 else scribble(content.decode(), rng)


def honest(folder: Path) -> list[bytes]:
    """The records that are mutated."""
    found = []
    for name, policy, stop in SOURCES:
        env, path = raw_env(name), folder / f"{name}.jsonl"
        record_episode(path, env, make_policies(policy, env.laboratories, 1), 1, policy)
        found.append(b"".join(path.read_bytes().splitlines(keepends=True)[:stop]))
    return found


def says_the_same(content: bytes, source: bytes) -> bool:
    """Whether a record differs from its source in nothing but claims, in what has been cut off, or in actions, of which
    others may lead to the same numbers (more of a reagent that is used up)."""
    if not content.endswith(b"\n"):  # the last line is torn
        content = content[: content.rfind(b"\n") + 1]
    lines, originals = content.splitlines(), source.splitlines()
    header, original = json.loads(lines[0]), json.loads(originals[0])
    for key in CLAIMS:
        header.pop(key), original.pop(key)
    return header == original and list(map(_results, lines[1:])) == list(map(_results, originals[1 : len(lines)]))


def _results(line: bytes) -> Any:
    turn = json.loads(line)
    return {**turn, "play": {agent: entry[0] for agent, entry in turn.get("play", {}).items()}}


def check_readable(text: str) -> None:
    """What is said is short, and steers no terminal."""
    assert len(text) <= _LONGEST, f"a message of {len(text)} characters: {text[:200]!r}"
    assert text.replace("\n", "").isprintable(), f"unreadable: {text[:200]!r}"


def attempt(folder: Path, sources: list[bytes], rng: np.random.Generator) -> str:
    """Give a changed record to verification, and to one of the other readers and one command; its verdict.

    Raises:
        Exception: anything but a readable error: that is what is looked for.
    """
    source, path = sources[rng.integers(len(sources))], folder / "a.jsonl"
    path.write_bytes(mutate(source, rng))
    result = verify_record(path)
    for text in (result.message, result.key, *result.notes):
        check_readable(text)
    json.dumps(vars(result), allow_nan=False)
    if result.status in ("ok", "torn"):
        assert says_the_same(path.read_bytes(), source), f"found right, and is not: {result.message}"
    try:
        list(READERS.values())[rng.integers(len(READERS))](path)
    except (RecordError, DataError) as error:
        check_readable(str(error))
    if rng.random() < 0.1:
        done = CliRunner().invoke(app, [*COMMANDS[rng.integers(len(COMMANDS))], str(path)])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert "\x1b" not in done.output, f"escapes reach the terminal: {done.output[:200]!r}"
    return result.status


def fuzz(files: int, seed: int, turns: int = 0, keep: Path | None = None) -> tuple[Counter[str], list[str]]:
    """A campaign of records, by verdict; nothing takes ``turns``."""
    with tempfile.TemporaryDirectory() as folder:
        sources = honest(Path(folder))
    return campaign(("record, verified",), lambda folder, _, rng: attempt(folder, sources, rng), files, seed, keep)
