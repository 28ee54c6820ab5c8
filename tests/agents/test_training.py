"""Training: what a run writes, that a killed one comes to the same end, and what it refuses."""

from __future__ import annotations

import errno
import json
import os
import pickle
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3")

import chemlab.scenarios
from chemlab.agents.episodes import play_episode
from chemlab.agents.evaluate.play import Target
from chemlab.agents.learners import load_learner
from chemlab.agents.policies import make_policies, scripted_bench
from chemlab.agents.runs import CurvePoint, Run, RunBusy, find_runs
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.agents.seals import seal_file
from chemlab.agents.train import learn as training
from chemlab.agents.train.arguments import (
    ALGORITHMS,
    Arguments,
    JointArguments,
    RllibArguments,
    TrainArguments,
    label_of,
    resolved,
)
from chemlab.agents.train.learn import train
from chemlab.agents.train.tasks import BenchTask, LaboratoryTask
from chemlab.cli import app
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.bench_env import BenchEnv

SMALL: dict[str, Any] = {
    "envs": 2,
    "rollout": 32,
    "steps": 6 * 64,
    "evaluations": 3,
    "checkpoints": 6,
    "eval_episodes": 1,
    "final_episodes": 2,
}
RXN, DIT = "chemlab/FictitiousReaction-v0", "chemlab/WurtzDistillation-v0"


def small(algo: str, **more: Any) -> TrainArguments:
    """Arguments of a run of a second."""
    discrete = ("dqn", "qr-dqn", "maskable-ppo", "maskable-recurrent-ppo", "a2c")
    values = {"env_id": DIT if algo in discrete else RXN, "algo": algo, **SMALL, **more}
    if algo in ("dqn", "qr-dqn", "sac", "td3"):
        # A memory of 150 rows of 2 is written over before the run's 192 rows are through.
        values = {"gradient_steps": 2, "batch_size": 8, "buffer_size": 300, **values}
    if "recurrent" in algo:
        values = {"memory": 16, **values}
    return TrainArguments.of(values)


def weights(run: Run, algo: str, kind: str = "last") -> Any:
    """All parameters of a checkpoint in one array."""
    folder = run.checkpoint(kind)
    assert folder is not None
    model = load_learner(folder, algo)
    return np.concatenate([p.detach().numpy().ravel() for p in model.policy.parameters()])


class Killed(BaseException):
    """As a signal would, it stops a run where it is."""


class Stop:
    """Stops a run at its n-th rollout, before or after that rollout's checkpoint."""

    def __init__(self, rounds: int) -> None:
        self.rounds = rounds
        self.first = -1

    def begun(self, step: int, steps: int) -> None:
        self.first = step

    def advanced(self, step: int, mean: float | None) -> None:
        self.rounds -= 1
        if self.rounds == 0:
            raise Killed

    def evaluated(self, evaluation: Any, best: bool) -> None: ...

    def finishing(self) -> None: ...


def without_times(run: Run) -> list[Any]:
    """Everything a run writes but how long it took."""
    curve = [{**asdict(point), "seconds": 0} for point in run.curve()]
    result = asdict(run.result())  # type: ignore[arg-type]
    return [curve, run.evaluations(), {**result, "seconds": 0, "frames_per_second": 0}]


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_a_run_that_stops_twice_comes_to_the_same_end(algo: str, tmp_path: Path) -> None:
    # Checkpoints at rollouts 2, 4 and 6, so that the first stop loses a rollout.
    arguments = small(algo, checkpoints=3)
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    for stop, resumed_at in ((3, 0), (2, 2 * 64)):
        watcher = Stop(stop)
        with pytest.raises(Killed):
            train(arguments, broken.path, watcher)
        assert watcher.first == resumed_at
        assert broken.result() is None
    watcher = Stop(99)
    train(arguments, broken.path, watcher)
    assert watcher.first == 4 * 64
    assert without_times(broken) == without_times(whole)
    assert [point.step for point in whole.curve()] == [64 * i for i in range(1, 7)]
    assert sum(point.episodes for point in whole.curve()) > 0
    np.testing.assert_array_equal(weights(broken, algo), weights(whole, algo))
    np.testing.assert_array_equal(weights(broken, algo, "best"), weights(whole, algo, "best"))
    left = {path.name.partition("-")[0] for path in broken.checkpoints.iterdir()}
    assert left == {"last", "best", "lock"}, "one of each, and no replay memory of a finished run"
    other = Run(tmp_path / "other")
    train(small(algo, checkpoints=3, seed=1), other.path)
    assert not np.array_equal(weights(other, algo), weights(whole, algo))


def test_a_crash_after_the_last_step(tmp_path: Path) -> None:
    """Only the final evaluation is missing: it is made up for, and nothing is trained."""
    arguments, whole, broken = small("a2c"), Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    watcher = Stop(99)
    watcher.finishing = lambda: watcher.advanced(0, None)  # type: ignore[method-assign]
    watcher.rounds = 7
    with pytest.raises(Killed):
        train(arguments, broken.path, watcher)
    assert broken.result() is None
    watcher = Stop(1)
    train(arguments, broken.path, watcher)
    assert watcher.first == 384
    assert without_times(broken) == without_times(whole)


def test_lines_that_were_lost_before_the_checkpoint_come_back(tmp_path: Path) -> None:
    """As after ``git checkout``, which puts curves back and knows nothing of checkpoints."""
    arguments = small("ppo", checkpoints=6)
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    with pytest.raises(Killed):
        train(arguments, broken.path, Stop(4))
    for file in (broken.curve_file, broken.evaluations_file):
        file.write_text("".join(file.read_text().splitlines(keepends=True)[:1]))
    train(arguments, broken.path)
    assert without_times(broken) == without_times(whole)


COMMAND = [sys.executable, "-m", "chemlab", "train"]


def start(arguments: TrainArguments, out: Path) -> subprocess.Popen[str]:
    command = [*COMMAND, arguments.env_id, *arguments.flags(), "--out", str(out), "--quiet"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Until the condition holds, or fail with what the process said."""
    deadline = time.monotonic() + 600
    while not condition():
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.slow
def test_kill_9_at_any_moment(tmp_path: Path) -> None:
    """Killed twice by the system, at moments nobody chose, it still says where it goes on and ends the same."""
    arguments = small("ppo", steps=100 * 64, checkpoints=100, evaluations=5)
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)

    def step() -> int:
        last = broken.checkpoint("last")
        return 0 if last is None else int(last.name.partition("-")[2])

    for least in (10 * 64, 40 * 64):
        process = start(arguments, broken.path)
        wait_for(lambda least=least: step() >= least, process)  # type: ignore[misc]
        process.kill()
        said = process.communicate()[0]
        assert broken.result() is None
        assert ("resuming at step" in said) == (least > 10 * 64)
    reached = step()
    process = start(arguments, broken.path)
    said = process.communicate()[0]
    assert process.returncode == 0, said
    assert f"resuming at step {reached:,} of 6,400" in said
    assert without_times(broken) == without_times(whole)
    seconds = [point.seconds for point in broken.curve()]
    assert seconds == sorted(seconds)
    np.testing.assert_array_equal(weights(broken, "ppo"), weights(whole, "ppo"))


def test_tensorboard_shows_no_gap_and_nothing_twice(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    arguments = small("a2c", checkpoints=3)
    with pytest.raises(Killed):
        train(arguments, tmp_path, Stop(3))
    time.sleep(1.1)  # files are told apart, and put in order, by the second they were begun in
    train(arguments, tmp_path)
    shown = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [event.step for event in shown.Scalars("rollout/ep_rew_mean")] == [64 * i for i in range(1, 7)]
    assert [event.step for event in shown.Scalars("eval/mean_reward")] == [64 * i for i in (2, 4, 6)]


FULL = """
import resource, signal, sys
from pathlib import Path
from chemlab.agents.runs import Run
from chemlab.agents.train.loop import _tensorboard
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    with _tensorboard(Run(Path(sys.argv[1])), 0) as logger:
        for step in range(1_000_000):
            logger.record("rollout/ep_rew_mean", 1.0)
            logger.dump(step)
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_tensorboard_on_a_full_disk_is_one_line(tmp_path: Path) -> None:
    """Its thread dies of it, too, and says nothing of its own."""
    done = subprocess.run([sys.executable, "-c", FULL, tmp_path], capture_output=True, text=True, check=True)
    assert done.stdout == f"[Errno {errno.EFBIG}] {os.strerror(errno.EFBIG)}: '{tmp_path / 'tensorboard'}'\n"
    assert "Traceback" not in done.stderr


def test_a_checkpoint_of_another_version_is_not_gone_on_with(tmp_path: Path) -> None:
    """Least of all from step 0, over what has been learned."""
    with pytest.raises(Killed):
        train(small("a2c"), tmp_path, Stop(3))
    last = Run(tmp_path).checkpoint("last")
    assert last is not None
    state = pickle.loads((last / "state.pkl").read_bytes())
    del state["progress"]["step"]
    (last / "state.pkl").write_bytes(pickle.dumps(state))
    seal_file(last / "state.pkl")
    with pytest.raises(ValueError, match=f"{last.name}: not a checkpoint of this version; delete the run's folder"):
        train(small("a2c"), tmp_path)


def test_a_crash_while_a_checkpoint_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a checkpoint is not taken for one; the one before is still there."""
    arguments = small("sac", checkpoints=6)
    whole = Run(tmp_path / "whole")
    train(arguments, whole.path)
    run = Run(tmp_path / "broken")
    from chemlab.agents.train import checkpoints

    renamed, calls = checkpoints._renamed, []

    def crash(draft: Path, final: Path) -> None:
        calls.append(final.name)
        if final.name == "last-192":
            raise Killed
        renamed(draft, final)

    monkeypatch.setattr(checkpoints, "_renamed", crash)
    with pytest.raises(Killed):
        train(arguments, run.path)
    assert (run.checkpoints / "new-192").is_dir()
    assert (run.checkpoints / "replay" / "64-96.npz").exists()
    last = run.checkpoint("last")
    assert last is not None
    assert last.name == "last-128"
    with run.curve_file.open("a") as handle:
        handle.write('{"step": 256, "ret')
    monkeypatch.setattr(checkpoints, "_renamed", renamed)
    train(arguments, run.path)
    assert without_times(run) == without_times(whole)
    np.testing.assert_array_equal(weights(run, "sac"), weights(whole, "sac"))


def test_a_finished_run_is_not_run_again_and_another_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = CliRunner()
    flags = ["train", RXN, *small("ppo").flags(), "--out", str(tmp_path / "run")]
    first = runner.invoke(app, [*flags, "--json"])
    assert first.exit_code == 0, first.output
    result = Run(tmp_path / "run").result()
    assert result is not None
    assert json.loads(first.stdout)["mean"] == result.mean
    monkeypatch.setattr(training, "_Agent", None)
    again = runner.invoke(app, flags)
    assert again.exit_code == 0, again.output
    assert "is finished" in again.output
    assert f"{result.mean:.3f}" in again.output
    refused = runner.invoke(app, [*flags, "--learning-rate", "0.01"])
    assert refused.exit_code == 2
    assert "learning_rate None (now 0.01)" in refused.output
    assert "--out" in refused.output
    config = Run(tmp_path / "run").config()
    assert config is not None
    Run(tmp_path / "run").config_file.write_text(json.dumps({**config, "fingerprint": "another"}))
    changed = runner.invoke(app, flags)
    assert changed.exit_code == 2
    assert "has changed since" in changed.output


def test_two_processes_do_not_train_one_run(tmp_path: Path) -> None:
    run = Run(tmp_path)
    assert not run.busy()
    with run.locked():
        assert run.busy()
        with pytest.raises(RunBusy, match="another process"):
            train(small("ppo"), tmp_path)
    assert not run.busy()


def test_who_only_looks_does_not_keep_a_run_from_beginning(tmp_path: Path) -> None:
    """A sweep looks at its runs all the time, and holds each for a moment."""
    run, held = Run(tmp_path), threading.Event()

    def look() -> None:
        with run.locked():
            held.set()
            time.sleep(0.1)

    looking = threading.Thread(target=look)
    looking.start()
    assert held.wait(10.0)
    with run.locked():
        pass
    looking.join()


def test_results_say_what_was_trained_and_what_came_of_it(tmp_path: Path) -> None:
    arguments = small("ppo", goals=["F", "E"], starts="paper")
    result = train(arguments, tmp_path)
    (run,) = find_runs(tmp_path)
    config = run.config()
    assert config is not None
    # These go without saying, as they did before there were others.
    assert {f.name for f in fields(TrainArguments)} - {"split", "actions", "memory", "advice"} <= set(config)
    assert [config[key] for key in ("scenario", "bench", "goals", "label")] == ["fictitious", "rxn", ["F", "E"], "ppo"]
    assert config["gamma"] == 0.99
    assert {"chemlab", "torch", "stable-baselines3"} <= set(config["versions"])
    assert result.steps == 384
    assert list(result.by_goal) == ["F", "E"]
    assert result.mean == pytest.approx(sum(result.by_goal.values()) / 2)
    evaluations = run.evaluations()
    assert [evaluation.step for evaluation in evaluations] == [128, 256, 384]
    assert result.best_step == max(evaluations, key=lambda e: (e.mean, -e.step)).step
    best = run.checkpoint("best")
    assert best is not None
    assert best.name == f"best-{result.best_step}"
    assert run.result() == result


def test_evaluations_are_single_environments_with_the_same_seeds() -> None:
    task = BenchTask("wurtz_dodecane", "dit", ("NaCl", "dodecane"))
    policy = scripted_bench(task.workplace)
    returns = task.returns(policy, 2, 50)
    np.testing.assert_array_equal(returns, task.returns(policy, 2, 50))
    env = BenchEnv("wurtz_dodecane", "dit")
    for g, goal in enumerate(task.goals):
        for i in range(2):
            observation, info = env.reset(seed=50 + i, options={"goal": goal})
            total, step, over = 0.0, 0, False
            while not over:
                action = policy.act(observation[None], info["action_mask"][None], np.array([step]), np.array([0]))
                observation, reward, over, _, info = env.step(int(action[0]))
                total, step = total + reward, step + 1
            assert returns[g, i] == pytest.approx(total, abs=1e-12)


def test_the_weight_of_sacs_entropy_begins_where_it_is_told_to(tmp_path: Path) -> None:
    for arguments, start in ((small("sac"), 1.0), (small("sac", ent_coef_start=0.01), 0.01)):
        venv = ChemlabVecEnv(2, scenario="fictitious", bench="rxn")
        model: Any = training._learner(resolved(arguments), venv, 1000)
        assert model.log_ent_coef.exp().item() == pytest.approx(start)
    assert TrainArguments.of({"preset": "sac-cool"}).algo == "sac"
    for values, message in (
        ({"algo": "ppo", "ent_coef_start": 0.1}, "is for sac"),
        ({"algo": "sac", "ent_coef_start": 0.0}, "must be above 0"),
        ({"algo": "sac", "ent_coef_start": 0.1, "ent_coef": 0.1}, "ent_coef fixes it"),
    ):
        with pytest.raises(ValueError, match=message):
            TrainArguments.of(values)


# -- arguments --------------------------------------------------------------------------------------------------------


def test_flags_win_over_the_file_and_the_file_over_the_preset(tmp_path: Path) -> None:
    file = tmp_path / "train.toml"
    file.write_text('preset = "ppo-xl"\nsteps = 1e5\nseed = 4\nnet_arch = [32, 32]\n')
    arguments = TrainArguments.load(file, {"seed": 7, "gamma": None})
    assert (arguments.steps, arguments.seed, arguments.envs, arguments.net_arch) == (100_000, 7, 32, (32, 32))
    assert label_of(arguments) == "ppo-xl"
    assert label_of(replace(arguments, algo="a2c")) == "ppo-xl-a2c"
    assert arguments.folder() == Path("WurtzReaction", "ppo-xl", "seed-7")
    assert TrainArguments.of({}) == TrainArguments()


def test_the_papers_protocol_is_the_default() -> None:
    ppo, dqn = resolved(TrainArguments.of({})), resolved(TrainArguments.of({"algo": "dqn"}))
    assert (ppo.envs, ppo.rollout, ppo.steps) == (10, 256, 1_000_000)
    assert (dqn.buffer_size, dqn.exploration_steps, dqn.exploration_final) == (1_000_000, 30_000, 0.01)
    assert ppo.buffer_size is None


def test_dqn_explores_as_the_paper_says(tmp_path: Path) -> None:
    train(small("dqn", exploration_steps=192, exploration_final=0.25), tmp_path)
    folder = Run(tmp_path).checkpoint("last")
    assert folder is not None
    schedule = load_learner(folder, "dqn").exploration_schedule  # type: ignore[attr-defined]
    # The schedule takes what is left of the run's 384 steps.
    assert [schedule(left) for left in (1.0, 0.75, 0.5, 0.1)] == pytest.approx([1.0, 0.625, 0.25, 0.25])


def test_flags_say_the_same_as_arguments() -> None:
    arguments = small("sac", goals=["E", "F"], learning_rate=1e-3)
    flags = arguments.flags()
    assert flags.count("--goals") == 2
    pairs = dict(zip(flags[::2], flags[1::2], strict=True))
    assert (pairs["--rollout"], pairs["--learning-rate"]) == ("32", "0.001")
    assert "--starts" not in flags


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"algo": "reinforce"}, "known: ppo, a2c"),
        ({"preset": "huge"}, "known: paper, .*ppo-xl"),
        ({"stepz": 3}, "did you mean steps"),
        ({"steps": "many"}, "needs int, given 'many'"),
        ({"steps": True}, "needs int, given True"),
        ({"steps": 0}, "at least 1, given 0"),
        ({"goals": [1]}, "list of str"),
        ({"buffer_size": 10}, "is for dqn, qr-dqn, sac, td3, not for ppo"),
        ({"learning_rate": -1.0}, "above 0"),
        ({"imitate_rounds": 3}, "nobody is imitated"),
    ],
)
def test_wrong_arguments(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TrainArguments.of(values)


KINDS: tuple[type[Arguments], ...] = (TrainArguments, JointArguments, RllibArguments)
NAN, INFINITY = float("nan"), float("inf")
NONSENSE: dict[str, tuple[Any, ...]] = {
    "steps": (0, -1),
    "seed": (-1, 2**32),
    "envs": (0,),
    "learning_rate": (0.0, -1e-3, NAN, INFINITY),
    "gamma": (-0.1, 1.5, NAN),
    "manager_gamma": (-0.1, 1.5, NAN),
    "gae_lambda": (-1.0, 1.01, NAN),
    "ent_coef": (-0.01, NAN, INFINITY),
    "ent_coef_start": (0.0, -1.0, NAN, INFINITY),
    "clip_range": (0.0, -0.2, NAN, INFINITY),
    "batch_size": (1, 0, -5),
    "epochs": (0,),
    "evaluations": (0,),
    "eval_episodes": (0,),
    "final_episodes": (0,),
    "checkpoints": (0,),
    "imitate_steps": (0,),
    "imitate_rounds": (0,),
    "imitate_spread": (0.0, -0.1, 1.5, NAN, INFINITY),
    "rollout": (0,),
    "gradient_steps": (0, -1),
    "buffer_size": (0,),
    "learning_starts": (-1,),
    "exploration_steps": (0,),
    "exploration_final": (-0.1, 1.1, NAN),
    "action_noise": (-0.1, NAN, INFINITY),
    "net_arch": ((64, 0), (-1,)),
    "memory": (0,),
    "period": (0,),
    "runners": (0,),
    "batch": (0,),
}
EDGES: dict[str, tuple[Any, ...]] = {
    "seed": (0, 2**32 - 1),
    "gamma": (0.0, 1.0),
    "manager_gamma": (0.0, 1.0),
    "gae_lambda": (0.0, 1.0),
    "ent_coef": (0.0,),
    "exploration_final": (0.0, 1.0),
    "action_noise": (0.0,),
    "learning_starts": (0,),
    "batch_size": (2,),
}


def fitting(kind: type[Arguments], name: str) -> dict[str, Any]:
    """Arguments among which a field may be given at all."""
    if kind is not TrainArguments:
        return {}
    others = {"exploration_steps": "dqn", "exploration_final": "dqn", "action_noise": "td3", "ent_coef_start": "sac"}
    others["memory"] = "recurrent-ppo"
    replay = ("gradient_steps", "buffer_size", "learning_starts")
    return {"algo": others.get(name, "sac" if name in replay else "ppo")}


@pytest.mark.parametrize("kind", KINDS)
def test_nonsense_is_refused_by_name(kind: type[Arguments]) -> None:
    """Every number of every kind of run, however it is given, and nothing that is no number."""
    numbers = {f.name for f in fields(kind) if {"int", "float"} & set(re.findall(r"\w+", str(f.type)))}
    assert numbers <= set(NONSENSE)
    for name in numbers:
        for value in NONSENSE[name]:
            with pytest.raises(ValueError, match=f"{name}: must be "):
                kind(**fitting(kind, name), **{name: value})
            with pytest.raises(ValueError, match=f"{kind.command}: {name}: must be "):
                kind.load(None, {**fitting(kind, name), name: value})
        for value in EDGES.get(name, ()):
            kind(**fitting(kind, name), **{name: value})


def test_nonsense_in_a_file_and_on_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "train.toml"
    file.write_text("clip_range = nan\n")
    with pytest.raises(ValueError, match=f"^{re.escape(str(file))}: clip_range: must be a finite number, given nan$"):
        TrainArguments.load(file, {})
    for command in (["train", RXN], ["train-together", "wurtz_dodecane"], ["train-rllib", "wurtz_dodecane"]):
        result = CliRunner().invoke(app, [*command, "--gae-lambda", "nan", "--out", str(tmp_path / "run")])
        assert result.exit_code == 2
        assert f"{command[0]}: gae_lambda: must be a finite number, given nan" in result.output.replace("\n", " ")
    assert not (tmp_path / "run").exists()


def test_a_minibatch_of_one_is_refused_where_it_would_make_weights_that_are_no_numbers() -> None:
    with pytest.raises(ValueError, match="batch_size: of the 65 steps of a rollout a single one would be left"):
        TrainArguments(DIT, algo="maskable-ppo", envs=5, rollout=13)
    TrainArguments(DIT, algo="maskable-ppo", envs=5, rollout=13, batch_size=33)
    with pytest.raises(ValueError, match="rollout: PPO needs at least 2 steps"):
        TrainArguments(RXN, envs=1, rollout=1)


def test_training_on_an_empty_vessel_is_spoken_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench of somebody's own, which has no scripted policy to be evaluated beside either."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "bench"))
    file = tmp_path / "with_filter.toml"
    entry = '\n[benches.fil]\nkind = "filtration_bench:FiltrationBench"\nstep_limit = 5\n'
    file.write_text((Path(chemlab.scenarios.__path__[0]) / "wurtz_dodecane.toml").read_text() + entry)
    short = {**SMALL, "env_id": "chemlab/Bench-v0", "scenario": str(file), "bench": "fil", "steps": 64}
    said = r"'fil' of wurtz_dodecane: .* empty vessel, .* no \[benches.fil.start\]; give it contents .moles by mat"
    with pytest.warns(UserWarning, match=said):
        result = train(TrainArguments.of(short), tmp_path / "empty")
    assert result.scripted_mean is None
    assert Run(tmp_path / "empty").evaluations()[0].scripted_by_goal is None


def test_where_vessels_can_be_recorded_that_is_the_advice() -> None:
    values = load_scenario("wurtz_dodecane").model_dump()
    assert BenchTask(load_scenario(values), "ext").warning() is None
    values["benches"]["ext"]["start"] = {}
    said = BenchTask(load_scenario(values), "ext").warning()
    assert said is not None
    assert said.endswith("record vessels with chemlab starts wurtz_dodecane, and train with --starts lab")
    assert BenchTask(load_scenario(values), "ext", starts="lab").warning() is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"env_id": "chemlab/Nothing-v0"}, "known: chemlab/WurtzReaction-v0"),
        ({"env_id": "CartPole-v1"}, "env_id: known"),
        ({"scenario": "fictitious"}, "has 'wurtz_dodecane'"),
        ({"goals": ["gold"]}, "goals: wurtz_dodecane has"),
        ({"algo": "dqn"}, "actions are continuous"),
        ({"env_id": DIT, "algo": "sac"}, "actions are discrete"),
    ],
)
def test_arguments_that_do_not_fit_the_bench(values: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        train(TrainArguments.of(values), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("wrong", [{"imitate": "heuristc"}, {"imitate": "nowhere/at/all"}, {"advice": "heuristc"}])
def test_a_mistyped_policy_leaves_nothing_behind(wrong: dict[str, str], tmp_path: Path) -> None:
    """Whom to learn from is looked up before anything is written; the right name may follow in the same folder."""
    values = {**SMALL, "env_id": "chemlab/LabManager-v0", "algo": "maskable-ppo", "scenario": "wurtz_any"}
    with pytest.raises(ValueError, match=next(iter(wrong.values()))):
        train(TrainArguments.of({**values, **wrong}), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_that_fails_before_its_first_checkpoint_does_not_hold_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever goes wrong there; one that was stopped by its user goes on."""
    run, values = Run(tmp_path / "run"), {**SMALL, "env_id": RXN, "algo": "ppo"}
    for error, holds in ((RuntimeError("no memory"), False), (KeyboardInterrupt(), True)):

        def fail(*_: Any, error: BaseException = error, **__: Any) -> None:
            raise error

        with monkeypatch.context() as patch:
            patch.setattr(training, "train_in_rounds", fail)
            with pytest.raises(type(error)):
                train(TrainArguments.of(values), run.path)
        assert run.config_file.exists() is holds
        if not holds:
            values |= {"seed": 7}
    with pytest.raises(ValueError, match="holds a run with other arguments: seed 7"):
        train(TrainArguments.of({**values, "seed": 8}), run.path)


def test_a_value_based_learner_on_a_reaction_bench_plays_the_bench_with_numbers(tmp_path: Path) -> None:
    """What DQN has learned of the discretised bench comes to the same where it plays the continuous one."""
    result = train(small("dqn", actions="discrete", env_id=RXN), tmp_path / "run")
    assert Run(tmp_path / "run").config()["actions"] == "discrete"
    scenario = load_scenario("fictitious")
    ours, theirs = (
        Target(scenario.with_actions(kind), "rxn").play(str(tmp_path / "run"), "G", 3, 7).returns
        for kind in ("native", "discrete")
    )
    np.testing.assert_array_equal(ours, theirs)
    assert set(result.by_goal) == set(scenario.goals)
    assert train(small("dqn", actions="discrete", env_id=RXN), tmp_path / "run") == result
    with pytest.raises(ValueError, match="or with --actions discrete dqn or qr-dqn or maskable-ppo"):
        train(small("dqn", env_id=RXN), tmp_path / "other")


def test_a_recurrent_learner_is_not_for_benches_that_a_laboratory_begins_anew(tmp_path: Path) -> None:
    values = {"env_id": "chemlab/LabAgent-v0", "bench": "rxn_0", "algo": "recurrent-ppo"}
    with pytest.raises(ValueError, match="begins anew with each experiment"):
        train(TrainArguments.of(values), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_without_the_extra_the_error_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("learn", "loop"):
        monkeypatch.delitem(sys.modules, f"chemlab.agents.train.{module}")
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    result = CliRunner().invoke(app, ["train", RXN, "--steps", "1", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert 'pip install ".[train]"' in result.output.replace("\n", "")


def test_curves_survive_a_cut_line(tmp_path: Path) -> None:
    run = Run(tmp_path)
    points = [CurvePoint(step, 0.5, 0.1, 3, 1.0) for step in (10, 20, 30)]
    for point in points:
        run.append(point)
    with run.curve_file.open("a") as handle:
        handle.write('{"step": 4')
    assert run.curve() == points
    run.rewind(20)
    assert run.curve() == points[:2]
    assert os.path.getsize(run.evaluations_file) == 0


def test_a_role_of_a_laboratory_is_a_task() -> None:
    """What the scripted manager and a scripted bench come to is what whole episodes say."""
    env = raw_env("wurtz_dodecane")
    results = [play_episode(env, make_policies("scripted", env.laboratories), seed) for seed in (4, 5)]
    manager = LaboratoryTask("wurtz_dodecane")
    assert manager.returns(manager.policy("scripted"), 2, 4).tolist() == [[result.score for result in results]]
    bench = LaboratoryTask("wurtz_dodecane", "ext_0")
    expected = [result.rewards["ext_0"] for result in results]
    assert bench.returns(bench.policy("scripted"), 2, 4)[0] == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ValueError, match="goals: wurtz_dodecane asks for dodecane, given gold"):
        LaboratoryTask("wurtz_dodecane", goals=("gold",))
