"""The laboratory for one agent: against an AEC laboratory in which the same policies are moved by hand."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from helpers import assert_is_singles, choose, laboratory, refused

from chemlab.agents.background import role_env, role_vector_env
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.parallel import parallel_env
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.roles.manager_actions import ManagerActions
from chemlab.roles.manager_state import LIMIT

WURTZ = "wurtz_dodecane"
CASES = [
    (WURTZ, "manager_0", "scripted"),
    (WURTZ, "rxn_0", "random"),
    ("wurtz_safe", "ext_0", "random"),
    ("wurtz_two_lines", "manager_0", "random"),
    ("wurtz_two_lines", "dit_0", "scripted"),
]
BENCHES = ("rxn_0", "ext_0", "dit_0")
MEMBERS = [("wurtz_any", "manager_0"), (WURTZ, "ext_0"), ("wurtz_two_lines", "rxn_1")]


class ByHand:
    """A laboratory whose other agents are moved by hand, turn by turn, through PettingZoo's interface."""

    def __init__(self, scenario: str, agent: str, background: str, **arguments: Any) -> None:
        self.env = raw_env(scenario, **arguments)
        self.labs = self.env.laboratories
        self.agent = agent
        self.number = self.env.possible_agents.index(agent)
        self.policies = make_policies(background, self.labs)
        self.last_turn = 0
        self.series, self.episode = np.uint64(0), 0

    def seed(self, sequence: np.random.SeedSequence) -> None:
        """Policies with randomness have a stream of their own each."""
        for policy, own in zip(self.policies.values(), sequence.spawn(len(self.policies)), strict=True):
            if hasattr(policy, "seed"):
                policy.seed(0, own)

    def reset(self, seed: int | None = None) -> npt.NDArray[np.float32]:
        """Begin an episode in which the agent has a turn, the first one of a seed or the next."""
        self.episode += 1
        if seed is not None:
            self.seed(np.random.SeedSequence(seed))
            self.series = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
            self.episode = 1
        else:
            self.seed(np.random.SeedSequence([int(self.series), self.episode]))
        self.env.reset(seed=seed)
        self.others(self.nothing())
        while self.labs.state.status[0] != 0:
            self.labs.episodes.again[:] = True  # stands in for the same episode
            self.env.reset()
            self.others(self.nothing())
        self.last_turn = int(self.labs.state.ticks[0])
        return self.env.observe(self.agent)

    def nothing(self) -> dict[str, Any]:
        """What a step without any turn has led to."""
        events = np.zeros(len(self.env.scenario.safety_events))
        return {"reward": 0.0, "cost": 0.0, "lab_cost": 0.0, "illegal_action": False, "score": 0.0, "events": events}

    def turn(self, action: Any, found: dict[str, Any]) -> None:
        """Somebody's turn, and what it means for the agent."""
        mover = self.env.agent_selection
        self.env.step(action)
        info, score = self.env.infos[mover], float(self.labs.scores[0, self.number])
        found["reward"] += self.env.rewards[self.agent]
        found["lab_cost"] += info["cost"]
        found["events"] += info["events"]
        if mover == self.agent:
            found.update(cost=info["cost"], illegal_action=info["illegal_action"])
        if np.isfinite(score):
            found.update(score=found["score"] + score, experiment_over=True)

    def others(self, found: dict[str, Any]) -> None:
        """Move everybody else until the agent has the turn or all is over."""
        labs = self.labs
        while labs.state.status[0] == 0 and self.env.agent_selection != self.agent:
            mover = self.env.agent_selection
            number = self.env.possible_agents.index(mover)
            mask = self.env.infos[mover].get("action_mask")
            step = labs.state.actions if number == 0 else labs.experiments[number - 1].steps
            seen = self.env.observe(mover)[None]
            action = self.policies[mover].act(seen, None if mask is None else mask[None], step[:1], labs.members)[0]
            self.turn(action, found)

    def step(self, action: Any) -> dict[str, Any]:
        """The agent's turn, and the others' until its next."""
        found = self.nothing() | {"experiment_over": False}
        self.turn(action, found)
        self.others(found)
        ticks, found["terminated"] = int(self.labs.state.ticks[0]), self.labs.state.status[0] != 0
        found["elapsed_ticks"], self.last_turn = ticks - self.last_turn, ticks
        if found["terminated"] and self.number == 0:
            found.update(score=float(self.labs.result(self.labs.members)[0]), experiment_over=True)
        return found


def check_step(hand: ByHand, found: dict[str, Any], step: Any) -> None:
    """A step of the focal view against what was met by hand."""
    observation, reward, terminated, truncated, info = step
    np.testing.assert_array_equal(observation, hand.env.observe(hand.agent))
    assert reward == pytest.approx(found["reward"], rel=1e-12, abs=1e-15)
    assert (terminated, truncated) == (found["terminated"], False)
    for key in ("elapsed_ticks", "experiment_over", "score", "illegal_action"):
        assert info[key] == found[key], key
    assert info["cost"] == pytest.approx(found["cost"], rel=1e-12)
    # Sums over a step are differences of sums over the episode, hence the last digits.
    assert info["lab_cost"] == pytest.approx(found["lab_cost"], rel=1e-9, abs=1e-9)
    assert info["events"] == pytest.approx(found["events"], rel=1e-9, abs=1e-9)
    mask = hand.labs.mask(hand.number, hand.labs.members)
    np.testing.assert_equal(info.get("action_mask"), None if mask is None else mask[0])


@pytest.mark.parametrize(("name", "agent", "background"), CASES)
def test_the_view_is_what_an_agent_meets(name: str, agent: str, background: str) -> None:
    env, hand = role_env(name, agent, background), ByHand(name, agent, background)
    rng = np.random.default_rng(5)
    over, episodes = True, 0
    for step in range(120):
        if over:
            seed = 11 if step == 0 else None
            observation, info = env.reset(seed=seed)
            np.testing.assert_array_equal(observation, hand.reset(seed))
            assert info["elapsed_ticks"] == 0
            assert info["cost"] == 0.0
            assert not info["experiment_over"]
        action = choose(env.laboratories, env.focal, 0, rng)
        result = env.step(action)
        check_step(hand, hand.step(action), result)
        if env.episodes.action_count:
            np.testing.assert_array_equal(env.action_masks(), result[4]["action_mask"] == 1)
        over = result[2] or result[3]
        episodes += over
        for was, now in zip(env.laboratories.snapshot()[:3], hand.labs.snapshot()[:3], strict=True):
            np.testing.assert_array_equal(was, now)
    assert episodes > 0 or (background == "scripted" and agent == "manager_0")


def test_every_interface_says_that_a_limit_terminates() -> None:
    """A limit is observed and nothing follows it: a learner must not add the value of what would follow."""
    spec = load_scenario({"base": WURTZ, "limits": {"manager_actions": 2}})
    move, ends = ManagerActions.of(spec).encode("measure", 0, "balance"), []
    aec = laboratory(spec)
    for _ in range(2):
        aec.step(move)
    assert aec.laboratories.state.status[0] == LIMIT
    ends += [(aec.terminations[agent], aec.truncations[agent]) for agent in aec.possible_agents]
    interfaces: list[tuple[Any, Any]] = [
        (parallel_env(spec), {"manager_0": move}),
        (role_env(spec), move),
        *((BatchedLaboratory(2, spec, autoreset=own), {"manager_0": np.full(2, move)}) for own in (True, False)),
        *((role_vector_env(2, spec, autoreset_mode=mode), np.full(2, move)) for mode in AutoresetMode),
    ]
    for env, actions in interfaces:
        env.reset(seed=0)
        env.step(actions)
        _, _, over, cut, _ = env.step(actions)
        over, cut = (list(end.values()) if isinstance(end, dict) else end for end in (over, cut))
        ends += zip(np.atleast_1d(over).tolist(), np.atleast_1d(cut).tolist(), strict=True)
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.sb3 import ChemlabVecEnv

    venv = ChemlabVecEnv(role_vector_env(2, spec, autoreset_mode=AutoresetMode.SAME_STEP))
    venv.reset()
    venv.step(np.full(2, move))
    _, _, dones, infos = venv.step(np.full(2, move))
    ends += [(bool(done), info["TimeLimit.truncated"]) for done, info in zip(dones, infos, strict=True)]
    assert len(ends) == 4 + 4 + 1 + 2 * 2 + 3 * 2 + 2
    assert set(ends) == {(True, False)}


@pytest.mark.parametrize("background", ["scripted", "random"])
@pytest.mark.parametrize(
    ("name", "agent", "mode"), [(*case, mode) for case, mode in zip(MEMBERS, AutoresetMode, strict=True)]
)
def test_members_are_single_environments(name: str, agent: str, background: str, mode: AutoresetMode) -> None:
    """Member i of any number of them is the environment with seed s + i, whichever way it is reset."""
    count = 3 if background == "scripted" else 6
    batch = role_vector_env(count, name, agent, background, autoreset_mode=mode)
    singles = [role_env(name, agent, background) for _ in range(count)]
    rngs = [np.random.default_rng([7, i]) for i in range(count)]

    def act(step: int, i: int) -> Any:
        return choose(singles[i].laboratories, singles[i].focal, 0, rngs[i])

    ends = assert_is_singles(batch, singles, 70, act, 60)
    assert ends > 0 or background == "scripted" or agent != "manager_0"


def anything(observation: Any, mask: Any) -> Any:
    """A policy without memory or randomness."""
    return np.full((len(observation), 6), 0.5) if mask is None else mask.argmax(axis=1)


class Model:
    """What Stable-Baselines3's models look like from outside."""

    def __init__(self, end: int) -> None:
        self.end = end
        self.given: list[Any] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: Any = False
    ) -> Any:
        self.given.append((observation.shape, deterministic))
        return np.full(len(observation), self.end), None


class Maskable(Model):
    """What sb3-contrib's maskable models look like."""

    def predict(self, observation: Any, *others: Any, action_masks: Any = None, **more: Any) -> Any:
        assert action_masks.shape == (len(observation), self.end + 1)
        assert action_masks.any(axis=1).all()
        return super().predict(observation, *others, **more)


def test_models_and_functions_play() -> None:
    rested: list[Any] = []

    def rest(observation: Any, mask: Any) -> list[list[float]]:
        rested.append((observation.shape, mask))
        return [[0.5, 0.5, 0.0, 0.0, 0.0, 0.0]] * len(observation)

    plain, masked = Model(40), Maskable(30)
    batch = RoleVectorEnv(2, WURTZ, "manager_0", {"rxn_0": rest, "ext_0": plain, "dit_0": masked})
    batch.reset(seed=0)
    encode = batch.laboratories.actions.encode
    limit = batch.scenario.benches["rxn"].step_limit
    for bench, ticks in (("ext_0", 1), ("dit_0", 1), ("rxn_0", limit)):
        batch.step(np.full(2, encode("start", bench, 0, "dodecane")))
        *_, infos = batch.step(np.full(2, encode("wait")))
        assert infos["elapsed_ticks"].tolist() == [ticks, ticks]
    assert plain.given == [((2, 307), True)]
    assert masked.given == [((2, 310), True)]
    assert rested == [((2, 213), None)] * limit or rested == [((2, 214), None)] * limit


@pytest.mark.parametrize("nonsense", [None, "settle", [], [41], [1.0], [[1], [1, 2]], [10**400]], ids=repr)
def test_a_policy_that_talks_nonsense_is_named(nonsense: Any) -> None:
    """The error names its agent; the laboratory asks for a reset, and is then as good as new."""
    env = role_env(WURTZ, "manager_0", {"ext_0": lambda observation, mask: nonsense})
    encode = env.laboratories.actions.encode
    env.reset(seed=0)
    env.step(encode("start", "ext_0", 0, "dodecane"))
    refused(r"^ext_0: actions must be 1 integers from 0 to 40", env.step, encode("wait"))
    # Halfway through a step nobody can go on; what a reset heals: test_interrupts.py.
    with pytest.raises(ResetNeeded):
        env.step(encode("wait"))


def test_masked_actions_of_the_background_are_lost_turns() -> None:
    """A background policy may play against its mask: that is its own lost turn, no error."""
    env = role_env(WURTZ, "manager_0", {"ext_0": lambda observation, mask: mask.argmin(axis=1)})
    encode = env.laboratories.actions.encode
    env.reset(seed=0)
    env.step(encode("start", "ext_0", 0, "dodecane"))
    *_, info = env.step(encode("wait"))
    assert info["elapsed_ticks"] == env.scenario.benches["ext"].step_limit
    assert not info["illegal_action"]  # the manager's was not


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"agent": "rxn_1"}, ValueError, "'rxn_1'.*manager_0, rxn_0, ext_0, dit_0|manager_0.*'rxn_1'"),
        ({"starts": "paper", "goals": "dodecane"}, ValueError, "goals, starts.*bench"),
        ({"bench": "rxn", "agent": "rxn_0"}, ValueError, "agent, policies.*bench alone"),
        ({"policies": "scripted"}, TypeError, "dict of policies by agent.*'scripted'.*background="),
        ({"policies": {"rxn_0": anything}}, ValueError, "missing for ext_0, dit_0.*given rxn_0"),
        ({"policies": dict.fromkeys(BENCHES, "scripted")}, TypeError, "rxn_0.*predict.*'scripted'"),
        ({"render_mode": "hologram"}, ValueError, "'hologram'"),
        ({"scenario": "atlantis"}, ValueError, "atlantis"),
    ],
)
def test_bad_arguments(arguments: dict[str, Any], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        RoleEnv(**{"policies": dict.fromkeys(BENCHES, anything), **arguments})


def test_an_agent_that_never_has_a_turn_is_named() -> None:
    def idle(observation: Any, mask: Any) -> Any:
        return np.array([row.nonzero()[0][-1] for row in mask])  # submits, recalls or waits: never starts

    env = RoleEnv(WURTZ, "rxn_0", {"manager_0": idle, "ext_0": anything, "dit_0": anything})
    with pytest.raises(RuntimeError, match="rxn_0: had no turn"):
        env.reset(seed=0)
    with pytest.raises(ResetNeeded):
        env.step(np.full(6, 0.5))


def test_render_and_meanings() -> None:
    env = role_env(WURTZ, render_mode="ansi")
    env.reset(seed=0)
    assert WURTZ.split("_")[1] in str(env.render())
    assert len(env.action_meanings) == env.action_space.n  # type: ignore[attr-defined]
    assert len(role_env(WURTZ, "rxn_0").action_meanings) == 6
    refused("rxn_0: continuous", role_vector_env(1, WURTZ, "rxn_0").action_masks)
