"""Seconds that a manager over scripted benches learns, from nothing, until it reaches a score.

``python studies/baselines/time_to_score.py LEARNER SCENARIO --seeds 1 2 3`` measures runs of a learner of ``LEARNERS``
and adds them to ``results/time_to_score.json``; without arguments the table of docs/training.md is written from that
file. Seconds are those of the processor, in one thread, in rollouts and updates alone: kernels compile, networks are
made and episodes of evaluation are played at no cost. Every learner is evaluated after as many of these seconds, on the
same ``validation`` episodes, greedily and sampled; the better score counts. A score is reached at the first of two
evaluations in a row at or above it.

BenchMARL (recipes/value_based.py) has an environment of its own. Its steps are rounds of a laboratory, in most of which
the manager has no turn; steps of the others are the manager's turns.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.logger import Logger

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import Run
from chemlab.agents.train.arguments import IPPO, training_arguments
from chemlab.agents.train.joint import Team
from chemlab.agents.train.loop import EVALUATION_SEED, Progress
from chemlab.agents.train.single import Agent
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between, write_json
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT
from chemlab.envs.players import Policy, as_policy
from chemlab.lab.engine import Laboratories

SCORES = Path(__file__).parent / "results" / "time_to_score.json"
PAGE = Path(__file__).parent.parent.parent / "docs" / "training.md"
SPLIT, EPISODES = "validation", 50
STEPS = {"wurtz_dodecane": 150_000, "rush": 300_000}
"""Length of a run of ``ippo``, whose rates and helps fade by it; the other learners keep theirs."""
TARGETS = {"rush": 0.08}
"""Raw scores to reach."""
EVERY = 2.0
"""Seconds between evaluations, besides a twentieth of those before; a learner may have longer rollouts."""
_COMMON = {"envs": 256, "rollout": 16, "batch_size": 256, "ent_coef": 0.01}
LEARNERS: dict[str, dict[str, Any]] = {
    "ippo": {"algo": "ippo"},
    "maskable-ppo": _COMMON | {"algo": "maskable-ppo", "gamma": 1.0},
    "BenchMARL IPPO": _COMMON
    | {"algorithm": "Ippo", "gamma": 0.999, "gae_lambda": 0.95, "learning_rate": 3e-4, "epochs": 10},
}
FASTER = {("maskable-ppo", "rush"): {"epochs": 4, "learning_rate": 1e-3}}
"""Other settings of a row: the fastest of short trials on other seeds."""


def played(scenario: str, manager: Policy | None) -> float:
    """Return the mean score of a manager over scripted benches, of the scripted one where none is given."""
    spec = load_scenario(scenario)
    labs = Laboratories(spec, EPISODES, split=SPLIT)
    policies = make_policies("scripted", labs)
    if manager is not None:
        policies[MANAGER_AGENT] = manager
    goals = [play_laboratory(labs, policies, goal, EVALUATION_SEED).returns.mean() for goal in spec.lab_goals]
    return float(statistics.mean(map(float, goals)))


def asked(scenario: str) -> float:
    """Return the raw score to reach: 0.9 times the scripted one, or what ``TARGETS`` states."""
    return TARGETS[scenario] if scenario in TARGETS else 0.9 * played(scenario, None)


class Watch:
    """A run's clock and evaluations.

    Args:
        target: the score to reach.
        cap: seconds after which the run is given up.
        every: seconds between evaluations, besides a twentieth of those before.
        score: returns the present policy's score, sampled or greedy.
    """

    def __init__(self, target: float, cap: float, every: float, score: Callable[[bool], float]) -> None:
        self.target, self.cap, self.every, self._score = target, cap, every, score
        self.points: list[tuple[float, int, float]] = []
        self.seconds, self._begun = 0.0, time.process_time()

    def begin(self) -> None:
        """Start the clock."""
        self._begun = time.process_time()

    def stop(self, step: int) -> bool:
        """Stop the clock, and evaluate if it is time to; return whether the run is over."""
        self.seconds += time.process_time() - self._begun
        if self.seconds >= (1.05 * self.points[-1][0] if self.points else 0.0) + self.every:
            self.points.append((round(self.seconds, 1), step, round(max(map(self._score, (False, True))), 4)))
            print(*self.points[-1], flush=True)
        return self.reached() is not None or self.seconds >= self.cap

    def reached(self) -> tuple[float, int, float] | None:
        """Return the first of two evaluations in a row at or above the target, if there are any."""
        pairs = zip(self.points, self.points[1:], strict=False)
        return next((one for one, two in pairs if min(one[2], two[2]) >= self.target), None)


def chemlab_learner(settings: dict[str, Any], scenario: str, seed: int, watch: Callable[..., Watch]) -> Watch:
    """Run a learner of this package."""
    steps = STEPS[scenario] if settings["algo"] == "ippo" else 10**9
    task = {"scenario": scenario, "roles": "manager", "seed": seed}
    arguments = training_arguments({"steps": steps, **settings, **task})
    trainee = (Team if isinstance(arguments, IPPO) else Agent)(arguments)
    with tempfile.TemporaryDirectory() as folder:
        progress: Progress = trainee.begin(Run(Path(folder)))
        trainee.logger = Logger(None, [])
        clock = watch(lambda sampled: statistics.mean(trainee.scores(EPISODES, EVALUATION_SEED, sampled).values()))
        while progress.step < trainee.steps:
            clock.begin()
            turns, _ = trainee.learn(progress)
            progress.step, progress.rounds = progress.step + turns, progress.rounds + 1
            if clock.stop(progress.step):
                break
    return clock


class _OverError(Exception):
    """A run of BenchMARL is over."""


def benchmarl(settings: dict[str, Any], scenario: str, seed: int, watch: Callable[..., Watch]) -> Watch:
    """Run a learner of BenchMARL."""
    from benchmarl import algorithms
    from benchmarl.experiment import Callback, Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    from chemlab.agents.torchrl.task import laboratory_task

    s, config = settings, ExperimentConfig.get_from_yaml()
    config.on_policy_n_envs_per_worker = s["envs"]
    config.on_policy_collected_frames_per_batch = s["envs"] * s["rollout"]
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = s["batch_size"], s["epochs"]
    config.lr, config.gamma, config.max_n_frames = s["learning_rate"], s["gamma"], 10**9
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    algorithm = getattr(algorithms, f"{s['algorithm']}Config").get_from_yaml()
    algorithm.entropy_coef, algorithm.lmbda = s["ent_coef"], s["gae_lambda"]
    model = MlpConfig(num_cells=[128, 128], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)

    def score(sampled: bool) -> float:
        way = ExplorationType.RANDOM if sampled else ExplorationType.DETERMINISTIC

        def act(observation: Any, mask: Any) -> Any:
            seen = {"observation": torch.as_tensor(observation), "action_mask": torch.as_tensor(mask) > 0}
            agents = TensorDict({name: value[:, None] for name, value in seen.items()}, [len(observation), 1])
            with torch.no_grad(), set_exploration_type(way):
                rows = experiment.group_policies["manager"](TensorDict({"manager": agents}, [len(observation)]))
            return rows["manager", "action"][:, 0].numpy()

        return played(scenario, as_policy(act))

    class Clock(Callback):  # type: ignore[misc]
        def on_train_end(self, training_td: Any, group: str) -> None:
            if clock.stop(experiment.total_frames):
                raise _OverError
            clock.begin()

    state = s["algorithm"] == "Mappo"
    with tempfile.TemporaryDirectory() as folder:
        config.save_folder = folder
        task = laboratory_task(scenario, roles=("manager",), state=state)
        experiment = Experiment(task, algorithm, model, seed, config)
        experiment.callbacks.append(Clock())  # those that are given are written to a file
        clock = watch(score)
        clock.begin()
        try:
            experiment.run()
        except _OverError:
            experiment.close()
    return clock


def measure(learner: str, settings: dict[str, Any], scenario: str, seed: int, cap: float) -> dict[str, Any]:
    """Return what a run has reached and when."""
    target = asked(scenario)  # its episodes also load the kernels
    run = benchmarl if "algorithm" in settings else chemlab_learner
    clock = run(settings, scenario, seed, lambda score: Watch(target, cap, EVERY, score))
    found = clock.reached()
    best, points = max(point[2] for point in clock.points), " ".join(f"{t}:{score}" for t, _, score in clock.points)
    seconds, step = (None, None) if found is None else found[:2]
    task = {"learner": learner, "scenario": scenario, "seed": seed, "target": round(target, 4), "cap": cap}
    return {**task, "seconds": seconds, "steps": step, "best": best, "evaluations": points}


def table(runs: list[dict[str, Any]]) -> list[str]:
    """Return the lines of the table: medians over seeds, of which those count as longest that have not reached it."""
    rows, numbers = [], ("seconds", "of seeds", "steps", "best until then", "reached")
    for scenario, learner in itertools.product(STEPS, LEARNERS):
        own = [run for run in runs if (run["scenario"], run["learner"]) == (scenario, learner)]
        if not own:
            continue
        late = min(run["cap"] for run in own)
        times = sorted(run["seconds"] or math.inf for run in own)
        middle, least, most = (
            f"not within {late:.0f}" if one == math.inf else f"{one:.0f}"
            for one in (statistics.median_high(times), times[0], times[-1])
        )
        steps = [run["steps"] for run in own if run["steps"]]
        cells = [f"`{scenario}`, {own[0]['target']:.3f}", learner, middle]
        cells += [f"{least} to {most}" if len(own) > 1 else "", f"{statistics.median(steps):,.0f}" if steps else ""]
        cells += [f"{statistics.median(run['best'] for run in own):.3f}", f"{len(steps)} of {len(own)}"]
        rows.append(cells)
    return markdown_table({"scenario, raw score": False, "learner": False, **dict.fromkeys(numbers, True)}, rows)


def main() -> None:
    """Measure, if asked, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("learner", nargs="?", choices=LEARNERS)
    parser.add_argument("scenario", nargs="?", choices=STEPS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--cap", type=float, default=300.0, help="seconds of a run (default: %(default)s)")
    parser.add_argument("--set", type=json.loads, default={}, help="other settings, as JSON; such runs are not kept")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for seed in given.seeds if given.scenario else ():
        settings = LEARNERS[given.learner] | FASTER.get((given.learner, given.scenario), {}) | given.set
        new = measure(given.learner, settings, given.scenario, seed, given.cap)
        print(json.dumps(new), flush=True)
        if not given.set:
            runs = json.loads(SCORES.read_text(encoding="utf-8")) if SCORES.exists() else []
            key = ("learner", "scenario", "seed")
            runs = [run for run in runs if [run[name] for name in key] != [new[name] for name in key]]
            write_json(SCORES, [*runs, new])
    if not given.scenario:
        replace_between(PAGE, "time to score", table(json.loads(SCORES.read_text(encoding="utf-8"))))


if __name__ == "__main__":
    main()
