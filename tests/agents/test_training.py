"""Training: what a run writes, that a killed one comes to the same end, and what it refuses."""

import contextlib
import errno
import inspect
import itertools
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from run_files import without_times
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3")

from helpers import command, refused, weights

from chemlab.agents.episodes import play_episode
from chemlab.agents.evaluate.play import Target
from chemlab.agents.learners import LEARNERS, load_learner
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import RESULT_SEED, Run, RunBusy, find_runs, training_seeds
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.agents.seals import seal_file
from chemlab.agents.train import learn as training
from chemlab.agents.train import loop
from chemlab.agents.train.arguments import (
    ALGORITHMS,
    IPPO,
    OLD_NAMES,
    PPO,
    Arguments,
    MaskablePPO,
    Single,
    load_arguments,
    training_arguments,
)
from chemlab.agents.train.checkpoints import commit_checkpoint
from chemlab.agents.train.learn import train
from chemlab.agents.train.loop import Watcher
from chemlab.agents.train.single import Agent, _learner
from chemlab.agents.train.tasks import BenchTask, LaboratoryTask, find_task
from chemlab.cli import app
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env

SMALL: dict[str, Any] = {"envs": 2, "rollout": 32, "steps": 6 * 64, "evaluations": 3, "checkpoints": 6}
SMALL |= {"eval_episodes": 1, "final_episodes": 2}
RXN, DIT = "chemlab/FictitiousReaction-v0", "chemlab/WurtzDistillation-v0"


def small(algo: str, **more: Any) -> Single:
    """Arguments of a run of a second."""
    discrete = ("dqn", "qr-dqn", "maskable-ppo", "maskable-recurrent-ppo", "a2c")
    values = {"scenario": DIT if algo in discrete else RXN, "algo": algo, **SMALL, **more}
    if algo in ("dqn", "qr-dqn", "sac", "td3"):
        # A memory of 150 rows of 2 is written over before the run's 192 rows are through.
        values = {"gradient_steps": 2, "batch_size": 8, "buffer_size": 300, **values}
    if "recurrent" in algo:
        values = {"memory": 16, "epochs": 2, **values}
    made = training_arguments(values)
    assert isinstance(made, Single)
    return made


def weights_of(run: Run, algo: str, kind: str = "last") -> Any:
    """All parameters of a checkpoint in one array."""
    return weights(load_learner(run.checkpoint(kind), algo))  # type: ignore[arg-type]


class Killed(BaseException):
    """As a signal would, it stops a run where it is."""


class Stop(Watcher):
    """Stops a run at its n-th rollout, before or after that rollout's checkpoint."""

    def __init__(self, rounds: int) -> None:
        self.rounds = rounds
        self.first = -1

    def begun(self, step: int, steps: int) -> None:
        self.first = step

    def advanced(self, step: int, mean: float | None, note: str = "") -> None:
        self.rounds -= 1
        if self.rounds == 0:
            raise Killed


@pytest.mark.parametrize("algo", ["ppo", "dqn", "sac", "td3", "maskable-recurrent-ppo"])
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
    np.testing.assert_array_equal(weights_of(broken, algo), weights_of(whole, algo))
    np.testing.assert_array_equal(weights_of(broken, algo, "best"), weights_of(whole, algo, "best"))
    left = {path.name.partition("-")[0] for path in broken.checkpoints.iterdir()}
    assert left == {"last", "best", "lock"}, "one of each, and no replay memory of a finished run"
    other = Run(tmp_path / "other")
    train(small(algo, checkpoints=3, seed=1), other.path)
    assert not np.array_equal(weights_of(other, algo), weights_of(whole, algo))


@pytest.mark.usefixtures("hasty")
def test_a_clone_is_scored_before_it_learns_and_goes_on_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = small("maskable-recurrent-ppo", bc="scripted", bc_steps=50)
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    assert [one.step for one in whole.evaluations()] == [0, 128, 256, 384]
    assert whole.checkpoint("first") == whole.checkpoints / "first-0"
    with monkeypatch.context() as patch:
        patch.setattr(loop, "commit_checkpoint", Mock(side_effect=Killed))
        with pytest.raises(Killed):
            train(arguments, broken.path)
    watcher = Watcher()
    watcher.evaluated = Mock(side_effect=Killed)  # type: ignore[method-assign]
    with pytest.raises(Killed):
        train(arguments, broken.path, watcher)
    train(arguments, broken.path)
    assert without_times(broken) == without_times(whole)


def test_training_leaves_other_folders_alone(tmp_path: Path) -> None:
    """A project may have checkpoints of its own where a run is put."""
    others = [tmp_path / "checkpoints" / name for name in ("resnet50/model.pt", "replay/game.dem", "replay/a-b.npz")]
    for other in others:
        other.parent.mkdir(parents=True, exist_ok=True)
        other.write_text("mine")
    draft, watcher = tmp_path / "checkpoints" / "new-64", Stop(99)
    draft.mkdir()  # of a crash or a full disk
    watcher.begun = Mock(side_effect=lambda *_: draft.rmdir())  # type: ignore[method-assign]
    with pytest.raises(FileNotFoundError):
        train(small("dqn"), tmp_path, watcher)
    train(small("dqn"), tmp_path)
    assert [other.read_text() for other in others] == ["mine"] * 3
    assert len(list((tmp_path / "checkpoints" / "replay").iterdir())) == 2


def test_a_run_is_gone_on_with_from_its_checkpoint_alone(tmp_path: Path) -> None:
    """Not from another version's. Lost lines come back, as after ``git checkout``; TensorBoard has each step once."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    arguments = small("a2c", checkpoints=3)
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    with pytest.raises(Killed):
        train(arguments, broken.path, Stop(3))
    last: Any = broken.checkpoint("last")
    kept = (last / "state.pkl").read_bytes()
    state = pickle.loads(kept)
    del state["progress"]["step"]
    for content in (pickle.dumps(state), kept):
        (last / "state.pkl").write_bytes(content)
        seal_file(last / "state.pkl")
        if content != kept:
            said = f"{last.name}: not a checkpoint of this version; delete the run's folder"
            refused(said, train, arguments, broken.path)
    for file in (broken.curve_file, broken.evaluations_file):
        file.write_text("".join(file.read_text().splitlines(keepends=True)[:1]))
    time.sleep(1.1)  # files are told apart, and put in order, by the second they were begun in
    train(arguments, broken.path)
    assert without_times(broken) == without_times(whole)
    shown = EventAccumulator(str(broken.path / "tensorboard")).Reload()
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


def test_a_checkpoint_on_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "copyfile", Mock(side_effect=OSError(errno.ENOSPC, "full", "x")))
    with pytest.raises(OSError, match=r"^\[Errno \d+\] full: 'x'$"):
        commit_checkpoint(Run(tmp_path), 1, lambda folder: (folder / "x").touch(), True, 1)


@pytest.mark.parametrize("algo", ["ppo", "sac", "td3"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_divergence_is_one_line(algo: str, tmp_path: Path) -> None:
    with pytest.raises(ArithmeticError, match=r"^training diverged; give a lower learning_rate, and another --out$"):
        train(small(algo, learning_rate=1e6), tmp_path / "run")


def test_a_crash_while_a_checkpoint_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The checkpoint before is used; after the last one only the final evaluation is made up for."""
    from chemlab.agents.train import checkpoints

    arguments, whole, run = small("sac"), Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    renamed = checkpoints._renamed

    def crash(draft: Path, final: Path) -> None:
        if final.name == "last-192":
            raise Killed
        renamed(draft, final)

    monkeypatch.setattr(checkpoints, "_renamed", crash)
    with pytest.raises(Killed):
        train(arguments, run.path)
    assert (run.checkpoints / "new-192").is_dir()
    assert (run.checkpoints / "replay" / "64-96.npz").exists()
    assert run.checkpoint("last") == run.checkpoints / "last-128"
    with run.curve_file.open("a") as handle:
        handle.write('{"step": 256, "ret')
    assert [point.step for point in run.curve()] == [64, 128, 192]
    monkeypatch.setattr(checkpoints, "_renamed", renamed)
    watcher = Stop(99)
    watcher.finishing = Mock(side_effect=Killed)  # type: ignore[method-assign]
    with pytest.raises(Killed):
        train(arguments, run.path, watcher)
    assert run.result() is None
    watcher = Stop(1)
    train(arguments, run.path, watcher)
    assert watcher.first == 384
    assert without_times(run) == without_times(whole)
    np.testing.assert_array_equal(weights_of(run, "sac"), weights_of(whole, "sac"))


def test_a_finished_run_is_not_run_again_another_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flags, run = ["train", "fictitious", *small("ppo").flags(), "--out", str(tmp_path / "run")], Run(tmp_path / "run")
    told = json.loads(CliRunner().invoke(app, [*flags, "--json"]).stdout)
    result: Any = run.result()
    assert told["mean"] == result.mean
    monkeypatch.setattr(training, "train_in_rounds", None)
    again = command(*flags)
    assert "is finished" in again
    assert f"{result.mean:.3f}" in again
    said = command(*flags, "--learning-rate", "0.01", code=2)
    assert "learning_rate 0.0003 (now 0.01)" in said
    assert "--out" in said
    config: Any = run.config()
    del config["arguments"]["gamma"]  # of before there was such an argument: it has its default
    run.config_file.write_text(json.dumps(config))
    assert "is finished" in command(*flags)
    run.config_file.write_text(json.dumps({**config, "fingerprint": "another"}))
    assert "has changed since" in command(*flags, code=2)


def test_two_processes_do_not_train_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep that looks at runs keeps none from beginning; another process's run has its own arguments."""
    run, held = Run(tmp_path), threading.Event()
    assert not run.busy()
    with run.locked():
        assert run.busy()
        with pytest.raises(RunBusy, match="another process"):
            train(small("ppo"), tmp_path)
    assert not run.busy()

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

    def begin_first(agent: Agent) -> None:
        monkeypatch.undo()
        with pytest.raises(Killed):
            train(small("ppo"), tmp_path, Stop(1))

    monkeypatch.setattr(Agent, "check", begin_first)
    refused("holds a run with other arguments: .*seed 0", train, small("ppo", seed=1), tmp_path)


def test_results_say_what_was_trained_and_what_came_of_it(tmp_path: Path) -> None:
    arguments = small("ppo", goals=["F", "E"], starts="paper")
    result = train(arguments, tmp_path)
    (run,) = find_runs(tmp_path)
    config = run.config()
    given = {**config["arguments"], "seed": config["seed"]}
    assert training_arguments(given) == arguments
    assert given["gamma"] == 0.99, "a default may change, what the run had does not"
    assert [config[key] for key in ("scenario", "bench", "goals", "label")] == ["fictitious", "rxn", ["F", "E"], "ppo"]
    assert {"chemlab", "torch", "stable-baselines3"} <= set(config["versions"])
    assert result.steps == 384
    assert list(result.by_goal) == ["F", "E"]
    assert result.mean == pytest.approx(sum(result.by_goal.values()) / 2)
    evaluations = run.evaluations()
    assert [evaluation.step for evaluation in evaluations] == [128, 256, 384]
    assert result.best_step == max(evaluations, key=lambda e: (e.mean, -e.step)).step
    assert (run.checkpoint("best"), run.result()) == (run.checkpoints / f"best-{result.best_step}", result)


def test_returns_of_a_bench_are_rows_of_goals() -> None:
    class Picky:
        def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
            """A legal action that what is seen decides."""
            return [np.flatnonzero(m)[int(1e4 * o.sum()) % m.sum()] for o, m in zip(observation, mask, strict=True)]

    task = BenchTask("wurtz_dodecane", "dit", ("NaCl", "dodecane"))
    rows = [BenchTask("wurtz_dodecane", "dit", (goal,)).returns(Picky(), 3, 50)[0] for goal in task.goals]
    assert len(np.unique(rows)) > 3
    for _ in range(2):
        np.testing.assert_array_equal(task.returns(Picky(), 3, 50), rows)


def test_the_weight_of_sacs_entropy_begins_where_it_is_told_to() -> None:
    for arguments, start in ((small("sac"), 1.0), (small("sac", ent_coef_start=0.01), 0.01)):
        model: Any = _learner(arguments, ChemlabVecEnv(2, scenario="fictitious", bench="rxn"), 1000)
        assert model.log_ent_coef.exp().item() == pytest.approx(start)
    assert training_arguments({"preset": "sac-cool", "bench": "rxn"}).algo == "sac"
    for values, message in (
        ({"algo": "ppo", "ent_coef_start": 0.1}, "is for sac"),
        ({"algo": "sac", "ent_coef_start": 0.0}, "greater than 0"),
        ({"algo": "sac", "ent_coef_start": 0.1, "ent_coef": 0.1}, "ent_coef fixes it"),
    ):
        refused(message, training_arguments, {"bench": "rxn", **values})


def test_flags_win_over_the_file_and_the_file_over_the_preset(tmp_path: Path) -> None:
    file = tmp_path / "train.toml"
    file.write_text('bench = "rxn"\npreset = "ppo-xl"\nsteps = 1e5\nseed = 4\nnet_arch = [32, 32]\n')
    arguments = load_arguments(file, {"seed": 7, "gamma": None})
    assert (arguments.steps, arguments.seed, arguments.envs, arguments.net_arch) == (100_000, 7, 32, (32, 32))
    assert arguments.label == "ppo-xl"
    assert load_arguments(file, {"algo": "a2c"}).label == "ppo-xl-a2c"
    assert load_arguments(file, {"roles": "manager"}).folder().parts[0] == "wurtz_dodecane-manager_0"
    assert arguments.folder() == Path("WurtzReaction", "ppo-xl", "seed-7")
    assert training_arguments({}) == IPPO()


def test_the_usual_algorithm_has_what_is_asked_for() -> None:
    """A manager that learns has masks in any case."""
    manager = {"roles": "manager"}
    cases: list[tuple[dict[str, Any], str]] = [({"bench": "rxn"}, "ppo"), ({"roles": "rxn_0"}, "ppo")]
    cases += [({"roles": ["rxn", "manager"]}, "ippo"), (manager, "ippo")]
    for more in ({"goals": "dodecane"}, {"hints": "scripted"}, {"algo": "maskable-ppo"}, {"preset": "manager"}):
        cases.append(({**manager, **more}, "maskable-ppo"))
    for values, algo in cases:
        assert training_arguments(values).algo == algo, values


def test_one_agent_of_several_is_named() -> None:
    one = r"roles: ppo trains one agent, and .* has rxn_0, rxn_1; give one of them"
    refused(one, find_task, PPO(scenario="wurtz_two_lines", roles=("rxn",)))
    known = r"roles: unlabelled has manager, rxn, .*manager_0, .*or all; given al$"
    refused(known, find_task, PPO(scenario="unlabelled", roles=("al",)))
    assert find_task(PPO(scenario="wurtz_two_lines", roles=("rxn_1",))).agent == "rxn_1"
    assert find_task(PPO(scenario="unlabelled", roles=("rxn",))).agent == "rxn_0"


def test_the_papers_protocol_is_the_default() -> None:
    ppo, dqn = (ALGORITHMS[algo](bench="rxn") for algo in ("ppo", "dqn"))
    assert (ppo.envs, ppo.rollout, ppo.steps) == (10, 256, 1_000_000)
    assert (dqn.buffer_size, dqn.exploration_steps, dqn.exploration_final) == (1_000_000, 30_000, 0.01)  # type: ignore[attr-defined]


@pytest.mark.parametrize("algo", LEARNERS)
def test_other_defaults_are_those_of_stable_baselines3(algo: str) -> None:
    """Except for what the paper states."""
    arguments: Any = ALGORITHMS[algo](bench="rxn")
    theirs = inspect.signature(LEARNERS[algo].__init__).parameters
    named = {"epochs": "n_epochs", "exploration_final": "exploration_final_eps"}
    paper = ("gradient_steps", "exploration_final", "action_noise")
    paper += ("ent_coef",) if algo == "sac" else ()  # "auto", as ent_coef_start says
    compared = 0
    for name in type(arguments).model_fields:
        parameter = theirs.get(named.get(name, name))
        if parameter is not None and name not in (*paper, "seed"):
            assert getattr(arguments, name) == parameter.default, name
            compared += 1
    assert compared >= 3
    venv = ChemlabVecEnv(2, scenario="fictitious", bench="rxn" if algo in ("sac", "td3", "ppo") else "dit")
    kind = "MlpLstmPolicy" if "recurrent" in algo else "MlpPolicy"
    given: dict[str, Any] = {"device": "cpu"} | ({"buffer_size": 10} if "buffer_size" in theirs else {})
    layers = {"net_arch": list(arguments.net_arch)}
    layers |= {"lstm_hidden_size": arguments.memory} if "recurrent" in algo else {}
    own, made = (LEARNERS[algo](kind, venv, **given, **more) for more in ({}, {"policy_kwargs": layers}))
    shapes = [[tuple(array.shape) for array in one.policy.state_dict().values()] for one in (own, made)]
    assert shapes[0] == shapes[1]


def test_dqn_explores_as_the_paper_says(tmp_path: Path) -> None:
    train(small("dqn", exploration_steps=192, exploration_final=0.25), tmp_path)
    learner: Any = load_learner(Run(tmp_path).checkpoint("last"), "dqn")  # type: ignore[arg-type]
    schedule = learner.exploration_schedule
    # The schedule takes what is left of the run's 384 steps.
    assert [schedule(left) for left in (1.0, 0.75, 0.5, 0.1)] == pytest.approx([1.0, 0.625, 0.25, 0.25])


def test_flags_say_the_same_as_arguments() -> None:
    """A clone, whose defaults differ, says what only others have by default."""
    flags = small("sac", goals=["E", "F"], learning_rate=1e-3).flags()
    assert flags.count("--goals") == 2
    pairs = dict(zip(flags[::2], flags[1::2], strict=True))
    assert (pairs["--rollout"], pairs["--learning-rate"]) == ("32", "0.001")
    assert "--starts" not in flags
    clone = {"scenario": "rush", "roles": ["rxn"], "algo": "ippo", "bc": "scripted"}
    flags = training_arguments({**clone, "learning_rate": 1e-3, "ent_coef": 0.03, "refund": 0.25}).flags()
    pairs = dict(zip(flags[::2], flags[1::2], strict=True))
    assert [pairs[f"--{name}"] for name in ("learning-rate", "ent-coef", "refund")] == ["0.001", "0.03", "0.25"]
    assert "--learning-rate" not in training_arguments(clone).flags()
    assert "None" not in IPPO(begin_from="runs/first", tied=None, rollout=None).command_line()


def test_wrong_arguments() -> None:
    for values, message in (
        ({"algo": "reinforce"}, "algo: choose from ppo, a2c"),
        ({"preset": "huge"}, "preset: choose from paper, .*ppo-xl"),
        ({"stepz": 3}, "stepz: unknown argument; did you mean steps"),
        ({"steps": "many"}, "steps: Input should be a valid integer, given 'many'"),
        ({"roles": "manager"}, "bench: trains a bench on its own, roles train in the laboratory"),
        ({"bench": None, "algo": "ppo"}, "roles: ppo trains one agent; .* given all"),
        ({"buffer_size": 10}, "is for dqn, qr-dqn, sac, td3, not for ppo"),
        ({"bc_rounds": 3}, "bc_rounds: no policy is cloned"),
        ({"algo": "dqn", "bc": "scripted"}, "bc: is for ppo"),
        ({"bench": None, "algo": "ippo", "period": 3}, "period: is for regime in-turns"),
    ):
        given: dict[str, Any] = {"bench": "rxn", **values}
        refused(message, training_arguments, given)


def test_old_names_are_accepted_with_a_notice(capsys: Any) -> None:
    expected = training_arguments({"bench": "rxn", "bc": "random", "bc_steps": 9})
    assert capsys.readouterr().err == ""
    assert training_arguments({"bench": "rxn", "imitate": "random", "imitate_steps": 9}) == expected
    assert "is now called" in capsys.readouterr().err
    refused("imitate_rounds: unknown argument", training_arguments, {"imitate_rounds": 2})  # it was in no release


def test_environment_ids_stand_for_scenario_and_role() -> None:
    bench = {"scenario": "crude", "bench": "ext"}
    for env_id, old, new, kind in (
        (RXN, {}, {"scenario": "fictitious", "bench": "rxn"}, PPO),
        ("chemlab/Bench-v1", bench, bench, PPO),
        ("chemlab/LabAgent-v1", {"bench": "rxn_0"}, {"roles": "rxn_0"}, PPO),
        ("manager", {"scenario": "crude"}, {"scenario": "crude", "roles": "manager_0"}, IPPO),
    ):
        made = training_arguments(new)
        assert isinstance(made, kind)
        assert training_arguments({"env_id": env_id, **old}) == made
        if kind is IPPO:  # of a team; who learns alone has the id of a manager
            made = training_arguments({**new, "algo": "maskable-ppo"})
        assert made.env_id == env_id.replace("manager", "chemlab/LabManager-v1")


def test_old_commands_are_accepted_with_a_notice(tmp_path: Path) -> None:
    joint = ["train-together", "wurtz_dodecane", "--imitate", "random", "--steps", "0", "--out", tmp_path / "run"]
    said = command(*joint, code=2)
    assert "chemlab train-together is now chemlab train --algo ippo" in said
    assert "imitate is now called bc" in said
    assert "train: steps: Input should be greater than or equal to 1" in said
    assert "recipes/rllib.py" in command("train-rllib", "wurtz_dodecane", code=2)


KINDS: tuple[type[Arguments], ...] = tuple(ALGORITHMS.values())
NAN, INFINITY = float("nan"), float("inf")
NONSENSE: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(("steps", "gradient_steps"), (0, -1)),
    **dict.fromkeys(("envs", "epochs", "evaluations", "eval_episodes", "final_episodes", "checkpoints"), (0,)),
    **dict.fromkeys(("bc_steps", "bc_rounds", "rollout", "buffer_size", "exploration_steps", "memory", "period"), (0,)),
    **dict.fromkeys(("gamma", "manager_gamma"), (-0.1, 1.5, NAN)),
    **dict.fromkeys(("refund", "processed", "own_goals", "shown_readings", "partial"), (-0.1, 1.1, NAN)),
    **dict.fromkeys(("free_readings", "exploration_final"), (-0.1, 1.1, NAN)),
    **dict.fromkeys(("action_noise", "self_imitation"), (-0.1, NAN, INFINITY)),
    "seed": (-1, 2**32),
    "learning_rate": (0.0, -1e-3, 1e300, NAN, INFINITY),
    "gae_lambda": (-1.0, 1.01, NAN),
    "ent_coef": (-0.01, 1e300, NAN, INFINITY),
    "ent_coef_start": (0.0, -1.0, NAN, INFINITY),
    "clip_range": (0.0, -0.2, 1e300, NAN, INFINITY),
    "batch_size": (1, 0, -5),
    "bc_std": (0.0, -0.1, 1.5, NAN, INFINITY),
    "learning_starts": (-1,),
    "net_arch": ((64, 0), (-1,)),
    "practice": (-0.1, 1.0, NAN),
}
EDGES: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(("gamma", "manager_gamma", "gae_lambda", "exploration_final"), (0.0, 1.0)),
    **dict.fromkeys(("ent_coef", "action_noise"), (0.0,)),
    "seed": (0, 2**32 - 1),
    "learning_starts": (0,),
    "batch_size": (2,),
}


def fitting(kind: type[Arguments], name: str) -> dict[str, Any]:
    """Arguments among which a field may be given at all."""
    cloned = {"bc": "scripted"} if name.startswith("bc_") else {}
    return {"bench": "rxn", **cloned} if issubclass(kind, Single) else cloned


@pytest.mark.parametrize("kind", KINDS)
def test_nonsense_is_refused_by_name(kind: type[Arguments]) -> None:
    """Every number of every algorithm."""
    fields = kind.model_fields.items()
    numbers = {name for name, f in fields if {"int", "float"} & set(re.findall(r"\w+", str(f.annotation)))}
    assert numbers <= set(NONSENSE)
    algo = str(kind.model_fields["algo"].default)
    for name in numbers:
        for value in NONSENSE[name]:
            given = {**fitting(kind, name), name: value}
            refused(f"(?m)^{name}", kind, **given)
            refused(rf"train: {name}(\.\d)?: Input should be ", load_arguments, None, {"algo": algo, **given})
        for value in EDGES.get(name, ()):
            kind(**fitting(kind, name), **{name: value})


@pytest.mark.parametrize("algo", ["ppo", "maskable-ppo", "ippo"])
def test_values_of_any_kind_are_readable_errors(algo: str) -> None:
    """Also of names of before 0.3. What is not refused is a value that the argument may have."""
    names = {name for kind in KINDS for name in kind.model_fields} | {*OLD_NAMES, "env_id"}
    values = [["x"], [["x"]], [1], [], {}, {"a": 1}, [None], 1.5, -1, "", True, float("nan"), 10**30, "x" * 99]
    for name, value in itertools.product(sorted(names), values):
        with contextlib.suppress(DataError):
            training_arguments({"algo": algo, name: value})


def test_nonsense_in_a_file_and_on_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "train.toml"
    file.write_text("clip_range = nan\n")
    refused(f"^{re.escape(str(file))}: clip_range: must be a finite number, given nan$", load_arguments, file, {})
    for target in (RXN, "wurtz_dodecane"):
        said = command("train", target, "--gae-lambda", "nan", "--out", tmp_path / "run", code=2)
        assert "train: gae_lambda: Input should be a finite number, given nan" in said
    assert not (tmp_path / "run").exists()


def test_a_run_of_an_older_version_is_refused(tmp_path: Path) -> None:
    """Its arguments stand beside the others."""
    values = {"env_id": RXN, "label": "ppo", "algo": "ppo", "seed": 0, "scenario": "fictitious", "bench": "rxn"}
    (tmp_path / "config.json").write_text(json.dumps({**values, "goals": ["E"], "fingerprint": "0", "steps": 384}))
    refused(r"holds a run of chemlab before 0\.3; give another --out, or delete", train, small("ppo"), tmp_path)
    assert find_runs(tmp_path)[0].config() is not None, "it can still be read"


def test_a_minibatch_of_one_is_refused_where_it_would_make_weights_that_are_no_numbers() -> None:
    single = "batch_size: a rollout of 65 steps leaves a single step for the last minibatch"
    refused(single, MaskablePPO, bench="dit", envs=5, rollout=13)
    MaskablePPO(bench="dit", envs=5, rollout=13, batch_size=33)
    refused("rollout: PPO needs at least 2 steps", PPO, bench="rxn", envs=1, rollout=1)


def test_training_on_an_empty_vessel_is_spoken_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench of somebody's own, which has no scripted policy to be evaluated beside either."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "bench"))
    file = tmp_path / "with_filter.toml"
    entry = '[benches.fil]\nkind = "filtration_bench:FiltrationBench"\nstep_limit = 5\n'
    file.write_text(f'base = "wurtz_dodecane"\nname = "wurtz_dodecane"\n{entry}')
    short = {**SMALL, "env_id": "chemlab/Bench-v1", "scenario": str(file), "bench": "fil", "steps": 64}
    said = r"'fil' of wurtz_dodecane: .* empty vessel, .* no \[benches.fil.start\]; give it contents .moles by mat"
    with pytest.warns(UserWarning, match=said):
        result = train(training_arguments(short), tmp_path / "empty")
    assert result.scripted_mean is None
    assert Run(tmp_path / "empty").evaluations()[0].scripted_by_goal is None


def test_where_vessels_can_be_recorded_that_is_the_advice() -> None:
    values = load_scenario("wurtz_dodecane").model_dump() | {"name": "new"}
    assert BenchTask(load_scenario(values), "ext").warning() is None
    values["benches"]["ext"]["start"] = {}
    said: Any = BenchTask(load_scenario(values), "ext").warning()
    assert said.endswith("; or record vessels with chemlab export starts FILE.toml, and train with --starts lab")
    assert BenchTask(load_scenario(values | {"name": "wurtz_dodecane"}), "ext", starts="lab").warning() is None


def test_arguments_that_do_not_fit_the_bench(tmp_path: Path) -> None:
    agent = {"env_id": "chemlab/LabAgent-v1", "bench": "rxn_0", "algo": "recurrent-ppo"}
    for values, message in (
        ({"scenario": "chemlab/Nothing-v0"}, "environments are chemlab/WurtzReaction-v0"),
        ({"env_id": "chemlab/WurtzReaction-v0", "scenario": "fictitious"}, "has 'wurtz_dodecane'"),
        ({"goals": ["gold"]}, "goals: wurtz_dodecane has"),
        ({"algo": "dqn"}, "actions are continuous"),
        ({"bench": "dit", "algo": "sac"}, "algo: the actions are discrete; choose from ppo"),
        (agent, "reset for each experiment"),
    ):
        with pytest.raises(ValueError, match=message):
            train(training_arguments({"bench": "rxn", **values}), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_mistyped_policy_leaves_nothing_behind(tmp_path: Path) -> None:
    """Whom to learn from is looked up before anything is written; the right name may follow in the same folder."""
    values = {**SMALL, "env_id": "chemlab/LabManager-v1", "algo": "maskable-ppo", "scenario": "wurtz_any"}
    for key, name in (("bc", "heuristc"), ("bc", "nowhere/at/all"), ("hints", "heuristc")):
        refused(name, train, training_arguments({**values, key: name}), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_without_a_checkpoint_does_not_hold_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever goes wrong there; one that was stopped by its user goes on."""
    run, values = Run(tmp_path / "run"), {**SMALL, "env_id": RXN, "algo": "ppo"}
    cases = (
        (Agent, "begin", ValueError("no clone"), False),
        (training, "train_in_rounds", RuntimeError("no memory"), False),
        (training, "train_in_rounds", KeyboardInterrupt(), True),
    )
    for owner, name, error, holds in cases:
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, Mock(side_effect=error))
            with pytest.raises(type(error)):
                train(training_arguments(values), run.path)
        assert run.config_file.exists() is holds
        if not holds:
            values |= {"seed": 7}
    refused("holds a run with other arguments: seed 7", train, training_arguments({**values, "seed": 8}), run.path)


def test_a_value_based_learner_on_a_reaction_bench_plays_the_bench_with_numbers(tmp_path: Path) -> None:
    """What DQN has learned of the discretised bench comes to the same where it plays the continuous one."""
    result = train(small("dqn", actions="discrete", scenario=RXN), tmp_path / "run")
    assert (Run(tmp_path / "run").config() or {})["arguments"]["actions"] == "discrete"
    scenario = load_scenario("fictitious")
    ours, theirs = (
        Target(scenario.configured(actions=kind), "rxn").play(str(tmp_path / "run"), "G", 3, 7).returns
        for kind in ("native", "discrete")
    )
    np.testing.assert_array_equal(ours, theirs)
    assert set(result.by_goal) == set(scenario.goals)
    assert train(small("dqn", actions="discrete", scenario=RXN), tmp_path / "run") == result
    with pytest.raises(ValueError, match="or with --actions discrete dqn or qr-dqn or maskable-ppo"):
        train(small("dqn", scenario=RXN), tmp_path / "other")


def test_runs_with_neighbouring_seeds_have_different_episodes(tmp_path: Path) -> None:
    """Nor does any have those of an evaluation, whatever its seed."""
    seeds = {seed: set(training_seeds(seed, 256)) for seed in (0, 1, 1_000_000)}
    assert len(set.union(*seeds.values())) == 3 * 256
    assert not set.union(*seeds.values()) & {*range(1_000_000, 1_010_000), *range(RESULT_SEED, RESULT_SEED + 10_000)}
    made = Agent(small("ppo", scenario="rush", bench=None, roles=("manager",), envs=3))
    made.begin(Run(tmp_path / "run"))
    made.venv.reset()
    labs = made.venv.batch.laboratories
    for member, seed in enumerate(training_seeds(0, 3)):
        alone = LaboratoryTask("rush").batch(1)
        alone.reset(seed=seed)
        assert (alone.laboratories.episodes.first[0] == labs.episodes.first[member]).all()


def test_a_role_of_a_laboratory_is_a_task() -> None:
    """What the scripted manager and a scripted bench come to is what whole episodes say."""
    env = raw_env("wurtz_dodecane")
    results = [play_episode(env, make_policies("scripted", env.laboratories), seed) for seed in (4, 5)]
    manager = LaboratoryTask("wurtz_dodecane")
    assert manager.returns(manager.policy("scripted"), 2, 4).tolist() == [[result.score for result in results]]
    bench = LaboratoryTask("wurtz_dodecane", "ext_0")
    expected = [result.rewards["ext_0"] for result in results]
    assert bench.returns(bench.policy("scripted"), 2, 4)[0] == pytest.approx(expected, rel=1e-12)
    one = LaboratoryTask("wurtz_any", goals=("dodecane",))
    batch = one.batch(20)
    batch.reset(seed=0)
    asked = batch.laboratories.scenario.goals
    assert {asked[goal] for goal in batch.laboratories.state.goal[:, 0]} == {"dodecane"}
    assert one.fingerprint == LaboratoryTask("wurtz_any").fingerprint
    refused("goals: wurtz_dodecane asks for dodecane, given gold", LaboratoryTask, "wurtz_dodecane", goals=("gold",))
