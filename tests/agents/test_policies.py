"""Policies in general: making them, by former names, too; and the random one, which is uniform over legal actions."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import refused

from chemlab.agents import former_names
from chemlab.agents import policies as policies_module
from chemlab.agents.background import role_env
from chemlab.agents.episodes import play_episode, play_laboratory
from chemlab.agents.former_names import current_name
from chemlab.agents.policies import make_policies, policy_names
from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories


def chi_square(counts: Any) -> float:
    """Statistic of counts against equal chances; as many degrees of freedom as counts, less one."""
    counts = np.asarray(counts, dtype=np.float64)
    return float(((counts - counts.mean()) ** 2 / counts.mean()).sum())


def act(policy: RandomPolicy, mask: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Actions for a batch of masks."""
    n = len(mask)
    return policy.act(np.zeros((n, 1), dtype=np.float32), mask, np.zeros(n, dtype=np.int64), np.arange(n))


def test_random_actions_are_uniform_over_the_legal_ones() -> None:
    legal = [0, 1, 7, 8, 20, 33, 40]
    mask = np.zeros((7000, 41), dtype=np.int8)
    mask[:, legal] = 1
    counts = np.bincount(act(RandomPolicy(0, 1), mask), minlength=41)
    assert counts.nonzero()[0].tolist() == legal
    assert chi_square(counts[legal]) < 30.0  # 6 degrees of freedom: beyond 30 once in 25,000


def test_random_numbers_are_uniform_and_in_the_box() -> None:
    seen, steps, members = np.zeros((5000, 1), dtype=np.float32), np.zeros(5000, dtype=np.int64), np.arange(5000)
    actions = RandomPolicy(6, 2).act(seen, None, steps, members)
    assert actions.shape == (5000, 6)
    assert 0.0 <= actions.min() < actions.max() < 1.0
    for column in actions.T:
        assert chi_square(np.histogram(column, bins=10, range=(0.0, 1.0))[0]) < 40.0  # 9 degrees of freedom


@pytest.mark.parametrize("policy", policy_names())
@pytest.mark.parametrize("name", ["relay", "unlabelled", "wurtz_two_lines"])
def test_there_is_a_policy_for_every_agent(name: str, policy: str) -> None:
    env = raw_env(name)
    try:
        policies = make_policies(policy, env.laboratories, seed=0)
    except ValueError as error:
        reason = dict.fromkeys(("pretrained", "pretrained-isolated", "trained"), "no pretrained policy fits")
        reason |= {"scripted:memoryless": "has nothing to forget", "scripted:fifo": "has no orders to choose from"}
        reason["plan"] = "none is stored"
        if policy not in reason or reason[policy] not in str(error):
            raise
        pytest.skip(f"{name}: policies come for the benches of wurtz_dodecane and those that are like them")
    assert list(policies) == env.possible_agents
    for number, agent in enumerate(env.possible_agents):
        space = env.action_space(agent)
        seen = np.zeros((3, *env.observation_space(agent).shape), dtype=np.float32)  # type: ignore[misc]
        mask = np.ones((3, int(space.n)), dtype=np.int8) if isinstance(space, gymnasium.spaces.Discrete) else None
        actions = policies[agent].act(seen, mask, np.zeros(3, dtype=np.int64), np.arange(3))
        assert len(actions) == 3
        for action in actions:
            env.laboratories.checked(number, action)  # raises where it is outside the space


def test_random_policies_are_seeded_and_independent() -> None:
    labs, mask = Laboratories("wurtz_dodecane"), np.ones((200, 31), dtype=np.int8)
    first, again, other = (make_policies("random", labs, seed=seed) for seed in (1, 1, 2))
    agents = ((first, "ext_0"), (first, "dit_0"), (again, "ext_0"), (again, "dit_0"), (other, "ext_0"))
    drawn = (act(policies[agent], mask).tolist() for policies, agent in agents)  # type: ignore[arg-type]
    ext, dit, *repeated, ext_other = drawn
    assert [ext, dit] == repeated
    assert ext not in (dit, ext_other)


@pytest.mark.parametrize("policy", ["random", "scripted@0.3", "scripted,manager=random", "trained:sampled@0.1"])
def test_what_a_policy_draws_depends_on_the_episode_s_seed_alone(policy: str) -> None:
    """The same episode by itself, in a batch whatever its place, and in the manager's own environment."""
    env, together = raw_env("rush"), [Laboratories("rush", 3), Laboratories("rush", 2)]
    alone = [play_episode(env, make_policies(policy, env.laboratories), seed).score for seed in (40, 41, 42)]
    first, second = (
        play_laboratory(labs, make_policies(policy, labs), None, seed).returns.tolist()
        for labs, seed in zip(together, (40, 41), strict=True)
    )
    assert first == alone
    assert second == alone[1:]
    manager = make_policies(policy, env.laboratories)["manager_0"]
    view = role_env("rush", background=policy)
    seen, _ = view.reset(seed=41)
    # The view has no policy for the manager; its stream is that of the first agent.
    manager.seed(0, np.random.SeedSequence(41).spawn(1)[0])  # type: ignore[attr-defined]
    turn, over = 0, False
    while not over:
        mask, number = view.action_masks()[None].astype(np.int8), np.array([turn])
        (action,) = manager.act(seen[None], mask, number, np.array([0]))
        seen, _, terminated, truncated, info = view.step(int(action))
        turn, over = turn + 1, terminated or truncated
    assert info["score"] == pytest.approx(alone[1])


def test_an_unknown_policy_is_refused() -> None:
    labs = Laboratories("fictitious")
    said = refused("'omniscient'", make_policies, "omniscient", labs)
    assert [name for name in policy_names() if name not in said] == []
    refused(r"did you mean scripted\?", make_policies, "scriptd", labs)


@pytest.fixture
def unscripted(monkeypatch: pytest.MonkeyPatch) -> Scenario:
    """A laboratory with a bench of somebody's own, of which nothing has been said yet."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "bench"))
    monkeypatch.setattr(policies_module, "_UNSCRIPTED", set())
    values = load_scenario("fictitious").model_dump()
    values["benches"]["fil"] = {"kind": "filtration_bench:FiltrationBench", "step_limit": 5, "count": 2}
    return load_scenario(values)


def test_a_bench_without_a_script_plays_random_legal_actions_and_says_so_once(unscripted: Scenario) -> None:
    env = raw_env(unscripted)
    labs = env.laboratories
    said = r"'fil' plays random legal actions: .* kind 'filtration_bench:FiltrationBench' .*reaction, extraction"
    with pytest.warns(UserWarning, match=said) as caught:
        policies = make_policies("scripted", labs, seed=5)
    assert len(caught) == 1, "of two agents, too"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_policies("scripted:unsafe", labs)
    assert isinstance(policies["fil_0"], RandomPolicy)
    assert not isinstance(policies["dit_0"], RandomPolicy)
    drawn = [act(policies[agent], np.ones((200, 2), dtype=np.int8)).tolist() for agent in ("fil_0", "fil_1")]
    assert drawn[0] != drawn[1], "every agent has dice of its own"
    mask = np.zeros((6000, 2), dtype=np.int8)
    mask[:, 1] = 1
    assert act(policies["fil_0"], mask).tolist() == [1] * 6000
    result, alone = play_episode(env, policies, 0), raw_env("fictitious")
    without = play_episode(alone, make_policies("scripted", alone.laboratories, 0), 0)
    assert result.status == "submitted"
    assert result.score == pytest.approx(without.score), "the manager does without it"


@pytest.mark.parametrize(
    ("given", "current"),
    [
        ("heuristic", "scripted"),
        ("pretrained,manager=direct", "pretrained,manager=scripted:no-extraction"),
        ("heuristic,rxn_0=hasty@0.2", "scripted,rxn_0=scripted:unsafe@0.2"),
        ("runs/heuristic", "runs/heuristic"),
        ("plan:hasty", "plan:hasty"),
    ],
)
def test_former_names_are_replaced_in_every_part(given: str, current: str) -> None:
    assert current_name(given) == current


def test_a_notice_names_former_names_once(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(former_names, "_noticed", set())
    for _ in range(2):
        current_name("heuristic,manager=hasty")
    told = "policy '{}' is now called '{}'; the old name ends with this release\n"
    expected = told.format("heuristic", "scripted") + told.format("hasty", "scripted:unsafe")
    assert capsys.readouterr() == ("", expected)
