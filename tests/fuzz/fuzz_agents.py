"""Broken files about agents, by the thousand: whatever is in a policy's card or weights, a file of plans, a training
run's folder, a sweep or a configuration, either it is read or the error is a ValueError that names the file.

    python tests/fuzz/attacks.py agents --tries 5000 --seed 0 --look

Each try takes a file that is read, changes it as ``fuzz_files.py`` does, in its structure or in its text, and gives it
to everything that reads such files: a policy that loads plays, a run is put into tables, its task looked for.
"""

import json
import shutil
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save, save_file

sys.path.insert(0, str(Path(__file__).parent.parent))

from fuzz_files import LONGEST_MESSAGE, campaign, change, changed, scribble, write_json, write_toml
from run_files import write_run

import chemlab.agents.pretrained
from chemlab.agents.evaluate.benchmark import find_rows
from chemlab.agents.evaluate.jobs import AuditBudget, Job, JobRunner, _policy_hash
from chemlab.agents.evaluate.leaderboard import check_leaderboard, write_leaderboard
from chemlab.agents.evaluate.results import cells_of, group_runs, read_runs
from chemlab.agents.open_loop import plan_for, stored_plans
from chemlab.agents.policies import agent_policy, bench_policy
from chemlab.agents.pretrained import LSTM, load_pretrained
from chemlab.agents.runs import Run
from chemlab.agents.train.arguments import load_arguments
from chemlab.agents.train.sweep import plan, status_of
from chemlab.config.loading import load_scenario
from chemlab.config.parts import strangers_code
from chemlab.lab.engine import Laboratories

MODELS = Path(chemlab.agents.pretrained.__file__).parent / "models"
NAME, SCENARIO, MEMORY = "fictitious_rxn", "fictitious", 3

SWEEP: dict[str, Any] = {
    "defaults": {"envs": 2, "steps": 64, "gamma": 0.9, "net_arch": [8, 8]},
    "runs": [
        {"scenario": ["chemlab/WurtzReaction-v0", "chemlab/FictitiousReaction-v0"], "algo": ["ppo", "sac"], "seeds": 2},
        {"scenario": "salt_from_oil", "bench": "ext", "name": "lab", "starts": "both"},
        {"roles": "manager", "preset": "manager", "seeds": [1, 5], "curriculum": ["20: ext=0.5", "40: submit=1"]},
    ],
}
CONFIGURATIONS: list[dict[str, Any]] = [
    {
        "scenario": "chemlab/WurtzExtraction-v0",
        "algo": "ppo",
        "steps": 1000,
        "gamma": 0.9,
        "clip_range": 0.1,
        "gae_lambda": 0.9,
        "ent_coef": 0.01,
        "net_arch": [64, 64],
        "goals": ["dodecane"],
        "learning_rate": 1e-3,
    },
    {"scenario": "wurtz_dodecane", "roles": ["manager", "ext"], "regime": "in-turns", "envs": 3},
    {"scenario": "wurtz_dodecane", "bench": "rxn", "algo": "sac", "buffer_size": 512, "batch_size": 32},
]
CURVE = [(100, 0.1, 0.2), (200, 0.4, 0.2), (300, None, None)]


@cache
def laboratory(scenario: str) -> Laboratories:
    """One laboratory."""
    return Laboratories(load_scenario(scenario))


def act(policy: Any, size: int, mask: Any = None) -> None:
    """Let a policy choose; whatever it has learned, actions are numbers."""
    nothing = np.zeros(3, dtype=np.int64)
    with np.errstate(all="ignore"):  # weights as large as a float holds
        policy.act(np.zeros((3, size), dtype=np.float32), mask, nothing, nothing)


def try_card(folder: Path, rng: np.random.Generator) -> None:
    """A card beside good weights: of a network, or of one with a memory."""
    card = json.loads((MODELS / f"{NAME}.json").read_text())
    if rng.random() < 0.5:
        shutil.copy(MODELS / f"{NAME}.safetensors", folder / "a.safetensors")
    else:
        card |= {"algo": "recurrent-ppo", "memory": MEMORY}
        save_file(remembering(card["observation_size"], card["action_size"]), folder / "a.safetensors")
    write_json(folder / "a.json", card, rng)
    bench = laboratory(SCENARIO).benches[0]
    bench_policy(str(folder / "a.json"), bench)
    act(load_pretrained(folder / "a"), bench.observation_space.shape[0])


def remembering(seen: int, actions: int) -> dict[str, Any]:
    """Weights of a network with a memory."""
    rng = np.random.default_rng(0)
    sizes = {"O": seen, "H": MEMORY, "4H": 4 * MEMORY}
    shapes = {name: tuple(sizes[axis] for axis in shape) for name, shape in LSTM.items()}
    shapes |= {"0.weight": (actions, MEMORY), "0.bias": (actions,)}
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def try_weights(folder: Path, rng: np.random.Generator) -> None:
    """Weights that are not what the card says: header, numbers or text changed."""
    card = json.loads((MODELS / f"{NAME}.json").read_text())
    content = (MODELS / f"{NAME}.safetensors").read_bytes()
    if rng.random() < 0.5:
        card |= {"memory": MEMORY}
        content = save(remembering(card["observation_size"], card["action_size"]))
    (folder / "a.json").write_text(json.dumps(card))
    size = int.from_bytes(content[:8], "little")
    header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
    if rng.random() < 0.6:
        change(header, rng)
    text = json.dumps(header).encode()
    whole = (len(text) if rng.random() < 0.8 else int(rng.integers(2**40))).to_bytes(8, "little") + text + data
    if rng.random() < 0.4:
        whole = scribble(whole.decode("latin-1"), rng)
    (folder / "a.safetensors").write_bytes(whole)
    act(load_pretrained(folder / "a"), load_pretrained(folder / "a").card.observation_size)


def try_plan(folder: Path, rng: np.random.Generator) -> None:
    """A file of plans, played."""
    files = stored_plans()
    source = files[rng.integers(len(files))]
    write_json(folder / "plans.json", json.loads(source.read_text()), rng)
    labs = laboratory(source.name.partition(".")[0])
    mask = labs.mask(0, labs.members)
    assert mask is not None
    act(plan_for(labs, file=str(folder / "plans.json")), labs.observation_sizes[0], np.repeat(mask, 3, axis=0))


def write_finished(folder: Path, manager: bool, seed: int = 0) -> Run:
    """A finished run of a bench or a manager, with exported weights in its checkpoint."""
    more = {"background": "pretrained", "final_episodes": 10, "env_id": "chemlab/FictitiousReaction-v0", "algo": "ppo"}
    more["arguments"] = {"scenario": "fictitious", "bench": "rxn", "algo": "ppo"}
    bench = ("wurtz_dodecane", "manager_0") if manager else (SCENARIO, "rxn")
    returns = {"dodecane": 0.5, "hexane": 0.4}
    path = write_run(folder / "task" / "run", *bench, returns, seed=seed, curve=CURVE, evaluations={100: 0.1}, **more)
    run = Run(path)
    best = run.checkpoints / "best-5"
    best.mkdir(parents=True)
    for ending in (".json", ".safetensors"):
        shutil.copy(MODELS / f"{NAME}{ending}", best / f"rxn{ending}")
    return run


def try_run(folder: Path, rng: np.random.Generator) -> None:
    """A run's folder: configuration, curve, evaluations, result; and exported weights in its checkpoint."""
    run = write_finished(folder, bool(rng.random() < 0.5))
    file = [run.config_file, run.result_file, run.curve_file, run.evaluations_file][rng.integers(4)]
    if file.suffix == ".json":
        write_json(file, json.loads(file.read_text()), rng)
    else:
        lines = file.read_text().splitlines()
        at = int(rng.integers(len(lines)))
        write_json(file, json.loads(lines[at]), rng)
        lines[at] = file.read_bytes().decode("utf-8", "surrogateescape").replace("\n", " ")
        file.write_bytes(("\n".join(lines) + "\n").encode("utf-8", "surrogateescape"))
    cells_of(group_runs(read_runs(folder)))
    run.rewind(150)
    agent_policy(str(run.path), laboratory(SCENARIO), 0)
    from chemlab.agents.train.arguments import recorded_arguments

    config = run.config()
    assert config is not None
    recorded_arguments(config, str(run.config_file))


def try_sweep(folder: Path, rng: np.random.Generator) -> None:
    """A sweep: what is planned, where it stands, and how it is doing."""
    write_toml(folder / "sweep.toml", SWEEP, changed(SWEEP, SWEEP, rng), rng)
    out = folder / "out"
    for one in plan(folder / "sweep.toml", out)[:20]:
        assert one.run.path.resolve().is_relative_to(out.resolve()), "a run would stand somewhere else"
        status_of(one)


def try_configuration(folder: Path, rng: np.random.Generator) -> None:
    """A configuration of a command."""
    given, donor = (CONFIGURATIONS[i] for i in rng.integers(len(CONFIGURATIONS), size=2))
    write_toml(folder / "own.toml", given, changed(given, donor, rng), rng)
    arguments = load_arguments(folder / "own.toml", {})
    arguments.command_line()
    arguments.folder()


def try_rows(folder: Path, rng: np.random.Generator) -> None:
    """A folder of runs as a row of a benchmark."""
    manager = bool(rng.random() < 0.5)
    for seed in (0, 1):
        run = write_finished(folder / f"seed-{seed}", manager, seed)
        shutil.copytree(run.checkpoints / "best-5", run.checkpoints / "last-9")
        if seed:
            write_json(run.config_file, json.loads(run.config_file.read_text()), rng)
    for row in find_rows([str(folder)]):
        assert np.isfinite(row.hours or 0.0)
        json.dumps([row.name, row.curves], allow_nan=False)


def try_leaderboard(folder: Path, rng: np.random.Generator) -> None:
    """A benchmark's leaderboard, to which lines are added."""
    line: dict[str, Any] = {"scenario": "failing", "scenario_hash": "0" * 16, "policy": "scripted", "value": 0.5}
    line |= {"scores": [0.5, None], "train_scores": [0.1, 0.2], "runs": 2, "seeds": 2, "episodes": 1, "score": 0.5}
    line |= {"low": 0.4, "high": None, "split": "test", "records": [{"file": "records/a.jsonl", "seed": 1}]}
    line["scale"] = {"random": 0.0, "oracle": 1.0}
    board = {"kind": "leaderboard", "format": 1, "lines": [line, {**line, "value": None}, {**line, "policy": "a"}]}
    write_json(folder / "leaderboard.json", board, rng)
    write_leaderboard(folder / "leaderboard.json", [])
    check_leaderboard(folder / "leaderboard.json")
    json.dumps(json.loads((folder / "leaderboard.json").read_text()), allow_nan=False)


def try_part(folder: Path, rng: np.random.Generator) -> None:
    """A finished part of an audit or a benchmark: one that is not as it was written is played again."""
    runner = JobRunner(
        laboratory(SCENARIO).scenario, AuditBudget(episodes=3, plans=1, fewer=1, donors=1, planned=1), folder
    )
    job = Job("a", "everybody", {})
    result = {"scores": [0.0, 0.5, 1.0], "teams": [[["G"], [1, 2], [None, [[[0.5, 1.0]]]]]], "chosen": [0.0]}
    write_json(folder / "a.json", {"stamp": runner._stamp(job, _policy_hash(job), result), "result": result}, rng)
    kept = runner.cached(job)
    if kept is None:
        raise ValueError(f"{folder}: is played again")
    assert kept == result


TRIES: dict[str, Callable[[Path, np.random.Generator], None]] = {
    "card": try_card,
    "weights": try_weights,
    "plan": try_plan,
    "run": try_run,
    "sweep": try_sweep,
    "configuration": try_configuration,
    "rows": try_rows,
    "leaderboard": try_leaderboard,
    "part": try_part,
}


def attempt(folder: Path, kind: str, rng: np.random.Generator) -> str:
    """One try: ``loaded`` or ``refused``.

    Raises:
        Exception: anything but a readable error: that is what is looked for.
    """
    try:
        with warnings.catch_warnings(), strangers_code(False):
            warnings.simplefilter("ignore")
            TRIES[kind](folder, rng)
    except ValueError as error:
        message, library = str(error), type(error).__module__
        assert str(folder) in message or "does not fit" in message, f"names no file: {message[:300]}"
        assert len(message) <= LONGEST_MESSAGE, f"a message of {len(message)} characters: {message[:300]}"
        assert library.startswith(("builtins", "chemlab")), f"of another library: {library}: {message[:300]}"
        return "refused"
    return "loaded"


def fuzz(files: int, seed: int, turns: int = 0, keep: Path | None = None) -> tuple[Counter[str], list[str]]:
    """A campaign of files about agents; nothing takes ``turns``."""
    return campaign(tuple(TRIES), attempt, files, seed, keep)
