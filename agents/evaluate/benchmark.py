"""Protocol of ``chemlab benchmark``: policies, episodes, scale and statistics.

Every row (a policy) plays the same episodes of each scenario, in worlds of the split ``test``. Episodes and scale are
those of :mod:`~chemlab.agents.evaluate.audit`: 0 is random legal play, 1 the oracle. The episodes are divided into
replications. Each replication has separate worlds, and a separate training run if a row has several (a folder of runs
that differ in their seeds); those of one run count as one. Statistics are over replications: interquartile mean,
performance profile and probability of improvement over the baseline, with 95 % intervals
(:mod:`~chemlab.agents.evaluate.statistics`). The interval of a cell is over its episodes, or over runs if several runs
have played them.

| row | policy |
|---|---|
| ``random`` | random legal actions of all agents: 0 |
| ``plan`` | the manager's best open-loop plan found in training worlds, over scripted benches |
| ``scripted`` | the scripted agents |
| ``pretrained``, ``trained`` | bundled policies, if one fits |
| a path | a training run, or a folder of runs that differ only in their seed: the best checkpoint by validation, the \
last, and, of runs that began as clones, the first, before training; or records of these episodes, a file or a folder, \
that people (``chemlab play``) or language agents (such as ``chemlab mcp``) have played |
| ``oracle`` | the planner that knows the hidden parameters: 1 |

| file | content |
|---|---|
| ``parts/SCENARIO/`` | cached results, from which the same command resumes |
| ``benchmark.json`` | results of :func:`benchmark` |
| ``marl_eval.json`` | normalized scores of each run, in marl-eval's format |
| ``leaderboard.json`` | a line for each row and scenario, with the scores of its episodes, commit, versions, \
hardware, hours and records (:mod:`~chemlab.agents.evaluate.leaderboard`) |
| ``records/`` | episodes of each row, which ``chemlab verify`` replays |

Lines of other commands in the leaderboard are kept, unless they are of the same row and scenario. If a policy scored
above the oracle, in this command or an earlier one, all lines of the same episodes get the scale with this end.
"""

from __future__ import annotations

import os
import platform
import subprocess
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.files import write_json, write_text
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.config.parts import trust
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.aec import raw_env
from chemlab.kernels.arrays import FloatArray
from chemlab.record import Record, read_record, recorded_scenario, scenario_hash, verify_record

from ..episodes import record_episode
from ..former_names import current_name, split_way
from ..ledger import ended_episodes
from ..open_loop import ConstantPlan
from ..policies import make_policies, policy_names
from ..runs import Run, differences, find_runs, versions
from . import statistics
from .jobs import AUDIT_SEED, AuditBudget, Job, JobRunner, budget_of, foreseen, planner_jobs
from .leaderboard import on_scale, runs_of, write_leaderboard
from .play import Target
from .scale import missing

DEFAULT_ROWS = ("scripted", "pretrained", "trained")
"""Policies that are always played, in addition to the references."""
REFERENCES = ("random", "plan", "oracle")
"""Rows of every benchmark."""
_LINE_KEYS = (
    *("value", "low", "high", "score", "episodes", "scale", "generalization", "over_baseline"),
    *("scores", "train_scores", "seats", "reason"),
)
"""Keys of a cell that are written to the leaderboard."""
_CONDITIONS = ("condition", "names", "say", "budget")
"""Conditions of seats, which are equal in all episodes of a row."""
_EFFORT = ("calls", "wrong", "characters", "tokens")
"""Measures of a seat's effort that are reported with the score."""
_RECORD = ".jsonl"
"""Suffix of record files."""
_THRESHOLDS = np.round(np.linspace(0.0, 1.0, 21), 2)
"""Normalized scores at which performance profiles are evaluated."""


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: name of the row.
        policies: name or path of the policy of each training run; one entry without training runs; empty with records.
        hours: hours of training of all runs; None: unknown.
        steps: training steps of a run, 0 before training; None: there is no run.
        curves: (step, mean score) of each run's evaluations.
        scenario: scenario of training; None: the row may play any scenario.
        records: (name of the scenario, record) of episodes that have been played before; such a row plays no others.
        seats: ledger entries of these records, by file; empty without a ledger.
    """

    name: str
    policies: tuple[str, ...]
    hours: float | None = None
    steps: int | None = None
    curves: tuple[tuple[tuple[int, float], ...], ...] = field(default=())
    scenario: str | None = None
    records: tuple[tuple[str, Record], ...] = ()
    seats: Mapping[Path, Mapping[str, Any]] = field(default_factory=dict)

    def effort(self, scenario: str) -> dict[str, Any]:
        """Return the conditions of the seats in a scenario, and their total effort as means over episodes."""
        entries = [self.seats[record.path] for name, record in self.records if name == scenario]
        effort = [[sum(seat.get(kind, 0) for seat in entry["seats"].values()) for kind in _EFFORT] for entry in entries]
        conditions = {kind: entries[0][kind] for kind in _CONDITIONS}
        return conditions | dict(zip(_EFFORT, np.mean(effort, axis=0).round(3).tolist(), strict=True))


def world_scenarios() -> list[str]:
    """Return the bundled scenarios with hidden parameters, which are benchmarked by default."""
    return [name for name in scenario_names() if load_scenario(name).world.draws]


def find_rows(policies: Sequence[str]) -> list[Row]:
    """Return the rows of policies by name or path.

    Args:
        policies: names or paths, see :func:`~chemlab.agents.policies.make_policies`. A folder of runs gives a row of
            the best checkpoints, one of the last ones, and one of clones before training; a record, or a folder of
            records, gives one row.

    Raises:
        RecordError: a file is not a record.
        ValueError: runs of one folder differ in more than their seeds, a run has no checkpoint, records of one folder
            have different players, or two rows have the same name.
    """
    rows: list[Row] = []
    for name in map(current_name, policies):
        path, way = split_way(name)
        folder = Path(path)
        runs, files, seats = list[Run](), list[Path](), dict[Path, dict[str, Any]]()
        if name not in policy_names() and folder.parent.name != "checkpoints":
            runs = find_runs(folder) if folder.is_dir() else []
            seats = ended_episodes(folder) if folder.is_dir() else {}
            files = [*seats] or sorted(folder.rglob(f"*{_RECORD}"))
            files = files if folder.is_dir() else [folder] * (folder.suffix == _RECORD)
        if runs:
            rows += _trained_rows(name, runs, way)
        else:
            rows.append(_played_row(str(folder), files, seats) if files else Row(name, (name,)))
    files_of = Counter(_file_name(row.name) for row in rows)
    doubled = sorted({row.name for row in rows if files_of[_file_name(row.name)] > 1})
    if doubled:
        raise ValueError(f"policies: {', '.join(doubled)}: given twice, or would have the same files")
    return rows


def _played_row(name: str, files: Sequence[Path], seats: Mapping[Path, Mapping[str, Any]]) -> Row:
    """Return the row of records; check that players and, with a ledger, conditions are the same in all of them."""
    for kind in _CONDITIONS:
        values = {str(entry[kind]) for entry in seats.values()}
        if len(values) > 1:
            raise ValueError(
                f"policies: {name}: one row has the same {kind} everywhere, here {' and '.join(sorted(values))}: put "
                "these into folders of their own"
            )
    records, players = [], dict[str, tuple[str, Path]]()
    for file in files:
        record = read_record(file)
        records.append((recorded_scenario(record).name, record))
        for agent, player in record.checked_header().policies.items():
            other, first = players.setdefault(agent, (player, file))
            if other != player:
                raise ValueError(
                    f"policies: {name}: one row has the same players everywhere; {agent} is {other} in {first}, and "
                    f"{player} in {file}: put these into folders of their own"
                )
    return Row(name, (), records=tuple(records), seats=seats)


def _trained_rows(name: str, runs: Sequence[Run], way: str | None) -> list[Row]:
    """Return the rows of the first (if any), best and last checkpoints of runs, played greedily or sampled."""
    configs = [run.config() or {} for run in runs]
    first_of: dict[Any, Run] = {}
    for run, config in zip(runs, configs, strict=True):
        other = differences(config, configs[0])
        other.pop("seed", None)
        if other:
            raise ValueError(
                f"policies: {name}: runs of one row differ in their seeds alone; {run.path} has "
                f"{', '.join(other.values())}; give each of them with a --policy of its own"
            )
        seed = config.get("seed")
        first = first_of.setdefault(seed, run)
        if first is not run:
            raise ValueError(f"policies: {name}: {run.path} has the seed of {first.path}, {seed}: leave one")
    ends = [curve[-1] for run in runs if (curve := run.curve())]
    evaluations = tuple(tuple((one.step, one.mean) for one in run.evaluations()) for run in runs)
    found = []
    for kind in ("first", "best", "last"):
        checkpoints = [run.checkpoint(kind) for run in runs]
        if kind == "first" and None in checkpoints:
            continue
        missing = [str(run.path) for run, folder in zip(runs, checkpoints, strict=True) if folder is None]
        if missing:
            raise ValueError(f"policies: {', '.join(missing)}: no {kind} checkpoint; train it (again)")
        paths = tuple(f"{folder}:{way}" if way else str(folder) for folder in checkpoints)
        steps = max((end.step for end in ends), default=0) or None
        hours: float | None = sum(end.seconds for end in ends) / 3600.0
        if kind == "first":
            hours, steps = None, 0  # the time of cloning alone is unknown
        found.append(Row(f"{name} ({kind})", paths, hours, steps, evaluations, str(configs[0]["scenario"])))
    return found


# -- jobs -------------------------------------------------------------------------------------------------------------


_Block = npt.NDArray[np.intp]
"""Indices of a replication's episodes."""


def _normalised(scores: Any, random: float, oracle: float) -> FloatArray:
    """Return normalized scores; ``random`` and ``oracle`` are mean scores in the same episodes."""
    return np.asarray((np.asarray(scores) - random) / (oracle - random))


def _blocks(episodes: int, replications: int) -> list[_Block]:
    if not 1 <= replications <= episodes:
        raise ValueError(f"seeds: from 1 to the {episodes} episodes of the budget, given {replications}")
    return np.array_split(np.arange(episodes), replications)


def _file_name(text: str) -> str:
    """Return the file name of a row's name."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in text)[-120:]


def reference_jobs(split: str) -> list[Job]:
    """Return the jobs of random play and of the best open-loop plan, in worlds of a split."""
    plan = {} if split == "test" else {"split": split}  # equal to the job of an audit, whose result may be cached
    random = {"policy": "random", "split": split, "seed": AUDIT_SEED}
    return [Job("plan", "plan", plan), Job("random", "play", random)]


def _job_name(row: Row, block: _Block) -> str:
    return f"row-{_file_name(row.name)}-{block[0]}-{len(block)}"


def _row_jobs(spec: Scenario, rows: Sequence[Row], blocks: Sequence[_Block], split: str) -> list[Job]:
    """Return the jobs of the rows that fit a scenario; with hidden parameters, also those in training worlds."""
    jobs = []
    for row in rows:
        for number, block in enumerate(blocks if row.policies and _fits(row, spec) else ()):
            policy, name = row.policies[number % len(row.policies)], _job_name(row, block)
            arguments = {"policy": policy, "seed": AUDIT_SEED + int(block[0]), "episodes": len(block)}
            jobs.append(Job(name, "play", {**arguments, "split": split}))
            if spec.world.draws and split != "train":
                jobs.append(Job(f"{name}-train", "play", {**arguments, "split": "train"}))
    return jobs


def part_count(scenarios: Sequence[Scenario], rows: Sequence[Row], budget: AuditBudget, seeds: int, split: str) -> int:
    """Return the number of jobs and records of a benchmark."""
    blocks = _blocks(budget.episodes, seeds)
    return sum(
        len(reference_jobs(split))
        + len(planner_jobs(budget, [], split))
        + len(_row_jobs(spec, rows, blocks, split))
        + sum(len(_records_of(row, spec)) for row in rows)
        for spec in scenarios
    )


def _records_of(row: Row, spec: Scenario) -> list[Record]:
    return [record for name, record in row.records if name == spec.name]


def _verified_records(
    row: Row, spec: Scenario, split: str, episodes: int, watch: Callable[[str], None] | None
) -> dict[int, tuple[float, Record]]:
    """Replay a row's records of a scenario, and return (score, record) by the number of the episode.

    A record that is wrong, of other episodes or of another scenario, or of the episode of another raises ValueError.
    """
    found: dict[int, tuple[float, Record]] = {}
    for record in _records_of(row, spec):
        file, header = record.path, record.checked_header()
        number = -1 if header.seed is None else header.seed - AUDIT_SEED
        if header.options or header.split not in (None, split.partition(":")[0]) or not 0 <= number < episodes:
            raise ValueError(
                f"policies: {file}: is not an episode of this benchmark: seeds {AUDIT_SEED} to "
                f"{AUDIT_SEED + episodes - 1}, split {split}, no options; its seed is {header.seed}, its split "
                f"{header.split}" + (f", its options {', '.join(header.options)}" * bool(header.options))
            )
        if scenario_hash(recorded_scenario(record)) != scenario_hash(spec):
            raise ValueError(f"policies: {file}: is of another {spec.name} than {spec.origin}: prices or rules differ")
        proof = verify_record(record, spec, bool(trust()), split=split)
        # A record of another version, or of a platform that rounds differently, may still be right. Episodes of seats
        # may end without calls left, or because the agent gave up; they count with the score at that time.
        unfinished = record.torn and record.path not in row.seats
        if proof.status not in ("ok", "other", "torn") or proof.where or proof.score is None or unfinished:
            raise ValueError(f"policies: {file}: {proof.message}")
        if number in found:
            raise ValueError(
                f"policies: {file}: is of seed {header.seed}, and so is {found[number][1].path}: leave one"
            )
        found[number] = (proof.score, record)
        if watch is not None:
            watch(str(file))
    return found


def _fits(row: Row, spec: Scenario) -> bool:
    """Return True if a row has no scenario of training, or if this is the scenario, by its name or path with level."""
    if row.scenario is None or row.scenario == spec.name:
        return True
    file, suffix, level = row.scenario.rpartition(".toml")
    return bool(suffix) and level == spec.level and Path(file + suffix).resolve() == Path(spec.origin).resolve()


def check_rows(scenarios: Sequence[Scenario], rows: Sequence[Row]) -> None:
    """Check that each row with a policy fits at least one of the scenarios.

    Raises:
        ValueError: a row does not fit; the message has the reason for one of the scenarios.
    """
    for row in (row for row in rows if row.policies):
        reasons = [f"was trained in {row.scenario}"] * (row.scenario is not None)
        for spec in (spec for spec in scenarios if _fits(row, spec)):
            try:
                Target(spec).check(row.policies[0])
            except ValueError as error:
                reasons.append(str(error))
            else:
                break
        else:
            raise ValueError(f"policies: {row.name}: {reasons[-1]}")


def benchmark(
    scenarios: Sequence[str | Path | Scenario],
    rows: Sequence[Row],
    budget: str | AuditBudget = "small",
    seeds: int = 5,
    split: str = "test",
    baseline: str = "scripted",
    keep: Path | None = None,
    executor: Executor | None = None,
    watch: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Play and compare all rows in all scenarios.

    Args:
        scenarios: bundled names, paths, or loaded scenarios.
        rows: rows in addition to ``random``, ``plan`` and ``oracle``.
        budget: the audit's budget: numbers of episodes and of plans in searches.
        seeds: number of replications.
        split: split of the worlds.
        baseline: row with which the others are compared.
        keep: folder of cached results, by scenario.
        executor: executor of the jobs, see :mod:`chemlab.agents.executors`; None: this process.
        watch: called with the name of each finished job or verified record.

    Returns:
        Plain data: ``scenarios`` (by name: the scale and, for each row, the normalized mean with its interval, the
        means of the replications, the generalization gap, and the difference to the baseline in the same episodes, or
        the reason why the cell is empty), ``rows`` (statistics over all scenarios), settings and versions.

    Raises:
        DataError: a scenario is unknown.
        ValueError: the budget or the baseline is unknown, there are more replications than episodes, or a record is
            wrong or of other episodes.
    """
    chosen = budget_of(budget)
    specs = [load_scenario(scenario) for scenario in scenarios]
    names = ["random", "plan", *(row.name for row in rows), "oracle"]
    if baseline not in names:
        raise ValueError(f"baseline: known: {', '.join(names)}; given {baseline!r}")
    if _row_named(rows, baseline).records:
        raise ValueError(f"baseline: {baseline}: must play all episodes, and records need not have all; give a policy")
    blocks = _blocks(chosen.episodes, seeds)
    for row in rows:
        if len(row.policies) > seeds:
            raise ValueError(
                f"seeds: {row.name} has {len(row.policies)} runs, and each plays a replication of its own; give at "
                f"least as many, given {seeds}"
            )
    found = {}
    # All records are verified before any job is executed.
    recorded = [
        {row.name: _verified_records(row, spec, split, chosen.episodes, watch) for row in rows if row.records}
        for spec in specs
    ]
    for spec, games in zip(specs, recorded, strict=True):
        runner = JobRunner(spec, chosen, None if keep is None else keep / spec.name, executor, watch)
        results = runner.run([*reference_jobs(split), *_row_jobs(spec, rows, blocks, split)])
        results |= runner.run(planner_jobs(chosen, results["plan"]["plans"], split))
        found[spec.name] = _cells(spec, results, rows, games, blocks, baseline)
    return {
        "kind": "benchmark",
        "format": 1,
        **provenance(budget, chosen, split),
        "seeds": seeds,
        "baseline": baseline,
        "thresholds": _THRESHOLDS.tolist(),
        "scenarios": found,
        "rows": [_summary(name, found, baseline, _row_named(rows, name)) for name in names],
    }


def _row_named(rows: Sequence[Row], name: str) -> Row:
    return next((row for row in rows if row.name == name), Row(name, ()))


def _row_scores(
    row: Row,
    spec: Scenario,
    results: Mapping[str, dict[str, Any]],
    games: Mapping[str, Mapping[int, tuple[float, Record]]],
    blocks: Sequence[_Block],
) -> tuple[FloatArray | str, FloatArray | None]:
    """Return a row's scores [E] (NaN: not played), or the reason why there are none, and those in training worlds."""
    if row.records:
        scores = np.full(sum(map(len, blocks)), np.nan)
        scores[list(games[row.name])] = [score for score, _ in games[row.name].values()]
        return scores if games[row.name] else "has not been played yet", None
    if not _fits(row, spec):
        return f"was trained in {row.scenario}", None
    names = [_job_name(row, block) for block in blocks]
    refused = next((results[name]["reason"] for name in names if results[name]["scores"] is None), None)
    if refused is not None:
        return refused, None
    scores = np.concatenate([results[name]["scores"] for name in names])
    train = [results[f"{name}-train"]["scores"] for name in names if f"{name}-train" in results]
    return scores, np.concatenate(train) if train else None


def _cells(
    spec: Scenario,
    results: Mapping[str, dict[str, Any]],
    rows: Sequence[Row],
    games: Mapping[str, Mapping[int, tuple[float, Record]]],
    blocks: Sequence[_Block],
    baseline: str,
) -> dict[str, Any]:
    """Return the cells of one scenario from results of jobs and verified records (``games``) by name.

    Rows without all episodes are scored on the episodes that they have.
    """
    random = np.array(results["random"]["scores"])
    by_name: dict[str, tuple[FloatArray | str, FloatArray | None]] = {
        "random": (random, None),
        "plan": (np.array(results["plan"]["scores"]), None),
        **{row.name: _row_scores(row, spec, results, games, blocks) for row in rows},
    }
    # A planner that knows the hidden parameters could play what any other policy played.
    known = [scores for scores, _ in by_name.values() if not isinstance(scores, str)]
    oracle = np.fmax.reduce([foreseen(results), *known])
    by_name["oracle"] = oracle, None
    other = by_name[baseline][0]
    cells: dict[str, Any] = {}
    for name, (scores, train) in by_name.items():
        if isinstance(scores, str):
            cells[name] = missing(scores)
            continue
        row, played = _row_named(rows, name), np.isfinite(scores)
        compared = None if name == baseline or isinstance(other, str) else other
        run_of = runs_of(len(row.policies), len(blocks), len(scores))
        measured = on_scale(scores, random, oracle, run_of, compared, train)
        if measured is None:
            cells[name] = missing("no policy scores above random play in these episodes: there is no scale")
            continue
        # Replications of one run are not independent: together they are one. One without a scale is omitted.
        sample = np.asarray(run_of or [number for number, block in enumerate(blocks) for _ in block])
        own = [np.flatnonzero(played & (sample == k)) for k in range(len(blocks))]
        parts = [part for part in own if len(part) and oracle[part].mean() > random[part].mean() + statistics.TIE]
        cells[name] = {
            **measured,
            "replications": _replications(scores, random, oracle, parts),
            "scores": [score if played[k] else None for k, score in enumerate(scores.tolist())],
        }
        if row.seats:
            cells[name]["seats"] = row.effort(spec.name)
        if train is not None:
            cells[name]["train_scores"] = train.tolist()
        if compared is not None and not played.all():  # the other episodes may be easier or harder
            cells[name]["baseline"] = _replications(compared, random, oracle, parts)
    # The scale of a replication is that of its own worlds, so that easy worlds do not raise its scores.
    scales = [
        {"first": int(block[0]), "count": len(block)}
        | {"random": float(random[block].mean()), "oracle": float(oracle[block].mean())}
        for block in blocks
    ]
    return {
        "scenario_hash": scenario_hash(spec),
        "replications": scales,
        "plans": results["plan"]["plans"],
        "cells": cells,
    }


def _replications(scores: FloatArray, random: FloatArray, oracle: FloatArray, parts: Sequence[_Block]) -> list[float]:
    """Return the mean score in each part of the episodes, normalized on the scale of this part."""
    return [float(_normalised(scores[part].mean(), random[part].mean(), oracle[part].mean())) for part in parts]


def _summary(name: str, found: Mapping[str, Any], baseline: str, row: Row) -> dict[str, Any]:
    """Return statistics of a row over all scenarios in which both the row and the baseline have a cell."""
    common = [
        one["cells"]
        for one in found.values()
        if one["cells"][name]["value"] is not None and one["cells"][baseline]["value"] is not None
    ]
    effort = {"runs": len(row.policies), "hours": row.hours, "steps": row.steps}
    summary: dict[str, Any] = {"policy": name, "scenarios": len(common), **effort}
    if not common:
        return {**summary, "interquartile_mean": None, "mean": None, "improvement": None, "profile": None}
    own = [cells[name]["replications"] for cells in common]
    other = [cells[name].get("baseline", cells[baseline]["replications"]) for cells in common]
    profile = statistics.performance_profile(own, _THRESHOLDS)
    return {
        **summary,
        "interquartile_mean": statistics.interquartile_mean(own).as_dict(),
        "mean": statistics.mean(own).as_dict(),
        "improvement": None if name == baseline else statistics.probability_of_improvement(own, other).as_dict(),
        "profile": [estimate.as_dict() for estimate in profile],
    }


def provenance(budget: str | AuditBudget, chosen: AuditBudget, split: str) -> dict[str, Any]:
    """Return settings, versions and hardware for a file of results.

    Args:
        budget: name of the budget, or a budget without a name.
        chosen: the budget.
        split: split of the worlds.
    """
    return {
        "split": split,
        "budget": budget if isinstance(budget, str) else "own",
        **{f"budget_{key}": value for key, value in vars(chosen).items()},
        "seed": AUDIT_SEED,
        "confidence": statistics.CONFIDENCE,
        "versions": versions(),
        "commit": _commit(),
        "hardware": {"machine": platform.machine(), "system": platform.system(), "cores": os.cpu_count()},
    }


def _commit() -> str | None:
    """Return the commit of this source tree, with ``+`` if files have been changed; None outside a repository."""
    here = Path(__file__).resolve().parent
    try:
        commit, changed = (
            subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True, timeout=10).stdout
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return commit.strip() + ("+" if changed.strip() else "")


# -- files ------------------------------------------------------------------------------------------------------------


def write_benchmark(
    folder: Path, found: Mapping[str, Any], scenarios: Sequence[Scenario], rows: Sequence[Row], records: int = 1
) -> None:
    """Write the results of a benchmark to a folder; this module's documentation lists the files.

    Args:
        folder: output folder.
        found: results of :func:`benchmark`.
        scenarios, rows: scenarios and rows of the benchmark.
        records: number of recorded episodes for each row and scenario.

    Raises:
        DataError: the existing ``leaderboard.json`` is not a leaderboard.
    """
    write_json(folder / "benchmark.json", found)
    write_json(folder / "marl_eval.json", marl_eval(found, rows))
    written = _write_records(folder, found, scenarios, rows, records)
    write_leaderboard(folder / "leaderboard.json", _lines(found, written))


def marl_eval(found: Mapping[str, Any], rows: Sequence[Row]) -> dict[str, Any]:
    """Return results in marl-eval's format: {environment: {task: {algorithm: {seed: steps and absolute metrics}}}}.

    ``return`` is the normalized score. For training runs, all steps but the last are evaluations during training.
    """
    tasks: dict[str, Any] = {}
    for scenario, one in found["scenarios"].items():
        tasks[scenario] = {}
        for name, cell in one["cells"].items():
            # marl-eval requires equally many runs of all algorithms.
            if cell["value"] is None or None in cell["scores"]:
                continue
            row = _row_named(rows, name)
            algorithm = tasks[scenario][name] = {}
            for k, scale in enumerate(one["replications"]):
                if scale["oracle"] <= scale["random"] + statistics.TIE:
                    continue
                first, ends = scale["first"], (scale["random"], scale["oracle"])
                returns = _normalised(cell["scores"][first : first + scale["count"]], *ends)
                curve = row.curves[k % len(row.curves)] if row.curves else ()
                steps = {
                    f"step_{i}": {"step_count": step, "return": [float(_normalised(mean, *ends))]}
                    for i, (step, mean) in enumerate(curve)
                }
                steps[f"step_{len(curve)}"] = {"step_count": row.steps or 0, "return": returns.tolist()}
                algorithm[f"seed_{k}"] = {**steps, "absolute_metrics": {"return": [float(returns.mean())]}}
    return {"chemlab": tasks}


def _write_records(
    folder: Path, found: Mapping[str, Any], scenarios: Sequence[Scenario], rows: Sequence[Row], count: int
) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Record the first ``count`` episodes of every row, copy given records, and return entries by scenario and row."""
    written: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for spec in scenarios:
        cells = found["scenarios"][spec.name]["cells"]
        for row in (Row("plan", ("scripted",)), *rows):
            if cells[row.name]["value"] is None:
                continue
            entries = written[spec.name, row.name] = []
            row_folder = folder / "records" / spec.name / _file_name(row.name)
            for record in _records_of(row, spec):
                seed = record.checked_header().seed or 0
                path = row_folder / f"{seed}{_RECORD}"
                write_text(path, "".join(line.decode().rstrip("\n") + "\n" for line in record.lines))
                score = cells[row.name]["scores"][seed - AUDIT_SEED]
                entries.append({"file": path.relative_to(folder).as_posix(), "seed": seed, "score": score})
            for episode in range(min(count, found["budget_episodes"]) if not row.records else 0):
                seed = AUDIT_SEED + episode
                path = row_folder / f"{seed}{_RECORD}"
                env = raw_env(spec, split=found["split"])
                labs = env.laboratories
                policies = make_policies(row.policies[0], labs)
                if row.name == "plan":
                    plans = {tuple(c): tuple(p) for c, p in found["scenarios"][spec.name]["plans"]}
                    policies[MANAGER_AGENT] = ConstantPlan(spec, labs.channels, labs.actions, plans)
                score = record_episode(path, env, policies, seed, force=True).score
                entries.append({"file": path.relative_to(folder).as_posix(), "seed": seed, "score": score})
    return written


def _lines(found: Mapping[str, Any], written: Mapping[tuple[str, str], list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return the leaderboard's lines of a benchmark's results; ``written`` are the entries of the records."""
    lines = []
    summaries = {row["policy"]: row for row in found["rows"]}
    common = {name: found[name] for name in ("split", "seeds", "budget", "baseline", "commit", "versions", "hardware")}
    for scenario, one in found["scenarios"].items():
        for name, cell in one["cells"].items():
            row = {"scenario": scenario, "scenario_hash": one["scenario_hash"], "policy": name}
            own = {key: cell.get(key) for key in _LINE_KEYS if key != "seats" or key in cell}
            effort = {key: summaries[name][key] for key in ("runs", "hours", "steps")}
            lines.append({**row, **own, **effort, "records": written.get((scenario, name), []), **common})
    return lines
