"""The benchmark's protocol: ``chemlab benchmark``. What is played, on which scale, with which statistics.

Every row (a policy) plays the same episodes of each scenario, in worlds of the split ``test``: those of
:mod:`~chemlab.agents.evaluate.audit`, whose scale it is, too: 0 is random legal play, 1 what a planner comes to that
knows each episode's world. The episodes are dealt out to replications. A replication has worlds of its own, and a
training run of its own where a row has several (a folder of runs that differ in their seeds); it is what the
statistics are of: interquartile mean, performance profile and probability of improvement over the baseline, with
95 % intervals (:mod:`~chemlab.agents.evaluate.statistics`). The interval of a cell is over its episodes; where
several runs have dealt them out among themselves, it is over runs.

| row | who |
|---|---|
| ``random`` | random legal actions of everybody: 0 |
| ``plan`` | the best constant plan of the manager that a search finds in training worlds, over scripted benches |
| ``scripted`` | the scripted agents |
| ``pretrained``, ``trained`` | bundled policies, where one fits |
| a path | a training run, or a folder of runs of which only the seed differs: the best checkpoint by validation, the \
last, and the first, before training, of runs that began as clones; or records of these episodes that people \
(``chemlab play``) or language agents (``chemlab mcp`` and the like) have played, a file or a folder of them |
| ``oracle`` | the planner that knows the world: 1 |

| file | what |
|---|---|
| ``parts/SCENARIO/`` | what has been played: the same command goes on from there |
| ``benchmark.json`` | :func:`benchmark`'s findings |
| ``marl_eval.json`` | each run's scores on the scale, as marl-eval reads them |
| ``leaderboard.json`` | a line for each row and scenario, with the scores of its episodes, commit, versions, \
hardware, hours and records (:mod:`~chemlab.agents.evaluate.leaderboard`) |
| ``records/`` | episodes of each row that ``chemlab verify`` plays again |

A line of the leaderboard that another command has written stays, unless it is of the same row and scenario. Where
somebody was better than the planner, in this command or before, all lines of the same episodes are on that scale.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.files import write_text
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
from .jobs import AUDIT_SEED, AuditBudget, Crew, Job, budget_of, foreseen, planner_jobs
from .leaderboard import on_scale, runs_of, write_leaderboard
from .play import Target
from .scale import missing

DEFAULT_ROWS = ("scripted", "pretrained", "trained")
"""Policies that are played whether or not others are asked for, besides ``random``, ``plan`` and ``oracle``."""
REFERENCES = ("random", "plan", "oracle")
"""Rows that are there in any case."""
_TOLD = (
    *("value", "low", "high", "score", "episodes", "scale", "generalization", "over_baseline"),
    *("scores", "train_scores", "seats"),
)
"""Of a cell, what the leaderboard has, too."""
_CONDITIONS = ("condition", "names", "say", "budget")
"""Of seats, in which the episodes of a row must agree."""
_SPENT = ("calls", "wrong", "characters", "tokens")
"""Of seats, what is given beside the score."""
_RECORD = ".jsonl"
"""Suffix of record files."""
_THRESHOLDS = np.round(np.linspace(0.0, 1.0, 21), 2)
"""Of performance profiles, on the scale."""


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: what it is called.
        policies: a policy's name, or path, for each of its training runs; one where it was not trained here.
        hours: of training, all runs together; None where it is not known.
        steps: of a run, 0 before training; None where there is none.
        curves: for each run (step, mean score) of its evaluations.
        scenario: what the runs were trained on; None: anything.
        records: (scenario's name, record) of episodes that somebody has played already; who has some plays none here.
        seats: the ledger's entries of these records, by file; empty where there is no ledger.
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
        """Conditions of the seats in a scenario, and means over its episodes of what they have spent, all together."""
        own = [self.seats[record.path] for name, record in self.records if name == scenario]
        spent = [[sum(seat.get(kind, 0) for seat in entry["seats"].values()) for kind in _SPENT] for entry in own]
        conditions = {kind: own[0][kind] for kind in _CONDITIONS}
        return conditions | dict(zip(_SPENT, np.mean(spent, axis=0).round(3).tolist(), strict=True))


def world_scenarios() -> list[str]:
    """Shipped scenarios that draw worlds: what is benchmarked where nothing is named."""
    return [name for name in scenario_names() if load_scenario(name).world.draws]


def find_rows(policies: Sequence[str]) -> list[Row]:
    """The rows that policies by name or path stand for.

    Args:
        policies: names or paths, see :func:`~chemlab.agents.policies.make_policies`. A folder of runs is one row for
            their best checkpoints, one for their last ones, and one for clones before training; a record, or a folder
            of records, is one row.

    Raises:
        RecordError: a file is no record.
        ValueError: runs of one folder that differ in more than their seeds, a run without a checkpoint, or records of
            one folder that say that different players made them.
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
    own = [_file_name(row.name) for row in rows]
    doubled = sorted({row.name for row in rows if own.count(_file_name(row.name)) > 1})
    if doubled:
        raise ValueError(f"policies: {', '.join(doubled)}: given twice, or would have the same files")
    return rows


def _played_row(name: str, files: Sequence[Path], seats: Mapping[Path, Mapping[str, Any]]) -> Row:
    """Make a row of records; they name its players, and a ledger their conditions."""
    for kind in _CONDITIONS:
        values = {str(entry[kind]) for entry in seats.values()}
        if len(values) > 1:
            raise ValueError(
                f"policies: {name}: one row has the same {kind} everywhere, here {' and '.join(sorted(values))}: put "
                "these into folders of their own"
            )
    records, told = [], dict[str, tuple[str, Path]]()
    for file in files:
        record = read_record(file)
        records.append((recorded_scenario(record).name, record))
        for agent, player in record.checked_header().policies.items():
            other, first = told.setdefault(agent, (player, file))
            if other != player:
                raise ValueError(
                    f"policies: {name}: one row has the same players everywhere; {agent} is {other} in {first}, and "
                    f"{player} in {file}: put these into folders of their own"
                )
    return Row(name, (), records=tuple(records), seats=seats)


def _trained_rows(name: str, runs: Sequence[Run], way: str | None) -> list[Row]:
    configs = [run.config() or {} for run in runs]
    for run, config in zip(runs, configs, strict=True):
        other = differences(config, configs[0])
        other.pop("seed", None)
        if other:
            raise ValueError(
                f"policies: {name}: runs of one row differ in their seeds alone; {run.path} has "
                f"{', '.join(other.values())}; give each of them with a --policy of its own"
            )
    seconds = [curve[-1].seconds if (curve := run.curve()) else 0.0 for run in runs]
    curves = tuple(tuple((one.step, one.mean) for one in run.evaluations()) for run in runs)
    found = []
    for kind in ("first", "best", "last"):
        checkpoints = [run.checkpoint(kind) for run in runs]
        if kind == "first" and None in checkpoints:
            continue
        missing = [str(run.path) for run, folder in zip(runs, checkpoints, strict=True) if folder is None]
        if missing:
            raise ValueError(f"policies: {', '.join(missing)}: no {kind} checkpoint; train it (again)")
        paths = tuple(f"{folder}:{way}" if way else str(folder) for folder in checkpoints)
        steps = max((run.curve()[-1].step for run in runs if run.curve()), default=0) or None
        hours: float | None = sum(seconds) / 3600.0
        if kind == "first":
            hours, steps = None, 0  # how long cloning took is not known apart
        found.append(Row(f"{name} ({kind})", paths, hours, steps, curves, str(configs[0]["scenario"])))
    return found


# -- what is played ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Block:
    """The episodes of a replication: of the first, how many, and which of a row's runs plays them."""

    number: int
    first: int
    count: int

    def of(self, scores: Any) -> FloatArray:
        """Those of everybody's that are its own."""
        return np.asarray(scores)[self.first : self.first + self.count]


def _normalised(scores: Any, random: float, best: float) -> FloatArray:
    """Scores on the scale of episodes of which these are the mean scores of random play and of the planner."""
    return np.asarray((np.asarray(scores) - random) / (best - random))


def _blocks(episodes: int, replications: int) -> list[_Block]:
    if not 1 <= replications <= episodes:
        raise ValueError(f"seeds: from 1 to the {episodes} episodes of the budget, given {replications}")
    parts = np.array_split(np.arange(episodes), replications)
    return [_Block(k, int(part[0]), len(part)) for k, part in enumerate(parts)]


def _file_name(text: str) -> str:
    """A row's name as a file's."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in text)[-120:]


def reference_jobs(split: str) -> list[Job]:
    """Random play, and the best constant plan, in worlds of a split."""
    test = {"split": split, "seed": AUDIT_SEED}
    plan = {} if split == "test" else {"split": split}  # as an audit has it, which may have played it already
    return [Job("plan", "plan", plan), Job("random", "play", {"policy": "random", **test})]


def _row_jobs(spec: Scenario, rows: Sequence[Row], blocks: Sequence[_Block], split: str) -> list[Job]:
    jobs = []
    for row in rows:
        for block in blocks if row.policies else ():
            policy = row.policies[block.number % len(row.policies)]
            own = {"policy": policy, "seed": AUDIT_SEED + block.first, "episodes": block.count}
            name = f"row-{_file_name(row.name)}-{block.first}-{block.count}"
            jobs.append(Job(name, "play", {**own, "split": split}))
            if spec.world.draws and split != "train":
                jobs.append(Job(f"{name}-train", "play", {**own, "split": "train"}))
    return jobs


def part_count(scenarios: Sequence[Scenario], rows: Sequence[Row], budget: AuditBudget, seeds: int, split: str) -> int:
    """Return the number of parts of a benchmark."""
    blocks = _blocks(budget.episodes, seeds)
    return sum(
        len(reference_jobs(split))
        + len(planner_jobs(budget, [], split))
        + len(_row_jobs(spec, _fitting(spec, rows), blocks, split))
        + sum(len(_records_of(row, spec)) for row in rows)
        for spec in scenarios
    )


def _records_of(row: Row, spec: Scenario) -> list[Record]:
    return [record for name, record in row.records if name == spec.name]


def _entered(
    row: Row, spec: Scenario, split: str, episodes: int, watch: Callable[[str], None] | None
) -> dict[int, tuple[float, Record]]:
    """(score, record) of the episodes, by number, that somebody has played; every one is played again."""
    found: dict[int, tuple[float, Record]] = {}
    for record in _records_of(row, spec):
        file, header = record.path, record.checked_header()
        number = -1 if header.seed is None else header.seed - AUDIT_SEED
        if header.options or header.split not in (None, split.partition(":")[0]) or not 0 <= number < episodes:
            raise ValueError(
                f"policies: {file}: is none of the episodes that everybody plays: seeds {AUDIT_SEED} to "
                f"{AUDIT_SEED + episodes - 1}, split {split}, and nothing asked for; its seed is {header.seed}, its "
                f"split {header.split}" + (f", and it was asked for {', '.join(header.options)}" * bool(header.options))
            )
        if scenario_hash(recorded_scenario(record)) != scenario_hash(spec):
            raise ValueError(f"policies: {file}: is of another {spec.name} than {spec.origin}: prices or rules differ")
        proof = verify_record(record, spec, bool(trust()), split=split if ":" in split else None)
        # Made by another version, or on a platform that rounds otherwise, it may be right all the same. An episode that
        # a room has ended, because there were no calls left or the agent gave up, counts as it stood.
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


def _fitting(spec: Scenario, rows: Sequence[Row]) -> list[Row]:
    """Return the rows that may play a scenario: trained rows play the scenario of their training."""
    return [row for row in rows if row.scenario is None or _is_of(row.scenario, spec)]


def _is_of(argument: str, spec: Scenario) -> bool:
    """Return whether an argument of a run stands for a scenario: its name, or the path of its file, with its level."""
    file, suffix, level = argument.rpartition(".toml")
    return argument == spec.name or (
        bool(suffix) and level == spec.level and Path(file + suffix).resolve() == Path(spec.origin).resolve()
    )


def check_rows(scenarios: Sequence[Scenario], rows: Sequence[Row]) -> None:
    """Check that each row that plays fits one of the scenarios at least.

    Raises:
        ValueError: one does not; why.
    """
    for row in (row for row in rows if row.policies):
        reasons = [f"was trained in {row.scenario}"] * (row.scenario is not None)
        for spec in (spec for spec in scenarios if _fitting(spec, [row])):
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
    """Play every row in every scenario, and compare.

    Args:
        scenarios: shipped names, paths, or loaded scenarios.
        rows: who plays, besides ``random``, ``plan`` and ``oracle``.
        budget: of the audit: how many episodes, and how long plans are searched for.
        seeds: replications.
        split: worlds.
        baseline: the row that improvement is measured over.
        keep: folder in which results of finished parts are kept, by scenario.
        executor: plays the parts, see :mod:`chemlab.agents.executors`; None: this process.
        watch: called with the name of each part that has been played.

    Returns:
        Plain data: ``scenarios`` (by name: the scale, and for each row its normalised mean with interval, the same of
        its replications, its generalization gap, what it is more than the baseline in the same episodes, or why the
        cell is empty), ``rows`` (statistics over all scenarios), and how it was made.

    Raises:
        DataError: no such scenario.
        ValueError: unknown budget or baseline, more replications than episodes, or a record that is of none of these
            episodes, or not what happens.
    """
    chosen = budget_of(budget)
    specs = [load_scenario(scenario) for scenario in scenarios]
    names = ["random", "plan", *(row.name for row in rows), "oracle"]
    if baseline not in names:
        raise ValueError(f"baseline: known: {', '.join(names)}; given {baseline!r}")
    if _row_named(rows, baseline).records:
        raise ValueError(f"baseline: {baseline}: must have played all episodes, which people need not; give a policy")
    blocks = _blocks(chosen.episodes, seeds)
    for row in rows:
        if len(row.policies) > seeds:
            raise ValueError(
                f"seeds: {row.name} has {len(row.policies)} runs, and each plays a replication of its own; give at "
                f"least as many, given {seeds}"
            )
    found = {}
    entered = {
        (spec.name, row.name): _entered(row, spec, split, chosen.episodes, watch)
        for spec in specs
        for row in rows
        if row.records
    }
    for spec in specs:
        folder = None if keep is None else keep / spec.name
        crew = Crew(spec, chosen, folder, executor, watch)
        fitting = _fitting(spec, rows)
        played = crew.run([*reference_jobs(split), *_row_jobs(spec, fitting, blocks, split)])
        planned = crew.run(planner_jobs(chosen, played["plan"]["plans"], split))
        own = {row: games for (name, row), games in entered.items() if name == spec.name}
        found[spec.name] = _cells(spec, played, planned, rows, fitting, own, blocks, split, baseline)
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


def _cells(
    spec: Scenario,
    played: Mapping[str, dict[str, Any]],
    planned: Mapping[str, dict[str, Any]],
    rows: Sequence[Row],
    fitting: Sequence[Row],
    entered: Mapping[str, Mapping[int, tuple[float, Record]]],
    blocks: Sequence[_Block],
    split: str,
    baseline: str,
) -> dict[str, Any]:
    """Return the cells of one scenario; rows without all episodes are scored on the episodes that they have."""
    scores: dict[str, FloatArray | str] = {
        "random": np.array(played["random"]["scores"]),
        "plan": np.array(played["plan"]["scores"]),
    }
    gaps: dict[str, FloatArray] = {}
    for row in rows:
        if row.records:
            games = entered[row.name]
            entries = np.full(len(played["random"]["scores"]), np.nan)
            entries[list(games)] = [score for score, _ in games.values()]
            scores[row.name] = entries if games else "nobody has played it yet"
            continue
        if row not in fitting:
            scores[row.name] = f"was trained in {row.scenario}"
            continue
        test = [played[f"row-{_file_name(row.name)}-{block.first}-{block.count}"] for block in blocks]
        refused = next((part["reason"] for part in test if part["scores"] is None), None)
        scores[row.name] = refused if refused is not None else np.concatenate([part["scores"] for part in test])
        if refused is None and spec.world.draws and split != "train":
            train = [played[f"row-{_file_name(row.name)}-{block.first}-{block.count}-train"] for block in blocks]
            gaps[row.name] = np.concatenate([part["scores"] for part in train])
    # Whoever knows the world can do what the others did there.
    known = [values for values in scores.values() if not isinstance(values, str)]
    random, best = scores["random"], np.fmax.reduce([foreseen(planned), *known])
    assert not isinstance(random, str)
    scores["oracle"] = best
    # A replication is on the scale of its own worlds, so that it is not better for having had easy ones.
    scales = [
        {"first": b.first, "count": b.count}
        | {"random": float(b.of(random).mean()), "oracle": float(b.of(best).mean())}
        for b in blocks
    ]
    cells: dict[str, Any] = {}
    for name, values in scores.items():
        if isinstance(values, str):
            cells[name] = missing(values)
            continue
        there = np.isfinite(values)
        other, runs = scores[baseline], len(_row_named(rows, name).policies)
        beside = None if name == baseline or isinstance(other, str) else other
        measured = on_scale(values, random, best, runs_of(runs, len(blocks), len(values)), beside, gaps.get(name))
        if measured is None:
            cells[name] = missing("no policy scores above random play in these episodes: there is no scale")
            continue
        blockwise = [block.first + np.flatnonzero(block.of(there)) for block in blocks]
        # Where nobody is above random play there is no scale, and no replication.
        parts = [own for own in blockwise if len(own) and best[own].mean() > random[own].mean()]
        cells[name] = {
            **measured,
            "replications": _replications(values, random, best, parts),
            "scores": [score if there[k] else None for k, score in enumerate(values.tolist())],
        }
        if (own_row := _row_named(rows, name)).seats:
            cells[name]["seats"] = own_row.effort(spec.name)
        if name in gaps:
            cells[name]["train_scores"] = gaps[name].tolist()
        if beside is not None and not there.all():  # in the other episodes worlds are easier, or harder
            cells[name]["baseline"] = _replications(beside, random, best, parts)
    return {
        "scenario_hash": scenario_hash(spec),
        "replications": scales,
        "plans": played["plan"]["plans"],
        "cells": cells,
    }


def _replications(
    scores: FloatArray, random: FloatArray, best: FloatArray, parts: Sequence[npt.NDArray[np.intp]]
) -> list[float]:
    """The mean of each part of the episodes, on that part's own scale."""
    return [float(_normalised(scores[own].mean(), random[own].mean(), best[own].mean())) for own in parts]


def _summary(name: str, found: Mapping[str, Any], baseline: str, row: Row) -> dict[str, Any]:
    """A row over all scenarios in which it and the baseline have a cell."""
    there = [
        one["cells"]
        for one in found.values()
        if one["cells"][name]["value"] is not None and one["cells"][baseline]["value"] is not None
    ]
    effort = {"runs": len(row.policies), "hours": row.hours, "steps": row.steps}
    told: dict[str, Any] = {"policy": name, "scenarios": len(there), **effort}
    if not there:
        return {**told, "interquartile_mean": None, "mean": None, "improvement": None, "profile": None}
    own = [cells[name]["replications"] for cells in there]
    other = [cells[name].get("baseline", cells[baseline]["replications"]) for cells in there]
    profile = statistics.performance_profile(own, _THRESHOLDS)
    return {
        **told,
        "interquartile_mean": statistics.interquartile_mean(own).as_dict(),
        "mean": statistics.mean(own).as_dict(),
        "improvement": None if name == baseline else statistics.probability_of_improvement(own, other).as_dict(),
        "profile": [estimate.as_dict() for estimate in profile],
    }


def provenance(budget: str | AuditBudget, chosen: AuditBudget, split: str) -> dict[str, Any]:
    """Return how results were made: worlds, episodes, statistics, versions, machine.

    Args:
        budget: as it was given.
        chosen: what that is.
        split: worlds.
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
    """The commit of the source tree that plays, with ``+`` where files have been changed since; None elsewhere."""
    here = Path(__file__).resolve().parent
    try:
        commit, changed = (
            subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True, timeout=10).stdout
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return commit.strip() + ("+" if changed.strip() else "")


# -- what is written --------------------------------------------------------------------------------------------------


def write_benchmark(
    folder: Path, found: Mapping[str, Any], scenarios: Sequence[Scenario], rows: Sequence[Row], records: int = 1
) -> None:
    """Write a benchmark's findings into a folder; see this module's documentation for the files.

    Args:
        folder: where.
        found: :func:`benchmark`'s findings.
        scenarios, rows: what they are of.
        records: episodes of each row that are recorded, in each scenario.

    Raises:
        DataError: a leaderboard that is there already is none.
    """
    write_text(folder / "benchmark.json", json.dumps(found, indent=1) + "\n")
    write_text(folder / "marl_eval.json", json.dumps(marl_eval(found, rows), indent=1) + "\n")
    written = _recorded(folder, found, scenarios, rows, records)
    write_leaderboard(folder / "leaderboard.json", _lines(found, written))


def marl_eval(found: Mapping[str, Any], rows: Sequence[Row]) -> dict[str, Any]:
    """The findings as marl-eval reads them: {environment: {task: {algorithm: {seed: steps and absolute metrics}}}}.

    ``return`` is on the scale from 0 to 1; of training runs, the steps before the last are their evaluations.
    """
    tasks: dict[str, Any] = {}
    for scenario, one in found["scenarios"].items():
        tasks[scenario] = {}
        for name, cell in one["cells"].items():
            if cell["value"] is None or None in cell["scores"]:  # runs of marl-eval's are equally many of everybody
                continue
            row = _row_named(rows, name)
            algorithm = tasks[scenario][name] = {}
            for k, scale in enumerate(one["replications"]):
                if scale["oracle"] <= scale["random"]:
                    continue
                first, count = scale["first"], scale["count"]
                returns = _normalised(cell["scores"][first : first + count], scale["random"], scale["oracle"])
                curve = row.curves[k % len(row.curves)] if row.curves else ()
                steps = {}
                for i, (step, mean) in enumerate(curve):
                    reached = float(_normalised(mean, scale["random"], scale["oracle"]))
                    steps[f"step_{i}"] = {"step_count": step, "return": [reached]}
                steps[f"step_{len(curve)}"] = {"step_count": row.steps or 0, "return": returns.tolist()}
                algorithm[f"seed_{k}"] = {**steps, "absolute_metrics": {"return": [float(returns.mean())]}}
    return {"chemlab": tasks}


def _recorded(
    folder: Path, found: Mapping[str, Any], scenarios: Sequence[Scenario], rows: Sequence[Row], count: int
) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Record the first episodes of every row, by scenario and row; given records are all copied."""
    written: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for spec in scenarios:
        cells = found["scenarios"][spec.name]["cells"]
        for row in (Row("plan", ("scripted",)), *rows):
            if cells[row.name]["value"] is None:
                continue
            own = written[spec.name, row.name] = []
            place = folder / "records" / spec.name / _file_name(row.name)
            for record in _records_of(row, spec):  # all of them: nobody plays them again
                seed = record.checked_header().seed or 0
                path = place / f"{seed}{_RECORD}"
                write_text(path, "".join(line.decode().rstrip("\n") + "\n" for line in record.lines))
                score = cells[row.name]["scores"][seed - AUDIT_SEED]
                own.append({"file": path.relative_to(folder).as_posix(), "seed": seed, "score": score})
            for episode in range(min(count, found["budget_episodes"]) if not row.records else 0):
                seed = AUDIT_SEED + episode
                path = place / f"{seed}{_RECORD}"
                env = raw_env(spec, split=found["split"])
                labs = env.laboratories
                policies = make_policies(row.policies[0], labs)
                if row.name == "plan":
                    plans = {tuple(c): tuple(p) for c, p in found["scenarios"][spec.name]["plans"]}
                    policies[MANAGER_AGENT] = ConstantPlan(spec, labs.channels, labs.actions, plans)
                score = record_episode(path, env, policies, seed, force=True).score
                own.append({"file": path.relative_to(folder).as_posix(), "seed": seed, "score": score})
    return written


def _lines(found: Mapping[str, Any], written: Mapping[tuple[str, str], list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """The leaderboard's lines of a benchmark's findings, with the records that were written."""
    lines = []
    summaries = {row["policy"]: row for row in found["rows"]}
    common = {name: found[name] for name in ("split", "seeds", "budget", "baseline", "commit", "versions", "hardware")}
    for scenario, one in found["scenarios"].items():
        for name, cell in one["cells"].items():
            own = {key: cell.get(key) for key in (*_TOLD, "reason") if key != "seats" or key in cell}
            effort = {key: summaries[name][key] for key in ("runs", "hours", "steps")}
            told = {"scenario": scenario, "scenario_hash": one["scenario_hash"], "policy": name}
            lines.append({**told, **own, **effort, "records": written.get((scenario, name), []), **common})
    return lines
