"""A training run's files, as training writes them, for tests of what is made from them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chemlab.agents.runs import CurvePoint, Evaluation, Run, RunConfig, RunResult

HEURISTIC = 0.5
"""What the scripted policy gets for every goal."""


def write_run(
    path: Path,
    scenario: str,
    bench: str,
    returns: Mapping[str, float],
    *,
    label: str = "any",
    seed: int = 0,
    curve: Sequence[tuple[int, float | None, float | None]] = ((100, 0.1, 0.2), (1000, 0.4, 0.2)),
    evaluations: Mapping[int, float] | None = None,
    finished: bool = True,
    fingerprint: str = "0",
    seconds: float = 60.0,
    **settings: Any,
) -> Path:
    """A run without checkpoints: ``returns`` by goal are the best policy's, 0.1 less the last one's."""
    run = Run(path)
    path.mkdir(parents=True)
    arguments = {"env_id": "chemlab/Any-v0", "algo": label, "steps": 1000, "seed": seed, "starts": "paper", **settings}
    told = {"scenario": scenario, "bench": bench, "goals": list(returns), "fingerprint": fingerprint}
    config = RunConfig(label=label, **told, **arguments)
    run.config_file.write_text(json.dumps(config.model_dump(exclude_none=True)))
    scripted = dict.fromkeys(returns, HEURISTIC)
    for step, value, deviation in curve:
        run.append(CurvePoint(step, value, deviation, 5, 1.0))
    for step, value in (evaluations or {}).items():
        run.append(Evaluation(step, value, dict.fromkeys(returns, value), HEURISTIC, scripted))
    if finished:
        last = {goal: value - 0.1 for goal, value in returns.items()}
        result = RunResult(
            *("chemlab/Any-v0", label, label, seed, int(arguments["steps"]), seconds, 1000.0, 900, 10),
            *(float(np.mean(list(returns.values()))), dict(returns), HEURISTIC, scripted),
            *(float(np.mean(list(last.values()))), last),
        )
        run.result_file.write_text(json.dumps(vars(result)))
    return path


def without_times(run: Run) -> list[Any]:
    """Everything a run writes but how long it took."""
    curve = [{**asdict(point), "seconds": 0} for point in run.curve()]
    result = asdict(run.result())  # type: ignore[arg-type]
    return [curve, run.evaluations(), {**result, "seconds": 0, "frames_per_second": 0}]


def trained(folder: Path, **values: Any) -> RunResult:
    """Train for a moment, and leave the test out where there is nothing to train with; ``values`` are arguments."""
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.arguments import training_arguments
    from chemlab.agents.train.learn import train

    brief = {"envs": 2, "rollout": 16, "steps": 32, "evaluations": 1, "checkpoints": 1}
    return train(training_arguments({**brief, "eval_episodes": 1, "final_episodes": 1, **values}), folder)
