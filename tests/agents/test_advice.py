"""Learning with advice: scripted managers that take back what is not played, and learners that see what they would."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused

from chemlab.agents.advice import AdvisedPolicy, Advisor
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import LapsingPolicy, agent_policy, make_policies
from chemlab.agents.random_policy import RandomPolicy
from chemlab.lab.engine import Laboratories
from chemlab.roles.manager_state import RUNNING

MANAGED = ["wurtz_two_lines", "rush", "relay", "unlabelled", "campaign", "failing", "selectivity"]
"""A scenario of each scripted manager."""


class Follower:
    """Plays the advice that its observations end with, but not at some turns: then the last legal action."""

    def __init__(self, actions: int, every: int = 0) -> None:
        self.actions, self.every = actions, every

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        advice = observation[:, -self.actions :]
        assert (advice.sum(axis=1) == 1.0).all()
        own = advice.argmax(axis=1)
        if self.every:
            last = mask.shape[1] - 1 - mask[:, ::-1].argmax(axis=1)
            own = np.where(step % self.every == 0, last, own)
        return own


def advised(labs: Laboratories, every: int = 0) -> dict[str, Any]:
    policies = make_policies("scripted", labs, 0)
    actions = len(labs.actions)
    policies["manager_0"] = AdvisedPolicy(Follower(actions, every), Advisor(policies["manager_0"], actions))
    return policies


@pytest.mark.parametrize("scenario", MANAGED)
def test_who_follows_the_advice_plays_what_the_advisor_plays(scenario: str) -> None:
    """And an advisor bears it that something else is played."""
    labs = Laboratories(scenario, 2)
    scripted = play_laboratory(labs, make_policies("scripted", labs, 0), None, 7)
    np.testing.assert_array_equal(play_laboratory(labs, advised(labs), None, 7).returns, scripted.returns)
    assert np.isfinite(play_laboratory(labs, advised(labs, every=3), None, 7).returns).all()


@pytest.mark.parametrize("scenario", MANAGED)
def test_what_is_not_played_has_not_been_decided(scenario: str) -> None:
    """An advisor told that nothing was done, or with its earlier memory, gives the same advice again."""
    labs = Laboratories(scenario, 1)
    managers: list[Any] = [make_policies("scripted", labs, 0)["manager_0"] for _ in range(2)]
    manager, other = managers
    labs.begin(3)
    member, wait = labs.members, np.array([labs.actions.encode("wait")])
    for turn in range(6):
        given = labs.observe(0, member), labs.mask(0, member), np.array([turn]), member
        first = manager.advise(*given)
        if first != wait:
            other.set_memory(manager.get_memory())
            for one in managers:
                one.played(wait, member)
                np.testing.assert_array_equal(one.advise(*given), first)
        manager.played(first, member)
        labs.act(0, member, first)
        if labs.state.status[0] != RUNNING or labs.state.cursor[0] != -1:
            break


class Watched:
    """Plays what a policy decides; another one is asked before, and hears of it as of somebody else's action."""

    def __init__(self, plays: Any, watches: Any) -> None:
        self.plays, self.watches = plays, watches
        self.agreed: list[bool] = []

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        played = self.plays.act(observation, mask, step, members)
        advice = self.watches.advise(observation, mask, step, members)
        self.agreed += (advice == played).tolist()
        asked = self.watches._advised
        asked.update({i: (-1, *asked[i][1:]) for i in members.tolist()})
        self.watches.played(played, members)
        return played


@pytest.mark.parametrize("scenario", [*MANAGED, "crude", "runaway", "wurtz_dodecane"])
def test_who_only_watches_knows_what_is_to_be_done(scenario: str) -> None:
    """Every decision is taken back and heard of as somebody else's: an advisor goes on from what others have done."""
    labs = Laboratories(scenario, 3)
    policies = make_policies("scripted", labs, 0)
    watched = Watched(policies["manager_0"], make_policies("scripted", labs, 0)["manager_0"])
    play_laboratory(labs, {**policies, "manager_0": watched}, None, 7)
    # Some draw what they think of, and whoever hears of an order taken guesses which.
    assert np.mean(watched.agreed) >= {"failing": 0.8, "rush": 0.9, "relay": 0.9}.get(scenario, 1.0)


def test_a_teacher_with_an_advisor_passes_on_what_was_played() -> None:
    """Whoever is asked what to play, and not followed, must not tell its advisor that it was."""

    class Heard:
        def __init__(self) -> None:
            self.played_by_others: list[int] = []

        def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
            return np.zeros(len(members), dtype=np.int64)

        def played(self, actions: Any, members: Any) -> None:
            self.played_by_others += actions.tolist()

    heard = Heard()
    teacher = Advisor(AdvisedPolicy(Heard(), Advisor(heard, 5)))
    nobody, seen = np.zeros(1, dtype=np.int64), np.zeros((1, 3), dtype=np.float32)
    assert teacher.advice(seen, None, nobody, nobody).tolist() == [0]
    assert heard.played_by_others == []
    teacher.played(np.array([4]), nobody)
    assert heard.played_by_others == [4]
    policy = LapsingPolicy(heard, 1.0, 0, 0)
    lapsing = Advisor(policy)
    lapsing.advice(seen, np.ones((1, 3), dtype=np.int8), nobody, nobody)
    assert heard.played_by_others == [4]
    lapsing.played(np.array([2]), nobody)
    assert heard.played_by_others == [4, 2]
    # Nor does it believe that it was followed where a random action has taken its place.
    last = policy.act(seen, np.array([[0, 0, 1]], dtype=np.int8), nobody, nobody)
    assert heard.played_by_others == [4, 2, *last] == [4, 2, 2]


def test_the_episode_s_seed_is_the_teacher_s_seed_too() -> None:
    labs = Laboratories("unlabelled", 1)
    policy = AdvisedPolicy(RandomPolicy(0, 0), Advisor(agent_policy("random", labs, 0), len(labs.actions)))
    labs.begin(0)
    drawn = []
    for _ in range(2):
        policy.seed(0, 7)
        seen = policy._advisor.shown(
            labs.observe(0, labs.members), labs.mask(0, labs.members), np.zeros(1, dtype=np.int64), labs.members
        )
        drawn.append(seen.tolist())
    assert drawn[0] == drawn[1]


def arguments(**more: Any) -> Any:
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.arguments import training_arguments

    small = {"env_id": "manager", "scenario": "rush", "algo": "maskable-ppo", "hints": "scripted", "bc_steps": 600}
    small |= {"envs": 4, "rollout": 16, "steps": 256, "evaluations": 2, "checkpoints": 4}
    small |= {"eval_episodes": 2, "final_episodes": 2}
    return training_arguments({**small, **more})


@pytest.mark.parametrize("teacher", ["scripted", "scripted@0.3"])
def test_a_batch_shows_the_advice_and_goes_on_alike(teacher: str) -> None:
    """Also if the teacher draws."""
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.sb3 import ChemlabVecEnv
    from chemlab.agents.train.tasks import LaboratoryTask

    task = LaboratoryTask("rush")
    count, size = task.workplace.action_count, task.workplace.observation_space.shape[0]

    def made() -> Any:
        return ChemlabVecEnv(task.batch(3), show_masks=True, advisor=task.advisor(teacher))

    def play(venv: Any, seen: Any, turns: int) -> list[Any]:
        found = []
        for turn in range(turns):
            advice = seen[:, size : size + count].argmax(axis=1)
            legal = seen[:, size + count :]
            assert legal[np.arange(3), advice].all()
            other = count - 1 - legal[:, ::-1].argmax(axis=1)
            shown = seen[:, size : size + count]
            seen, rewards, dones, infos = venv.step(advice if turn % 4 else other)
            for i in np.flatnonzero(dones):  # learners ask what this would be worth: it is like what they have seen
                last = infos[i]["terminal_observation"]
                np.testing.assert_array_equal(last[size:], np.append(shown[i], np.ones(count)))
            found += [seen.copy(), rewards]
        return found

    venv = made()
    venv.seed(5)
    seen = venv.reset()
    assert seen.shape == (3, size + 2 * count)
    seen = play(venv, seen, 30)[-2]
    state, other = venv.get_state(), made()
    again = other.set_state(state)
    np.testing.assert_array_equal(again, seen)
    for one, two in zip(play(venv, seen, 150), play(other, again, 150), strict=True):
        np.testing.assert_array_equal(one, two)


def test_who_plays_in_later_rounds_sees_the_advice_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever has learned to follow it plays on with it, so that it still is what they are shown."""
    pytest.importorskip("sb3_contrib")
    from sb3_contrib import MaskablePPO

    from chemlab.agents.background import role_vector_env
    from chemlab.agents.sb3 import ChemlabVecEnv
    from chemlab.agents.train import imitate as module

    batch, fitted = role_vector_env(4, "rush", autoreset_mode="SameStep"), list[int]()
    actions, teacher = batch.action_count, agent_policy("scripted", batch.laboratories, 0)
    model = MaskablePPO("MlpPolicy", ChemlabVecEnv(batch, advisor=Advisor(teacher, actions)), device="cpu")

    def fit(model: Any, seen: Any, masks: Any, labels: Any, *_: Any) -> float:
        np.testing.assert_array_equal(seen[:, -actions:].argmax(axis=1), labels)
        fitted.append(len(labels))
        return 1.0

    monkeypatch.setattr(module, "as_policy", lambda given: Follower(actions))
    monkeypatch.setattr(module, "fit", fit)
    module.imitate(model, batch, teacher, 600, 0, advised=True, rounds=2)
    assert fitted[1] > 1.4 * fitted[0] > 100


@pytest.mark.slow
def test_a_learner_begins_by_following_and_is_played_with_its_advisor(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.pretrained import load_pretrained
    from chemlab.agents.runs import Run
    from chemlab.agents.train.export import export_run
    from chemlab.agents.train.learn import train
    from chemlab.agents.train.loop import Watcher

    announced, watcher = list[str](), Watcher()
    watcher.cloning = announced.append  # type: ignore[method-assign]
    result = train(arguments(learning_rate=1e-12, bc_steps=2400, final_episodes=20), tmp_path / "run", watcher)
    assert announced == ["scripted"]
    assert result.mean == pytest.approx(result.scripted_mean, abs=0.1)
    best = Run(tmp_path / "run").checkpoint("best")
    assert load_pretrained(best / "manager").card.advice == "scripted"
    labs = Laboratories("rush", 2, split="validation")
    names = (str(tmp_path / "run"), str(best / "manager.safetensors"))
    found = [play_laboratory(labs, make_policies(name, labs, 0), None, 1).returns for name in names]
    np.testing.assert_array_equal(*found)
    exported = export_run(tmp_path / "run", tmp_path / "mine")
    assert exported.advice == "scripted"
    assert exported.observation_size == labs.observation_sizes[0] + len(labs.actions)


def test_what_does_not_go_with_advice(tmp_path: Path) -> None:
    refused("hints: is for maskable-ppo, maskable-recurrent-ppo, not for a2c", arguments, algo="a2c")
    refused("bc: hints are cloned, so it must be 'scripted'; leave it out", arguments, bc="scripted:unsafe")
    own = arguments(env_id=None, scenario="wurtz_dodecane", bench="dit")
    from chemlab.agents.train.learn import train

    refused("hints: are for a laboratory's manager; dit learns here", train, own, tmp_path / "run")
