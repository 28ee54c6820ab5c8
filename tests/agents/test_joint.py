"""Joint training: experience belongs to the agent whose turn it was, and a run that stops goes on as if it had not."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from chemlab.agents.train.experience import Experience

pytest.importorskip("sb3_contrib", reason='needs the extra: pip install ".[train]"')

import torch

from chemlab.agents.learners import load_learner, load_team
from chemlab.agents.policies import agent_policy, as_policy
from chemlab.agents.pretrained import load_pretrained
from chemlab.agents.runs import Run
from chemlab.agents.train import joint
from chemlab.agents.train.arguments import IPPO, MAPPO, training_arguments
from chemlab.agents.train.export import export_run
from chemlab.agents.train.learn import train
from chemlab.agents.train.loop import Watcher
from chemlab.lab.engine import Laboratories

BOX = gymnasium.spaces.Box(0.0, 1.0, (2,), np.float32)
SMALL: dict[str, Any] = {
    "envs": 4,
    "rollout": 12,
    "steps": 400,
    "batch_size": 32,
    "epochs": 1,
    "evaluations": 2,
    "eval_episodes": 1,
    "final_episodes": 1,
}


CRITICS = {"own": IPPO, "state": MAPPO}


def team_of(arguments: IPPO) -> joint.Team:
    """What a run with these arguments begins with."""
    team = joint.Team(arguments)
    team.make()
    return team


def turn(experience: Experience, stream: int, value: float, tick: int, action: int = 0) -> None:
    experience.begin(
        np.array([stream]),
        np.full((1, 2), value, dtype=np.float32),
        np.ones((1, 3), dtype=np.int8),
        np.array([action]),
        np.array([value]),
        np.array([-1.0]),
        np.array([tick]),
    )


def test_advantages_run_along_streams() -> None:
    """Two turns of an episode, another stream between them, and the next episode's first turn; by hand."""
    experience = Experience(BOX, gymnasium.spaces.Discrete(3), 2)
    turn(experience, 0, 1.0, 0)
    turn(experience, 1, 5.0, 0)
    experience.earn(np.array([0, 1]), np.array([0.5, 9.0]))
    turn(experience, 0, 2.0, 3)
    experience.earn(np.array([0]), np.array([1.0]))
    experience.end(np.array([0]), np.array([5]))
    experience.earn(np.array([0]), np.array([100.0]))  # between episodes: nobody's
    turn(experience, 0, 7.0, 5)
    assert experience.finished().tolist() == [0, 2]
    assert experience.elapsed[[0, 2]].tolist() == [3, 2]
    gamma, lam = 0.9, 0.5
    last = 1.0 - 2.0  # terminal: reward - value
    first = 0.5 + gamma * 2.0 - 1.0 + gamma * lam * last
    np.testing.assert_allclose(experience.advantages(gamma, lam, False)[[0, 2]], [first, last], rtol=1e-12)
    longer = gamma**3
    first = 0.5 + longer * 2.0 - 1.0 + longer * lam * last
    np.testing.assert_allclose(experience.advantages(gamma, lam, True)[[0, 2]], [first, last], rtol=1e-12)


def test_what_is_open_is_kept_for_the_next_rollout() -> None:
    experience = Experience(BOX, gymnasium.spaces.Discrete(3), 3)
    for stream in range(3):
        turn(experience, stream, float(stream), 0)
    turn(experience, 1, 4.0, 2)
    saved_after = experience.finished().tolist()
    experience.forget()
    assert saved_after == [1]
    assert len(experience) == 3
    other = Experience(BOX, gymnasium.spaces.Discrete(3), 3)
    other.set_state(experience.get_state())
    for copy in (experience, other):
        copy.earn(np.array([0, 1, 2]), np.array([1.0, 2.0, 3.0]))
        copy.end(np.array([0, 1, 2]), np.array([7, 7, 7]))
        rows = copy.finished()
        assert copy.value[rows].tolist() == [0.0, 2.0, 4.0]
        assert copy.reward[rows].tolist() == [1.0, 3.0, 2.0]
        assert copy.elapsed[rows].tolist() == [7, 7, 5]


def test_returns_of_whole_episodes() -> None:
    """Where nothing has a value, estimates with a lambda of 1 are discounted returns; what is open is left out."""
    experience = Experience(BOX, gymnasium.spaces.Discrete(3), 2)
    rewards = [1.0, 2.0, 4.0]
    for tick, reward in enumerate(rewards):
        for stream in range(2):
            turn(experience, stream, 0.0, tick)
        experience.earn(np.array([0, 1]), np.array([reward, reward]))
    experience.end(np.array([0]), np.array([3]))
    turn(experience, 0, 0.0, 3)
    assert experience.whole().tolist() == [0, 2, 4]
    expected = [sum(0.9**k * later for k, later in enumerate(rewards[t:])) for t in range(3)]
    np.testing.assert_allclose(experience.advantages(0.9, 1.0, False)[[0, 2, 4]], expected, rtol=1e-12)


@pytest.mark.parametrize("rewards", [None, "cooperative", "mixed"])
@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "wurtz_two_lines"])
def test_no_reward_is_lost_or_another_agents(scenario: str, rewards: str | None) -> None:
    """What all laboratories paid a role is what its experience holds; only shares of a result to which an agent has
    done nothing are nobody's."""
    team = team_of(IPPO(scenario=scenario, envs=6, rollout=120, rewards=rewards))
    labs, paid = team.labs, dict.fromkeys(team.learning, 0.0)
    after = team._after

    def watched(number: int, members: Any) -> None:
        for other, agent in enumerate(labs.agents):
            role = joint.role_of(agent)
            acted = team.learners[role].experience._open[team._stream(other)(members)] >= 0
            earned = labs.rewards[members, other]
            assert rewards is not None or not earned[~acted].any()
            paid[role] += float(earned[acted].sum())
        after(number, members)

    team._after = watched  # type: ignore[method-assign]
    team.collect()
    assert any(value != 0.0 for value in paid.values())
    for role, learner in team.learners.items():
        experience = learner.experience
        held = float(experience.reward[: len(experience)].sum())
        assert held == pytest.approx(paid[role], rel=1e-9, abs=1e-12), role
        masks = experience.mask[: len(experience)]
        if masks.shape[1]:
            chosen = experience.action[: len(experience)].astype(int)
            assert masks[np.arange(len(chosen)), chosen].all(), "only legal actions are explored"


def weights(run: Path) -> dict[str, Any]:
    checkpoint = Run(run).checkpoint("last")
    assert checkpoint is not None
    return {
        f"{role} {name}": array.numpy()
        for role, model in load_team(checkpoint).items()
        for name, array in model.policy.state_dict().items()
    }


class _Stop(Exception):
    pass


class _Stopping(Watcher):
    """Ends the process's training right after the first checkpoint."""

    def evaluated(self, evaluation: Any, best: bool) -> None:
        raise _Stop


@pytest.mark.parametrize(("regime", "critic"), [("together", "own"), ("in-turns", "own"), ("together", "state")])
def test_a_stopped_run_goes_on_alike(regime: str, critic: str, tmp_path: Path) -> None:
    arguments = CRITICS[critic](**SMALL, regime=regime, period=1)
    whole = train(arguments, tmp_path / "whole")
    with pytest.raises(_Stop):
        train(arguments, tmp_path / "stopped", _Stopping())
    resumed = train(arguments, tmp_path / "stopped")
    assert (resumed.steps, resumed.mean, resumed.last_mean) == (whole.steps, whole.mean, whole.last_mean)
    runs = [Run(tmp_path / name) for name in ("whole", "stopped")]
    assert [p.return_mean for p in runs[0].curve()] == [p.return_mean for p in runs[1].curve()]
    first, second = (weights(run.path) for run in runs)
    assert set(first) == set(second)
    assert first, "a model for every role"
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)
    assert train(arguments, tmp_path / "whole") == whole, "what is finished is not run again"


def test_one_role_can_learn_alone_and_start_from_another_run(tmp_path: Path) -> None:
    first = IPPO(**{**SMALL, "steps": 60}, roles=("rxn",))
    train(first, tmp_path / "first")
    second = IPPO(**{**SMALL, "steps": 40}, roles=("rxn", "dit"), begin_from=str(tmp_path / "first"))
    result = train(second, tmp_path / "second")
    assert result.steps >= 40
    assert {name.partition(" ")[0] for name in weights(tmp_path / "second")} == {"rxn", "dit"}
    nowhere = IPPO(**SMALL, begin_from=str(tmp_path))
    with pytest.raises(ValueError, match="neither a run of several roles nor runs"):
        train(nowhere, tmp_path / "third")
    assert not (tmp_path / "third").exists(), "another name may be given for the same folder"


def test_a_team_begins_as_clones(tmp_path: Path) -> None:
    """Each role does what the policy does, in laboratories that have begun anew; a run of it can be exported."""
    small = {**SMALL, "scenario": "wurtz_dodecane_direct", "roles": ("rxn", "dit"), "rewards": "mixed"}
    team = team_of(IPPO(**small))
    hit = team.imitate("scripted", 300)
    assert hit["dit"] > 0.8, "share of turns"
    assert hit["rxn"] < 0.1, "mean difference of numbers from 0 to 1"
    assert not any(len(learner.experience) for learner in team.learners.values())
    assert not team.returns
    assert (team.labs.state.ticks == 0).all()
    arguments = IPPO(**{**small, "steps": 40}, bc="scripted", bc_steps=50)
    train(arguments, tmp_path / "run")
    card = export_run(tmp_path / "run", tmp_path / "mine", "dit")
    best = Run(tmp_path / "run").checkpoint("best")
    assert best is not None
    assert (card.name, card.bench, card.background) == ("mine", "dit", "scripted")
    assert "--bc scripted --bc-steps 50" in card.command
    model, policy = load_team(best)["dit"], load_pretrained(tmp_path / "mine")
    seen = np.random.default_rng(0).random((20, card.observation_size), dtype=np.float32)
    legal = np.ones((20, card.action_size), dtype=np.int8)
    none = np.zeros(20, dtype=np.int64)
    expected = model.predict(seen, action_masks=legal, deterministic=True)[0]
    np.testing.assert_array_equal(policy.act(seen, legal, none, none), expected)
    for role, message in ((None, "give one of its roles: dit, rxn; given None"), ("ext", "dit, rxn; given 'ext'")):
        with pytest.raises(ValueError, match=message):
            export_run(tmp_path / "run", tmp_path / "other", role)


def test_a_manager_that_shared_rewards_is_exported_without_a_warning(tmp_path: Path) -> None:
    """What it was rewarded for is no part of the task that its card names."""
    small = {**SMALL, "scenario": "relay", "roles": ("manager",), "steps": 40, "rewards": "mixed"}
    train(IPPO(**small), tmp_path / "run")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        card = export_run(tmp_path / "run", tmp_path / "mine", "manager")
        load_pretrained(tmp_path / "mine").check(Laboratories("relay", 1).manager.workplace)
    assert card.bench == "manager"


def test_a_bench_that_has_not_all_goals_is_exported(tmp_path: Path) -> None:
    train(IPPO(**{**SMALL, "scenario": "relay", "roles": ("fin",), "steps": 40}), tmp_path / "run")
    assert export_run(tmp_path / "run", tmp_path / "mine", "fin").goals == ["E"]


@pytest.mark.parametrize("critic", ["own", pytest.param("state", marks=pytest.mark.slow)])
def test_clones_that_explore_still_do_what_they_were_shown(critic: str) -> None:
    """Numbers are drawn about as far from the shown ones as the clone misses them; the state does not make it worse."""
    small = {**SMALL, "scenario": "wurtz_dodecane_direct", "roles": ("rxn", "dit"), "rewards": "mixed"}
    team = team_of(CRITICS[critic](**small))
    hit = team.imitate("scripted", 600, 2)
    spread = team.learners["rxn"].model.policy.log_std.exp()
    assert hit["dit"] > 0.95, "share of turns"
    assert hit["rxn"] < 0.05, "mean difference of numbers from 0 to 1"
    assert (spread >= 0.019).all()
    assert spread.mean() < 4.0 * hit["rxn"] + 0.03
    assert not any(len(learner.experience) for learner in team.learners.values())


def test_a_clone_explores_as_widely_as_it_is_told() -> None:
    """What it is most likely to play stays what it was shown."""
    small = {**SMALL, "scenario": "wurtz_dodecane_direct", "roles": ("rxn",), "rewards": "mixed"}
    team = team_of(IPPO(**small, bc="scripted", bc_std=0.3))
    hit = team.imitate("scripted", 600)
    np.testing.assert_allclose(team.learners["rxn"].model.policy.log_std.exp().detach(), 0.3, rtol=1e-6)
    assert hit["rxn"] < 0.05


def test_in_rounds_learners_play_and_the_policy_is_asked() -> None:
    """What becomes experience then is what the policy would have played, not what was."""
    team = team_of(IPPO(**{**SMALL, "scenario": "relay", "roles": ("manager",)}))
    shown = agent_policy("scripted", team.labs, 0)
    team._begin_anew("scripted", tried=True)
    for _ in range(3):
        team.collect()
    e = team.learners["manager"].experience
    rows = np.arange(len(e))
    tried = as_policy(team.learners["manager"].model).act(e.observation[rows], e.mask[rows], rows, rows)
    asked = [shown.act(e.observation[:1], e.mask[:1], rows[:1], rows[:1])[0]]
    assert e.action[0] == asked[0]
    assert (e.action[rows] != tried).mean() > 0.2
    assert e.mask[rows, e.action[rows].astype(int)].mean() > 0.9


def test_rounds_go_on_until_every_laboratory_has_been_to_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A manager that knows no end plays longer than whom it is to learn from, and it is such play that it lacks."""
    team = team_of(IPPO(**{**SMALL, "scenario": "relay", "roles": ("manager",), "rollout": 2}))
    ended: list[bool] = []

    def clone(learner: object) -> float:
        ended.append(bool(team._ended.all()))
        return 0.0

    monkeypatch.setattr(team, "_clone", clone)
    monkeypatch.setattr(team, "_fewest_turns", lambda: 10_000)
    team.imitate("scripted", 3, 3)
    assert ended == [False, True, True]


def test_a_critic_sees_the_state_and_the_actor_does_not(tmp_path: Path) -> None:
    """In the state are what the world hides, too; what plays was given the same at whatever state, and is exported."""
    arguments = MAPPO(**SMALL, scenario="rush", net_arch=(48, 24))
    team = team_of(arguments)
    for _ in range(6):
        team.collect()
    for role, learner in team.learners.items():
        number = 0 if role == "manager" else 1
        own = team.labs.observation_space(number).shape[0]
        layers = [layer for layer in learner.model.policy.mlp_extractor.policy_net if hasattr(layer, "in_features")]
        assert [(layer.in_features, layer.out_features) for layer in layers] == [(own, 48), (48, 24)]
        rows, policy = learner.experience.finished(), learner.model.policy
        seen = torch.as_tensor(learner.experience.observation[rows])
        assert seen[:, own:].std(dim=0).max() > 0.1
        other = torch.cat([seen[:, :own], 1.0 - seen[:, own:]], dim=1)
        with torch.no_grad():
            values, others = policy.predict_values(seen), policy.predict_values(other)
            actor, unaware = (policy.get_distribution(one).distribution for one in (seen, other))
            forward = policy(seen, deterministic=True)[1]
        torch.testing.assert_close(forward, values)
        assert (values - others).abs().max() > 1e-3
        for name in ("mean",) if role == "rxn" else ("logits",):
            torch.testing.assert_close(getattr(actor, name), getattr(unaware, name))
    train(arguments, tmp_path / "run")
    assert (Run(tmp_path / "run").config() or {})["algo"] == "mappo"
    best = Run(tmp_path / "run").checkpoint("best")
    assert best is not None
    policies, models = (load_pretrained(best / "manager"), load_pretrained(best / "rxn")), load_team(best)
    for policy in policies:
        seen_now = np.random.default_rng(0).random((20, policy.card.observation_size), dtype=np.float32)
        nobody = np.zeros(20, dtype=np.int64)
        expected = as_policy(models[policy.card.bench]).act(seen_now, None, nobody, nobody)
        np.testing.assert_allclose(policy.act(seen_now, None, nobody, nobody), expected, atol=1e-5)
    card = export_run(tmp_path / "run", tmp_path / "mine", "manager")
    assert card.observation_size == team.labs.observation_space(0).shape[0]
    assert arguments.folder() != IPPO(**SMALL, scenario="rush").folder()
    with pytest.raises(ValueError, match="manager was trained for other spaces"):
        train(IPPO(**SMALL, scenario="rush", begin_from=str(tmp_path / "run")), tmp_path / "next")


def test_a_last_minibatch_of_one_does_no_harm() -> None:
    """The spread of one advantage is not a number, and neither is a network that has learned from it."""
    team = team_of(IPPO(**{**SMALL, "batch_size": 16}, roles=("dit",)))
    learner = team.learners["dit"]
    space = learner.model.observation_space.shape[0]
    for turn_of in range(33):
        drawn = np.zeros((1, space), dtype=np.float32)
        mask = np.ones((1, learner.model.action_space.n), dtype=np.int8)
        action, _, value, log_probability = learner.sample(drawn, mask)
        stream, tick = np.array([0]), np.array([turn_of])
        learner.experience.begin(stream, drawn, mask, action, value, log_probability, tick)
        learner.experience.earn(stream, np.array([float(turn_of)]))
        learner.experience.end(stream, tick)
    assert len(learner.experience.finished()) == 33
    learner.update(0.99, 0.95, False, 1.0)
    for name, weights_of in learner.model.policy.state_dict().items():
        assert np.isfinite(weights_of.numpy()).all(), name


def test_runs_of_single_benches_go_on_together(tmp_path: Path) -> None:
    """A bench's PPO, masked or not, and a reaction bench's become the team's before it has learned anything."""
    short = {"envs": 2, "rollout": 16, "steps": 32, "evaluations": 1, "eval_episodes": 1, "final_episodes": 1}
    for role, env_id, algo in (
        ("rxn", "chemlab/WurtzReaction-v0", "ppo"),
        ("dit", "chemlab/WurtzDistillation-v0", "ppo"),
        ("ext", "chemlab/WurtzExtraction-v0", "maskable-ppo"),
    ):
        train(training_arguments({**short, "env_id": env_id, "algo": algo}), tmp_path / role)
    begin = ",".join(f"{role}={tmp_path / role}" for role in ("rxn", "dit", "ext"))
    team = team_of(IPPO(**SMALL))
    team._begin_from(begin)
    for role in ("rxn", "dit", "ext"):
        best = Run(tmp_path / role).checkpoint("best")
        assert best is not None
        single = load_learner(best, "maskable-ppo" if role == "ext" else "ppo")
        mine = team.learners[role].model.policy.state_dict()
        for name, value in single.policy.state_dict().items():
            np.testing.assert_array_equal(mine[name].numpy(), value.numpy(), err_msg=f"{role} {name}")
    for wrong, message in (
        (f"cook={tmp_path / 'rxn'}", "nobody called cook learns; roles: manager, rxn, ext, dit"),
        (f"rxn={tmp_path / 'nowhere'}", "nowhere: holds no training run"),
        (f"ext={tmp_path / 'dit'}", "ext was trained for other spaces"),
    ):
        with pytest.raises(ValueError, match=message):
            team._begin_from(wrong)
    larger = team_of(IPPO(**SMALL, net_arch=(32,)))
    with pytest.raises(ValueError, match="rxn has other hidden layers; give them with --net-arch"):
        larger._begin_from(begin)


def test_bad_arguments_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="roles: wurtz_dodecane choose from manager, rxn, ext, dit; given cook"):
        train(IPPO(roles=("cook",)), tmp_path / "a")
    with pytest.raises(ValueError, match=r"regime\s.*'together' or 'in-turns'"):
        train(IPPO(regime="chaos"), tmp_path / "b")
    with pytest.raises(ValueError, match="heuristc"):
        train(IPPO(**SMALL, bc="heuristc"), tmp_path / "b")
    assert not (tmp_path / "b").exists()
    train(IPPO(**{**SMALL, "steps": 10}), tmp_path / "c")
    with pytest.raises(ValueError, match="holds a run with other arguments: seed 0"):
        train(IPPO(**{**SMALL, "steps": 10}, seed=1), tmp_path / "c")
