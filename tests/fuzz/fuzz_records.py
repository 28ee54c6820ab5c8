"""Records as a stranger might send them: every reader must say what is wrong with them, and none may die or hang.

Run ``python tests/fuzz/fuzz_records.py --files 5000 --seed 0`` (``--json`` for machines); ``--only N`` does file N
again and leaves it for a look. Each file is an honest record with a few mutations: of bytes, of lines, or of the
values in it, which become the numbers, texts and nestings that programs dislike. It is verified and given to the other
readers: replay page, charts, demonstrations, command line. It fails if

- a reader raises anything but ``RecordError`` or ``DataError``, or with a message that a terminal should not be given,
- a reader takes longer than ``--limit`` seconds (the process then ends with a traceback, the file stays),
- it is found right though it says something else than the record it was made from.
"""

from __future__ import annotations

import argparse
import copy
import faulthandler
import json
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from chemlab.agents.demonstrations import demonstrations
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.config.datafile import DataError
from chemlab.envs.aec import raw_env
from chemlab.record import Recorder, RecordError, read_record, verify_record
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


class Raw(str):
    """JSON text, to stand where a value stood."""


def hostile(rng: np.random.Generator, pool: list[Any]) -> Any:
    """A value that somebody might not have thought of."""
    values: list[Any] = [
        None, True, False, 0, 1, -1, 255, 2**31, 2**63, 2**64, 2**127, 10**60, 0.5, -0.5, 1e-320, 1e308, -1e308, 1e6,
        Raw("NaN"), Raw("Infinity"), Raw("-Infinity"), Raw("1e999"), Raw("-0.0"), Raw("9" * 5000), Raw('"\\ud800"'),
        "", "x", "0" * 16, "\x1b[31mred", "[/bold]", ":smile:", "\u202e", "a\nb", "$x_", "../../x", "</script>", "\0",
        "a" * 100_000, [], {}, [[]], [{}], {"": {}}, {"a": 1}, [0] * 3000, ["a"] * 300,
        dict.fromkeys(map(str, range(2000))), Raw("[" * 30 + "]" * 30), Raw("[" * 3000 + "]" * 3000),
        Raw('{"a":1,"a":2}'), Raw("[1,]"), Raw("1 2"), "posix:system", "chemlab.physics.shelf:Shelf",
    ]  # fmt: skip
    if rng.random() < 0.3:
        return copy.deepcopy(pool[rng.integers(len(pool))])
    return values[rng.integers(len(values))]


def places(value: Any) -> list[tuple[Any, Any]]:
    """(container, key) of everything inside a value."""
    found: list[tuple[Any, Any]] = []
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        found.append((value, key))
        found += places(value[key])
    return found


def descend(rng: np.random.Generator, root: Any) -> tuple[Any, Any]:
    """(container, key) of a place inside; those near the top, on which much depends, come up more often."""
    container = root
    while True:
        keys = list(container) if isinstance(container, dict) else range(len(container))
        key = keys[rng.integers(len(keys))]
        inner = container[key]
        if not isinstance(inner, (dict, list)) or not inner or rng.random() < 0.2:
            return container, key
        container = inner


def mutate_values(rng: np.random.Generator, lines: list[Any]) -> list[Any]:
    """The lines with a few values changed, most of them in the header and its scenario."""
    lines = copy.deepcopy(lines)
    for _ in range(int(rng.integers(1, 4))):
        root = lines[0] if rng.random() < 0.7 else lines[rng.integers(len(lines))]
        if root is lines[0] and rng.random() < 0.5:
            # Scenario before its materials and reactions, which have most of the values.
            data = root.get("scenario")
            root = data.get("scenario", data) if isinstance(data, dict) and rng.random() < 0.5 else data or root
        spots = places(root)
        if not spots:
            continue
        container, key = spots[rng.integers(len(spots))] if rng.random() < 0.5 else descend(rng, root)
        kind = rng.integers(6)
        value = container[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if kind == 0:
            del container[key]
        elif kind == 1 and number:
            container[key] = type(value)(value * 10.0 ** rng.integers(-3, 7))
        elif kind == 2 and number:
            container[key] = value + (int(rng.integers(-2, 3)) if isinstance(value, int) else rng.normal())
        elif kind == 3 and isinstance(container, dict):
            container[str(key) + "x" if rng.random() < 0.5 else "extra"] = container.pop(key)
        elif kind == 4 and isinstance(value, list) and value:
            value *= int(rng.choice([0, 2, 50]))
        else:
            container[key] = hostile(rng, [spot[0][spot[1]] for spot in spots])
    return lines


def to_bytes(lines: list[Any]) -> bytes:
    """Lines as a record has them; values that are :class:`Raw` stand there as they are."""
    raws: list[str] = []

    def plain(value: Any) -> Any:
        if isinstance(value, Raw):
            raws.append(str(value))
            return f"@raw{len(raws) - 1}@"
        if isinstance(value, dict):
            return {key: plain(inner) for key, inner in value.items()}
        return [plain(inner) for inner in value] if isinstance(value, list) else value

    text = "".join(json.dumps(plain(line), separators=(",", ":"), ensure_ascii=False) + "\n" for line in lines)
    for i, raw in enumerate(raws):
        text = text.replace(f'"@raw{i}@"', raw)
    return text.encode()


def mutate_lines(rng: np.random.Generator, content: bytes) -> bytes:
    """Lines gone, doubled, swapped or from elsewhere."""
    lines = content.splitlines(keepends=True)
    for _ in range(int(rng.integers(1, 4))):
        i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
        kind = rng.integers(4)
        if kind == 0 and len(lines) > 1:
            del lines[i]
        elif kind == 1:
            lines.insert(i, lines[j])
        elif kind == 2:
            lines[i], lines[j] = lines[j], lines[i]
        else:
            lines.insert(
                i, rng.choice([b"\n", b"{}\n", b"[]\n", b"null\n", b'{"end":{}}\n', b'{"end":1}\n', b"\xff\n"])
            )
    return b"".join(lines)


def mutate_bytes(rng: np.random.Generator, content: bytes) -> bytes:
    """Bytes flipped, gone, inserted; the rest cut off."""
    found = bytearray(content)
    for _ in range(int(rng.integers(1, 6))):
        # Half of them in the header, which is most of what decides.
        at = int(rng.integers(len(found) if rng.random() < 0.5 else min(len(found), 30_000)))
        kind = rng.integers(5)
        if kind == 0:
            found[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del found[at : at + int(rng.integers(1, 20))]
        elif kind == 2:
            found[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 3:
            found[at] = int(rng.choice(list(b'0123456789-eE.,:[]{}" \n')))
        elif rng.random() < 0.3:
            del found[at:]
        if not found:
            return b""
    return bytes(found)


def mutate(rng: np.random.Generator, content: bytes) -> bytes:
    """A record with a few mutations."""
    kind = rng.random()
    if kind < 0.65:
        return to_bytes(mutate_values(rng, [json.loads(line) for line in content.splitlines()]))
    return mutate_lines(rng, content) if kind < 0.8 else mutate_bytes(rng, content)


def honest(folder: Path) -> list[bytes]:
    """The records that are mutated."""
    found = []
    for name, policy, stop in SOURCES:
        env, path = raw_env(name), folder / f"{name}.jsonl"
        with Recorder(path, env.laboratories, policies={"manager_0": policy}) as recorder:
            play_episode(env, make_policies(policy, env.laboratories, 1), 1, policy, recorder=recorder)
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


@dataclass
class Report:
    """What came of a run."""

    files: int = 0
    seed: int = 0
    status: Counter[str] = field(default_factory=Counter)
    readers: Counter[str] = field(default_factory=Counter)
    """calls of each reader"""
    refused: Counter[str] = field(default_factory=Counter)
    """of these, how many ended with a readable error"""
    failures: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain Python values."""
        return {key: dict(value) if isinstance(value, Counter) else value for key, value in vars(self).items()}


def _unreadable(message: str) -> bool:
    return len(message) > _LONGEST or not message.replace("\n", "").isprintable()


def try_file(path: Path, source: bytes, rng: np.random.Generator, report: Report) -> list[str]:
    """Give a file to verification, and to one of the other readers and one command; what went wrong."""
    problems = []
    try:
        result = verify_record(path)
        report.status[result.status] += 1
        for text in (result.message, result.key, *result.notes):
            if _unreadable(text):
                problems.append(f"verify: unreadable: {text[:200]!r}")
        json.dumps(vars(result), allow_nan=False)
        if result.status in ("ok", "torn") and not says_the_same(path.read_bytes(), source):
            problems.append(f"verify: found right, and is not: {result.message}")
    except Exception:
        problems.append(f"verify: {traceback.format_exc()}")
    name = list(READERS)[rng.integers(len(READERS))]
    report.readers[name] += 1
    try:
        READERS[name](path)
    except (RecordError, DataError) as error:
        report.refused[name] += 1
        if _unreadable(str(error)):
            problems.append(f"{name}: unreadable: {str(error)[:200]!r}")
    except Exception:
        problems.append(f"{name}: {traceback.format_exc()}")
    if rng.random() < 0.1:
        command = COMMANDS[rng.integers(len(COMMANDS))]
        outcome = CliRunner().invoke(app, [*command, str(path)])
        report.readers[" ".join(command)] += 1
        if outcome.exception is not None and not isinstance(outcome.exception, SystemExit):
            trace = "".join(traceback.format_exception(outcome.exception))
            problems.append(f"{' '.join(command)}: {trace}")
        elif "\x1b" in outcome.output:
            problems.append(f"{' '.join(command)}: escapes reach the terminal: {outcome.output[:200]!r}")
    return problems


def fuzz(files: int, seed: int, folder: Path, limit: float = 60.0, only: int | None = None) -> Report:
    """Make and try files.

    Args:
        files: how many.
        seed: every file depends on it and on its own number alone.
        folder: where they are put; one that fails stays.
        limit: s after which a file counts as one that hangs; the process ends then.
        only: the number of the one file to do.
    """
    report = Report(0, seed)
    sources = honest(folder)
    for number in range(files) if only is None else [only]:
        rng = np.random.default_rng([seed, number])
        source = sources[rng.integers(len(sources))]
        path = folder / f"fuzz-{seed}-{number}.jsonl"
        path.write_bytes(mutate(rng, source))
        faulthandler.dump_traceback_later(limit, exit=True)
        problems = try_file(path, source, rng, report)
        faulthandler.cancel_dump_traceback_later()
        report.files += 1
        report.failures += [f"file {number}: {problem}" for problem in problems]
        if not problems and only is None:
            for left in folder.glob(f"{path.stem}*"):
                left.unlink()
    return report


def main() -> int:
    """Fuzz and report; 1 if something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for a file")
    parser.add_argument("--only", type=int, help="number of the one file to do")
    parser.add_argument("--json", action="store_true", help="print JSON")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="chemlab-fuzz-"))
    print(f"files that fail stay in {folder}", file=sys.stderr)
    report = fuzz(args.files, args.seed, folder, args.limit, args.only)
    values = vars(report)
    print(json.dumps(values) if args.json else "\n".join(f"{key}: {value}" for key, value in values.items()))
    return 1 if report.failures else 0


if __name__ == "__main__":
    sys.exit(main())
