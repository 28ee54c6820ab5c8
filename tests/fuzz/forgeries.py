"""Forges records in the ways that once worked (``attacks.py forgeries --tries 20``), and counts how they are taken."""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from chemlab.agents.episodes import record_episode
from chemlab.agents.policies import make_policies
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.envs.aec import raw_env
from chemlab.record import verify_record

NUMBERS = ("Infinity", "-Infinity", "NaN", "1e999", "-1e999", "1" + "0" * 60)

Lines = list[str]


def store(path: Path, lines: Lines) -> Path:
    """Write lines."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def text_of(value: dict[str, Any]) -> str:
    """A line as a recorder writes it."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def record(
    path: Path, scenario: Any, seed: int, policy: str = "random", options: dict[str, Any] | None = None
) -> Lines:
    """An honest episode's lines."""
    env = raw_env(scenario)
    record_episode(path, env, make_policies(policy, env.laboratories, seed), seed, options=options, force=True)
    return path.read_text(encoding="utf-8").splitlines()


def cut_short(lines: Lines, path: Path) -> Iterator[Path]:
    """The first turns, and an end that says what verification itself says should stand there."""
    most = len(lines) - 3  # one turn is missing
    for turns in sorted({turns for turns in (1, 10, most // 2, most) if 0 <= turns <= most}):
        end = json.loads(lines[-1])
        for _ in range(60):
            found = verify_record(store(path, [*lines[: turns + 1], text_of(end)]))
            keys = found.key.split(".")
            if found.where != "end" or len(keys) < 2:
                break
            inner: Any = end
            for key in keys[:-1]:
                inner = inner[int(key)] if isinstance(inner, list) else inner[key]
            if found.recomputed is None:
                inner.pop(keys[-1], None)
            else:
                inner[int(keys[-1]) if isinstance(inner, list) else keys[-1]] = found.recomputed
        yield path


def impossible_numbers(lines: Lines, path: Path) -> Iterator[Path]:
    """A score that is no number, of an episode that was played here, or elsewhere."""
    header = json.loads(lines[0])
    header["environment"]["machine"] = "abacus"
    score = json.dumps(json.loads(lines[-1])["end"]["score"])
    for first in (lines[0], text_of(header)):
        for number in NUMBERS:
            yield store(path, [first, *lines[1:-1], lines[-1].replace(f'"score":{score}', f'"score":{number}')])


def other_spellings(lines: Lines, path: Path) -> Iterator[Path]:
    """Keys twice, keys that mean nothing, numbers written otherwise: readers may differ about what they read."""
    last, seed = len(lines) - 1, f'"seed":{json.loads(lines[0])["seed"]}'
    spellings = [(0, seed, new) for new in (f'{seed},"audited":true', f'"note":"audited",{seed}', f"{seed},{seed}")]
    spellings += [(0, seed, f'"seed":{new}') for new in (f"0,{seed}", f"{seed[7:]}.0", "true", 2**128)]
    spellings += [(0, '"rounds":false', '"rounds":0'), (1, '"tick":', '"tick":0,"tick":')]
    spellings += [(last, '"score":', new) for new in ('"score":1.0,"score":', '"score": ')]
    backwards = {"end": dict(reversed(json.loads(lines[-1])["end"].items()))}
    spellings += [(last, '"turns":', '"turns":1e0,"turns":'), (last, lines[-1], text_of(backwards))]
    for number, old, new in spellings:
        yield store(path, [*lines[:number], lines[number].replace(old, new, 1), *lines[number + 1 :]])


def easier_scenario(lines: Lines, path: Path) -> Iterator[Path]:
    """Played honestly, where half as much counts as everything; under the shipped name, and under another."""
    header = json.loads(lines[0])
    shipped = header["scenario"]["scenario"]["name"]
    for name in (shipped, "house_rules"):
        data = json.loads(json.dumps(dump_scenario(load_scenario(shipped))))
        data["scenario"]["name"] = name
        data["scenario"]["theoretical_maximum_mol"] = {
            goal: mol / 2 for goal, mol in data["scenario"]["theoretical_maximum_mol"].items()
        }
        yield store(path, record(path, restore_scenario(data, "easier"), header["seed"], "scripted"))


def paid_more(lines: Lines, path: Path) -> Iterator[Path]:
    """The first reward of each agent higher, or as high as if it had not been charged, in the turn and in all sums."""
    end, seen = json.loads(lines[-1]), set()
    for number, line in enumerate(lines[1:-1], start=1):
        for agent, reward in json.loads(line).get("rewards", {}).items():
            if agent in seen or not reward:
                continue
            seen.add(agent)
            for paid in (reward + 0.25, abs(reward)):
                if paid == reward:
                    continue
                turn, closing = json.loads(line), json.loads(json.dumps(end))
                turn["rewards"][agent] = paid
                closing["end"]["rewards"][agent] += paid - reward
                closing["end"]["score"] += paid - reward
                texts = text_of(turn), text_of(closing)
                yield store(path, [*lines[:number], texts[0], *lines[number + 1 : -1], texts[1]])


def invented_world(lines: Lines, path: Path) -> Iterator[Path]:
    """Played honestly in a world that was asked for; then nothing was asked, and the seed is not known."""
    header = json.loads(lines[0])
    world = header["hidden"].get("world")
    if not world or not world["values"]:
        return
    values = json.loads(record(path, header["scenario"]["scenario"]["name"], header["seed"] + 1)[0])
    options = {"world": values["hidden"]["world"]["values"]}
    asked = record(path, header["scenario"]["scenario"]["name"], header["seed"], "scripted", options)
    for seed in (None, header["seed"]):
        forged = json.loads(asked[0])
        forged |= {"seed": seed, "options": {}}
        yield store(path, [text_of(forged), *asked[1:]])


def forge(seeds: int, folder: Path, scenario: str = "wurtz_dodecane") -> dict[str, Counter[str]]:
    """How often each forgery was tried, and how it was taken: by status of its verification."""
    found: dict[str, Counter[str]] = {}
    for seed in range(seeds):
        lines = record(folder / "honest.jsonl", scenario, seed)
        for forgery in (cut_short, impossible_numbers, other_spellings, easier_scenario, paid_more, invented_world):
            counter = found.setdefault(forgery.__name__, Counter())
            for path in forgery(lines, folder / "forged.jsonl"):
                counter[verify_record(path).status] += 1
    return found
