"""Broken files, by the thousand: whatever is in a scenario, material, reaction, pair or starts file, in the scenario of
a record, or in what ``chemlab new`` and ``chemlab data material`` are given, either it loads or the error is a
DataError that names the file.

    python tests/fuzz/attacks.py files --tries 5000 --seed 0 --look

Each try takes a set of files that load, changes one of them (its numbers a little, its structure, its text, or a part
for the same part of another), loads it, builds its laboratory and, with ``--turns``, plays some turns at random, of
which some are not legal. What has been played is recorded, and the record must be right.
"""

import copy
import importlib.util
import json
import shutil
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from helpers import limited
from typer.testing import CliRunner

from chemlab.agents.episodes import record_episode
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.config.datafile import DataError, read_json, read_toml
from chemlab.config.draws import ORDER_QUANTITIES
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.config.materials import shipped_materials
from chemlab.config.pairs import shipped_pairs
from chemlab.envs.aec import raw_env
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.starts import lab_starts
from chemlab.record import Play, Recorder, verify_record

LONGEST_MESSAGE = 20_000

CHEM = ("values",) if importlib.util.find_spec("rdkit") else ()
"""Kinds of files that need the extra ``chem``."""
KINDS = ("scenario", "material", "reaction", "pairs", "record", "starts", "new", *CHEM)

NASTY: tuple[Any, ...] = (
    0, 1, -1, 2, 64, 65, 1e-300, 5e-324, 1e-6, 1e6, 3e8, 1e300, -0.0, 2**53, 2**63, -(2**63), 10**400,
    float("inf"), float("-inf"), float("nan"), True, False, "", " ", "x" * 5000, "\x1b[31mred", "[/bold]", ":X:",
    "../../x.toml", "/dev/zero", "/dev/zero.toml", "a\nb", "é", "\U0001f9ea", "\u2028", "a.b.c", "None", "nan",
    "chemlab:Nothing", "air", "H2", "NaCl", "Na+", "manager", "wurtz_dodecane", "lab.toml",
    [], {}, [[]], [{}], {"": 1}, {"a": {}},
    [0] * 300, ["a"] * 300, [0] * 20_000, {str(i): 1.0 for i in range(300)}, {str(i): 1.0 for i in range(20_000)},
)  # fmt: skip

NUMBERS = 20  # with the three that are none
"""Of these the first are numbers."""

TEXTS = (
    "[" * 100_000, "x = " + "[" * 3000, "x = " + "{a=" * 3000, "a." * 50_000 + "a = 1\n", "[" + "a." * 50_000 + "a]\n",
    "\x00", "x = " + "9" * 5000, "x = 1e999", "x = 0x" + "f" * 50_000, "'''", '"""', "\ufeff", "[[shelf.vessel]]\n",
    "[shelf]\n", "#" * 2_000_000,
)  # fmt: skip


NAMES = {"scenario": "lab.toml", "material": "goo.toml", "reaction": "own.toml", "pairs": "own_pairs.toml"}
LOCK = {"command": "chemlab data material 'goo'", "chemlab": "0.1.0", "rdkit": "not installed"}


class Files(NamedTuple):
    """A set of files that load, parsed, by kind."""

    scenario: dict[str, Any]
    material: dict[str, Any]
    reaction: dict[str, Any]
    pairs: dict[str, Any]


def seeds() -> list[Files]:
    """Sets of files to begin from: every shipped scenario with its family as the user's own, one that is written out,
    and one with a material and a reaction of its own, and a choice of actions."""
    goo = {key: shipped_materials()[name].model_dump(mode="json", exclude_none=True) for key, name in GOO.items()}
    goo["lock"] = LOCK
    found = []
    for name in scenario_names():
        scenario = load_scenario(name)
        family = scenario.family.model_dump(mode="json", exclude_none=True) | {"lock": LOCK}
        chosen = list((scenario.pairs or shipped_pairs()).values())[:20]
        pairs = {"lock": LOCK, "pairs": [pair.model_dump(mode="json", exclude_none=True) for pair in chosen]}
        short = read_toml(Path(scenario.origin))
        long = scenario.model_dump(mode="json", exclude_none=True) | {"material_files": ["goo.toml"]}
        own_files = {"reactions": "own.toml", "pair_files": ["own_pairs.toml"]}
        found += [Files(values | own_files, goo, family, pairs) for values in (short, long)]
    slime = {
        "reactants": {"goo": 1.0}, "products": {"slime": 1.0}, "pre_exponential": 1.0,
        "activation_energy_j_mol": 0.0, "source": "made up",
    }  # fmt: skip
    own = copy.deepcopy(found[-1])
    own.scenario["stock"]["goo"] = 1.0
    own.scenario["goals"].append("slime")
    own.reaction["reaction"].append(slime)
    for bench in own.scenario["benches"].values():
        bench |= {"actions": "discrete", "report": 0.02, "wear": {"drift": 0.02, "life": 50.0, "repair_ticks": 2}}
    for instrument in own.scenario["instruments"].values():
        instrument["drift"] = {"walk": 0.002, "price": 0.01}
    orders = [f"order_{i}" for i in range(own.scenario["orders"])]
    own.scenario["demand"] = {"order": [{"arrives": 5.0, "within": 100.0, "amount_at_least_mol": 0.1} for _ in orders]}
    own.scenario["grades"] = {"half": {"purity_at_least": 0.5, "ticks": 20}, "any": {}}
    own.scenario["world"] = {"draws": _draws(own.scenario, orders)}
    return [*found, own]


def _draws(scenario: dict[str, Any], orders: list[str]) -> dict[str, Any]:
    """A draw of every quantity of vessels, bottles, devices and orders."""
    first, near = "1-chlorohexane", {"kind": "uniform", "low": 0.9, "high": 1.0}
    halides = {"kind": "choice", "options": [first, "2-chlorohexane"]}
    bottles = {
        "label": {"what": "identity", "of": ["stock"], "material": first, "distribution": halides},
        "reagent": {"what": "titre", "of": ["stock"], "material": "goo", "inert": "dodecane", "distribution": near},
        "less": {
            "what": "amount",
            "of": ["slot_0"],
            "material": next(iter(scenario["shelf"]["vessel"][0]["contents"])),
        },
    }
    of = {"gain": scenario["benches"], "life": scenario["benches"], "bias": scenario["instruments"]}
    of |= {"trend": scenario["instruments"], **dict.fromkeys(ORDER_QUANTITIES, orders)}
    offset = {"change": "offset", "distribution": {"kind": "normal", "mean": 0.0, "sd": 1e-4, "low": 0.0, "high": 1e-3}}
    others = {what: {"what": what, "of": list(names), "distribution": near} for what, names in of.items()}
    others |= {what: others[what] | offset for what in ("bias", "trend")}
    told = {"told": list(scenario["benches"])[:1]}
    return {name: {"distribution": near} | draw | told for name, draw in (bottles | others).items()}


GOO = {"goo": "dodecane", "slime": "dodecane", "ooze": "hexane"}


def inline(value: Any) -> str:
    """A value as TOML writes it within a line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, (int, float)):
        return repr(value)
    return json.dumps(str(value)).replace("\x7f", "\\u007f")


def toml(content: dict[str, Any]) -> str:
    """A file with one line for each key."""
    return "".join(f"{json.dumps(key)} = {inline(value)}\n" for key, value in content.items())


def places(content: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of a nested structure."""
    found, left = [], [content]
    while left:
        at = left.pop()
        for key, value in list(at.items() if isinstance(at, dict) else enumerate(at)):
            found.append((at, key))
            if isinstance(value, (dict, list)):
                left.append(value)
    return found


def change(content: dict[str, Any], rng: np.random.Generator) -> None:
    """One change of structure, in place; every third of a number alone."""
    everywhere = places(content)
    numbers = [(at, key) for at, key in everywhere if type(at[key]) in (int, float) and abs(at[key]) < 1e200]
    if numbers and rng.random() < 1 / 3:
        at, key = numbers[rng.integers(len(numbers))]
        factor = float(10.0 ** rng.integers(-12, 13) if rng.random() < 0.5 else rng.lognormal())
        at[key] = NASTY[rng.integers(NUMBERS)] if rng.random() < 0.2 else at[key] * factor
        return
    if not everywhere:
        content["x"] = 1
        return
    at, key = everywhere[rng.integers(len(everywhere))]
    value = at[key]
    nasty = copy.deepcopy(NASTY[rng.integers(len(NASTY))])
    match int(rng.integers(7)):
        case 0:
            at[key] = nasty
        case 1:
            del at[key]
        case 2:
            other, where = everywhere[rng.integers(len(everywhere))]
            at[key] = copy.deepcopy(other[where]) if where in other or isinstance(other, list) else nasty
        case 3 if isinstance(at, dict):
            names = [str(k) for _, k in everywhere]
            at[names[rng.integers(len(names))] if rng.random() < 0.8 else str(nasty)[:200]] = at.pop(key)
        case 4 if isinstance(at, list):
            at.extend(copy.deepcopy(value) for _ in range(int(rng.choice([1, 3, 100, 1000]))))
        case 5:
            for _ in range(int(rng.choice([1, 3, 30, 100]))):
                value = [value] if rng.random() < 0.5 else {"a": value}
            at[key] = value
        case _:
            (at if isinstance(at, dict) else content)[str(nasty)[:200] or "x"] = copy.deepcopy(value)


def nudge(content: Any, rng: np.random.Generator) -> None:
    """A number a little larger or smaller, in place: most files load all the same, and something happens in them."""
    numbers = [(at, key) for at, key in places(content) if type(at[key]) in (int, float)]
    if numbers:
        at, key = numbers[rng.integers(len(numbers))]
        near = at[key] * float(rng.lognormal(sigma=0.7))
        at[key] = round(near) + int(rng.integers(-1, 2)) if isinstance(at[key], int) else near


def graft(content: Any, donor: Any, rng: np.random.Generator) -> None:
    """A part of another file of this kind in the same place, in place: combinations that nobody has written."""
    while isinstance(donor, dict) and isinstance(content, dict) and donor:
        keys = list(donor)
        key = keys[rng.integers(len(keys))]
        if key not in content or not isinstance(donor[key], dict) or rng.random() < 0.3:
            content[key] = copy.deepcopy(donor[key])
            return
        content, donor = content[key], donor[key]


def changed(content: dict[str, Any], donor: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A file's content with up to three changes of one of these ways."""
    content = copy.deepcopy(content)
    way = rng.random()
    for _ in range(int(rng.integers(0, 4))):
        if way < 0.3:
            nudge(content, rng)
        elif way < 0.5:
            graft(content, donor, rng)
        else:
            change(content, rng)
    return content


def scribble(text: str, rng: np.random.Generator) -> bytes:
    """One change of the text itself."""
    raw = text.encode("utf-8", "surrogatepass")
    a, b = sorted(int(x) for x in rng.integers(0, len(raw) + 1, 2))
    match int(rng.integers(6)):
        case 0:
            return raw[:a]
        case 1:
            return raw[:a] + raw[b:]
        case 2:
            return raw[:b] + raw[a:b] + raw[b:]
        case 3:
            return raw[:a] + rng.bytes(int(rng.integers(1, 9))) + raw[a:]
        case 4:
            flipped = bytearray(raw)
            for i in rng.integers(0, max(len(raw), 1), 3):
                if raw:
                    flipped[i] = rng.integers(32, 127)
            return bytes(flipped)
        case _:
            return raw[:a] + b"\n" + TEXTS[rng.integers(len(TEXTS))].encode() + raw[a:]


def write(folder: Path, base: Files) -> None:
    """A set of files."""
    for kind, name in NAMES.items():
        (folder / name).write_bytes(toml(getattr(base, kind)).encode())


def write_broken(folder: Path, kind: str, base: Files, donor: Files, rng: np.random.Generator) -> None:
    """A set of files with the one of ``kind`` changed."""
    write(folder, base)
    whole = getattr(base, kind)
    write_toml(folder / NAMES[kind], whole, changed(whole, getattr(donor, kind), rng), rng)


def write_toml(path: Path, whole: dict[str, Any], content: dict[str, Any], rng: np.random.Generator) -> None:
    """What has become of a whole file; its text is changed where nothing else was, and now and then besides."""
    text = toml(content)
    path.write_bytes(scribble(text, rng) if text == toml(whole) or rng.random() < 0.15 else text.encode())


def write_json(
    path: Path, whole: dict[str, Any], rng: np.random.Generator, donor: dict[str, Any] | None = None
) -> None:
    """A JSON file with some changes, or parts of another of its kind; as :func:`write_toml`."""
    content = changed(whole, donor or {}, rng)
    text = json.dumps(content)
    path.write_bytes(scribble(text, rng) if content == whole or rng.random() < 0.15 else text.encode())


def attempt(folder: Path, kind: str, bases: Sequence[Files], rng: np.random.Generator, turns: int) -> str:
    """One try: ``loaded`` or ``refused``.

    Raises:
        Exception: anything but a readable error: that is what is looked for.
    """
    base, donor = (bases[i] for i in rng.integers(len(bases), size=2))
    seed = int(rng.integers(2**31))
    try:
        if kind in COMMANDS:
            if not COMMANDS[kind](folder, base, donor, rng):
                return "refused"
            scenario = load_scenario(folder / "lab.toml")
        elif kind == "record":
            name, other = (scenario_names()[i] for i in rng.integers(len(scenario_names()), size=2))
            one, another = (dump_scenario(load_scenario(own)) for own in (name, other))
            write_json(folder / "dump.json", one, rng, another)
            scenario = restore_scenario(read_json(folder / "dump.json"), str(folder / "dump.json"))
        elif kind == "starts":
            scenario = recorded_starts(folder, rng)
            for bench in scenario.benches:
                lab_starts(scenario, bench)
                env = RoleEnv(scenario, bench=bench, starts="lab")
                for _ in range(turns and 2):
                    assert np.isfinite(env.reset(seed=seed)[0]).all()
                    env.step(env.action_space.sample())
        else:
            write_broken(folder, kind, base, donor, rng)
            scenario = load_scenario(folder / "lab.toml")
        again = restore_scenario(json.loads(json.dumps(dump_scenario(scenario))), str(folder))
        assert dump_scenario(again) == dump_scenario(scenario), "a restored scenario is the same"
        play(scenario, turns, seed, folder / "played.jsonl")
    except DataError as error:
        message = str(error)
        assert str(folder) in message or kind == "record", f"names no file: {message[:300]}"
        assert len(message) <= LONGEST_MESSAGE, f"a message of {len(message)} characters: {message[:300]}"
        return "refused"
    return "loaded"


def recorded_starts(folder: Path, rng: np.random.Generator) -> Any:
    """A scenario beside broken vessels that were recorded for starting states."""
    recorded = Path(load_scenario.__code__.co_filename).parents[1] / "data" / "starts" / "salt_from_oil.json"
    (folder / "lab.toml").write_text('base = "salt_from_oil"\nname = "lab"\n', encoding="utf-8")
    write_json(folder / "lab.starts.json", read_json(recorded), rng)
    return load_scenario(folder / "lab.toml")


def succeeds(folder: Path, *words: object) -> bool:
    """Whether a command does; where it does not, it has said why in words, and has left no file."""
    done = CliRunner().invoke(app, list(map(str, words)))
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert "\x1b" not in done.output
    assert len(done.output) <= LONGEST_MESSAGE
    assert done.exit_code == 0 or not (folder / "lab.toml").exists(), f"left a file: {done.output[:300]}"
    return done.exit_code == 0


def new(folder: Path, base: Files, donor: Files, rng: np.random.Generator) -> bool:
    """``chemlab new`` of a broken reaction file, with materials and pairs of one's own."""
    write_broken(folder, "reaction", base, donor, rng)
    (folder / "lab.toml").unlink()
    steps = [step for step in base.reaction["reaction"] if step["products"]]
    products = [key for step in steps for key in step["products"]] or ["water"]
    goal = products[rng.integers(len(products))]
    words = ["new", "lab", "--reactions", folder / "own.toml", "--goal", goal, "-o", folder / "lab.toml"]
    words += ["--materials", folder / "goo.toml"] if rng.random() < 0.8 else []
    return succeeds(folder, *words, *(["--pairs", folder / "own_pairs.toml"] if rng.random() < 0.8 else []))


def values(folder: Path, base: Files, donor: Files, rng: np.random.Generator) -> bool:
    """``chemlab data material`` with broken values of one's own, and a laboratory that has what comes of it."""
    own = {"anisole": {"melting_point_k": 235.65, "density_kg_l": 0.995, "source": {}}}
    own["anisole"]["source"] = dict.fromkeys(("melting_point_k", "density_kg_l"), "a handbook")
    write_toml(folder / "values.toml", own, changed(own, {"anisole": donor.material["goo"]}, rng), rng)
    made = folder / "made.toml"
    if not succeeds(folder, "data", "material", "anisole", "--values", folder / "values.toml", "-o", made):
        assert not made.exists()
        return False
    (folder / "lab.toml").write_text('base = "crude"\nname = "lab"\nmaterial_files = ["made.toml"]\n', encoding="utf-8")
    return True


COMMANDS: dict[str, Callable[[Path, Files, Files, np.random.Generator], bool]] = {"new": new, "values": values}
"""Kinds of files that a command makes scenarios of."""


def play(scenario: Any, turns: int, seed: int, path: Path) -> None:
    """Build the laboratory, and play that many random turns in it, a tenth of them of any action, or until reactions
    are too stiff. Every number that comes of it is finite, and its record is right."""
    env = raw_env(scenario)
    if not turns:
        return
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    with Recorder(path, env.laboratories) as recorder:
        recorder.begin(seed)
        for agent in env.agent_iter(turns):
            observation, reward, terminated, truncated, info = env.last()
            assert observation is not None
            assert np.isfinite(observation).all(), f"{agent} sees what is no number"
            assert np.isfinite(reward), f"{agent} is paid what is no number"
            if terminated or truncated:
                env.step(None)
                continue
            mask, space = info.get("action_mask"), env.action_space(agent)
            among = np.arange(len(mask)) if mask is not None and rng.random() < 0.1 else mask
            action = rng.random(space.shape) if mask is None else int(rng.choice(np.flatnonzero(among)))
            try:
                env.step(action)
            except ArithmeticError as error:
                if type(error) is not ArithmeticError:  # words of ours: too stiff
                    raise
                break
            recorder.turn([Play(env.possible_agents.index(agent), observation, mask, action)])
    found = verify_record(path if path.exists() else recorder.part)
    assert found.status in ("ok", "torn", "foreign"), f"an honest record is {found.status}: {found.message}"


def campaign(
    kinds: Sequence[str], one: Callable[[Path, str, np.random.Generator], str], files: int, seed: int, keep: Path | None
) -> tuple[Counter[str], list[str]]:
    """Try ``files`` broken files, each of its kind in turn, each with its own random numbers.

    Args:
        kinds: kinds of files.
        one: makes a file of a kind in a folder and reads it; what came of it in a word.
        files, seed: how many, and which.
        keep: folder for those that failed.

    Returns:
        How many came out how, by kind; and a traceback of every exception, with its number.
    """
    outcomes, failures = Counter[str](), []
    for number in range(files):
        rng, kind = np.random.default_rng([seed, number]), kinds[number % len(kinds)]
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            try:
                with limited(20):
                    said = one(folder, kind, rng)
                outcomes[f"{kind}: {said}"] += 1
            except Exception:
                outcomes[f"{kind}: failed"] += 1
                failures.append(f"--- {seed}/{number} ({kind})\n{traceback.format_exc()[-3000:]}")
                if keep is not None:
                    shutil.copytree(folder, keep / f"{seed}-{number}", dirs_exist_ok=True)
    return outcomes, failures


def fuzz(files: int, seed: int, turns: int = 0, keep: Path | None = None) -> tuple[Counter[str], list[str]]:
    """A :func:`campaign` of scenarios and what they are made of; ``turns`` are played where they load."""
    bases = seeds()
    with tempfile.TemporaryDirectory() as folder:
        for name in ("wurtz_two_lines", "failing", "wurtz_real", "recrystallization", "runaway") if turns else ():
            # Compiles kernels, which must not count as a hang: these scripted episodes need all of them.
            env, path = raw_env(name), Path(folder) / f"{name}.jsonl"
            record_episode(path, env, make_policies("scripted", env.laboratories, 0), 0)
            assert verify_record(path).status == "ok"

    def one(folder: Path, kind: str, rng: np.random.Generator) -> str:
        return attempt(folder, kind, bases, rng, turns)

    return campaign(KINDS, one, files, seed, keep)
