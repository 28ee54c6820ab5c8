"""Batched laboratories and the parallel environment are single laboratories, round by round; refusals."""

import copy
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, assert_plays_rounds, digest, lasting, refused, state_of

from chemlab.envs.batch import BatchedLaboratory
from chemlab.laboratory import parallel_env


class Batched:
    """A batch beside AEC's rounds; rows of members without the turn are no actions at all."""

    def __init__(self, name: str, members: int, **arguments: Any) -> None:
        self.env = env = BatchedLaboratory(members, name, **arguments)
        self.autoreset, self.whole, self.kept = env.autoreset, env.infos, [[], []]

    def reset(self, seed: int | None = None, which: Any = None) -> list[dict[str, Any]]:
        seen, infos = self.env.reset(seed=seed, options=None if which is None else {"reset_mask": which})
        return [self.shown(seen, infos, member) for member in range(self.env.num_envs)]

    def step(self, chosen: list[dict[str, Any]]) -> list[dict[str, Any]]:
        env, several = self.env, {}
        for agent in {agent: None for actions in chosen for agent in actions}:  # nobody asks for others
            shape = env.action_space(agent).shape
            none = np.full(shape, np.nan) if shape else -5
            several[agent] = np.array([actions.get(agent, none) for actions in chosen])
        seen, rewards, terminated, truncated, infos = env.step(several)
        if env.copy:  # what was returned is the caller's
            np.testing.assert_equal(*self.kept)
            returned = seen, rewards, terminated, truncated, infos
            self.kept = [returned, copy.deepcopy(returned)]
        over, found = np.flatnonzero(terminated | truncated), []
        finals = {agent: info["final_obs"] for agent, info in infos.items() if "final_obs" in info}
        assert set(finals) == (set(env.possible_agents) if len(over) and env.infos else set())
        for member in range(env.num_envs):
            own = self.shown(seen, infos, member)
            own["rewards"] = {agent: paid[member] for agent, paid in rewards.items()}
            own["terminated"] = dict.fromkeys(env.possible_agents, terminated[member])
            own["truncated"] = dict.fromkeys(env.possible_agents, truncated[member])
            if member in over:
                own["final"] = {agent: rows[list(over).index(member)] for agent, rows in finals.items()}
            if not env.infos:
                own["paid"] = round(infos["manager_0"]["paid"][member], 9)
            found.append(own)
        return found

    def shown(self, seen: dict[str, Any], infos: dict[str, Any], member: int) -> dict[str, Any]:
        env, state = self.env, self.env.state()
        assert (state.shape, state.dtype) == ((env.num_envs, *env.state_space.shape), np.float32)
        who = [agent for agent in env.possible_agents if env.idle_observations or infos[agent]["has_turn"][member]]
        apart = {"final_obs"} if env.infos else {"paid", "partial"}
        own = {agent: {key: info[key][member] for key in info.keys() - apart} for agent, info in infos.items()}
        if not env.infos:
            assert apart < infos["manager_0"].keys()
            told = {"has_turn", "experiment_over", "score", "action_mask"}
            assert all(info.keys() | {"action_mask"} == told for info in own.values())
        return {"observations": {agent: seen[agent][member] for agent in who}, "infos": own, "state": state[member]}


@pytest.mark.parametrize(("name", "members"), [("wurtz_two_lines", 3), ("wurtz_scarce", 8), ("wurtz_any", 3)])
def test_members_are_single_laboratories(name: str, members: int) -> None:
    """Member i with seed s + i is a laboratory with that seed, through several episodes, in everything."""
    ways: tuple[dict[str, Any], ...] = ({"idle_observations": True}, {"infos": False}, {"autoreset": False})
    assert all(assert_plays_rounds(Batched(name, members, **way), name, members, 210 // members) > 0 for way in ways)


@pytest.mark.parametrize("name", FEATURED)
@np.errstate(all="raise")  # a common way to find a learner's NaN: nothing here may fail by it
def test_idle_rows_may_be_left_as_they_were(name: str) -> None:
    """Without ``idle_observations`` agents with the turn see the same, and results are the same."""
    assert_plays_rounds(Batched(name, 3, copy=False), name, 3, 60)


def test_states_of_some() -> None:
    batch = BatchedLaboratory(3)
    batch.reset(seed=0)
    whole = batch.state()
    for some in (np.array([2, 0]), [1], [], np.array([False, True, True]), np.zeros(3, dtype=np.bool_)):
        np.testing.assert_array_equal(batch.state(some), whole[np.array(some, dtype=bool if len(some) == 3 else int)])


def test_seeds_of_members_and_resets_of_some() -> None:
    batch = BatchedLaboratory(4, "wurtz_any")
    seen, _ = batch.reset(seed=[7, 3, 7, 5])
    np.testing.assert_array_equal(seen["manager_0"][0], seen["manager_0"][2])
    first = batch.laboratories.snapshot()
    batch.step({"manager_0": np.full(4, batch.laboratories.actions.encode("start", "rxn_0", 0, "dodecane"))})
    moved = batch.laboratories.snapshot()
    batch.laboratories.state.cost[:] = 1.0
    _, infos = batch.reset(seed=[9, 3, 9, 9], options={"reset_mask": np.array([False, True, False, False])})
    assert not any(info["cost"].any() for info in infos.values()), "nothing has happened to the others"
    for now, was, then in zip(batch.laboratories.snapshot()[:3], first, moved, strict=False):
        np.testing.assert_array_equal(now[1], was[1])
        np.testing.assert_array_equal(now[[0, 2, 3]], then[[0, 2, 3]])
    batch.step({"manager_0": np.full(4, batch.laboratories.actions.encode("wait"))})
    np.testing.assert_equal(batch.reset(seed=[7, 3, 7, 5])[0], seen, "a seed gives the same observations of all agents")
    batch.reset(seed=1, options={"goal": "NaCl"})
    assert {batch.scenario.goals[goal] for goal in batch.laboratories.state.goal[:, 0]} == {"NaCl"}
    # A batch that was never seeded draws seeds, and not the same for all.
    other = BatchedLaboratory(6, "wurtz_any")
    other.reset()
    assert len(set(other.laboratories.state.stream[:, 0].tolist())) == 6


def mixed() -> tuple[BatchedLaboratory, dict[str, npt.NDArray[Any]]]:
    """Three laboratories: in the first the manager has the turn, in the others rxn_0 and ext_0; actions for all."""
    batch = BatchedLaboratory(3)
    encode = batch.laboratories.actions.encode
    batch.reset(seed=0)
    balance = encode("measure", 0, "balance")
    batch.step({"manager_0": np.array([balance, *[encode("start", "rxn_0", 0, "dodecane")] * 2])})
    batch.step({"manager_0": np.array([balance, *[encode("start", "ext_0", 1, "dodecane")] * 2])})
    *_, infos = batch.step({"manager_0": np.array([balance, encode("wait"), encode("wait")])})
    turns = [infos[agent]["has_turn"].tolist() for agent in batch.possible_agents]
    assert turns == [[True, False, False], [False, True, True], [False, True, True], [False] * 3]
    return batch, {"manager_0": np.array([balance, 0, 0]), "rxn_0": np.full((3, 6), 0.5), "ext_0": np.array([0, 3, 3])}


def after(batch: BatchedLaboratory, actions: dict[str, Any]) -> str:
    """Digest of the state after a step."""
    batch.step(actions)
    return digest(batch.laboratories.snapshot())


WRONG: list[tuple[str, Any]] = [
    ("manager_0", np.array([-1, 0, 0])),
    ("manager_0", np.array([0.0, 0.0, 0.0])),
    ("manager_0", np.zeros(2, dtype=np.int64)),
    ("manager_0", None),
    ("manager_0", np.array([2**64 - 1, 0, 0], dtype=np.uint64)),
    ("ext_0", np.array([0, 3, 41])),
    ("ext_0", [[0], [3, 4], [3]]),
    ("rxn_0", np.where(np.arange(18).reshape(3, 6) == 9, np.nan, 0.5)),
    ("rxn_0", np.where(np.arange(18).reshape(3, 6) == 17, 1.0001, 0.5)),
    ("rxn_0", np.full((3, 6), 0.5, dtype=object)),
]


def test_one_bad_action_spoils_the_step() -> None:
    batch, actions = mixed()
    before = state_of(batch)
    for agent, rows in WRONG:
        refused(f"^{agent}: actions must be", batch.step, {**actions, agent: rows})
        others = {name: array for name, array in actions.items() if name != agent}
        refused(f"^{agent}: has the turn", batch.step, others)
        assert state_of(batch) == before, (agent, rows)
    assert after(batch, actions) == after(*mixed())


def test_what_is_played_without_the_turn_is_ignored() -> None:
    expected = after(*mixed())
    noise: list[dict[str, Any]] = [
        {"manager_0": np.array([0, -9, 10**12]), "ext_0": np.array([999, 3, 3]), "dit_0": None},
        {"rxn_0": np.array([[np.nan] * 6, [0.5] * 6, [0.5] * 6]), "dit_0": "heat"},
        {"dit_0": np.full(3, -1), "nobody_0": object()},
    ]
    for wrong in noise:
        batch, actions = mixed()
        if "manager_0" in wrong:
            wrong["manager_0"][0] = actions["manager_0"][0]
        assert after(batch, {**actions, **wrong}) == expected, wrong


def test_any_layout_width_and_byte_order_will_do() -> None:
    """Slices of a plan, transposed arrays, what a network in half precision gives."""
    expected, numbers = after(*mixed()), mixed()[1]["ext_0"]
    boxes: list[Any] = [np.full((3, 6, 5), 0.5)[:, :, 2], np.full((6, 3), 0.5).T, np.broadcast_to(0.5, (3, 6))]
    boxes += [np.full((3, 6), 0.5, dtype=width) for width in (np.float16, ">f4", np.longdouble)] + [[[0.5] * 6] * 3]
    whole = [np.repeat(numbers, 2)[::2], numbers[::-1].copy()[::-1], numbers.tolist()]
    whole += [numbers.astype(width) for width in (">i4", np.uint8)]
    for agent, rows in (*(("rxn_0", rows) for rows in boxes), *(("ext_0", rows) for rows in whole)):
        batch, actions = mixed()
        assert after(batch, {**actions, agent: rows}) == expected


class Parallel:
    """The parallel environment beside AEC's rounds; idle agents play junk, returned arrays are overwritten."""

    autoreset, whole = False, True

    def __init__(self, name: str) -> None:
        self.env, self.rng = parallel_env(name), np.random.default_rng(0)
        self.given: list[Any] = []

    def reset(self, seed: int | None = None, which: Any = None) -> list[dict[str, Any]]:
        return self.shown(self.env.reset(seed=seed))

    def step(self, actions: list[dict[str, Any]]) -> list[dict[str, Any]]:
        things = [None, -1, 10**9, "wait", float("nan"), np.full(3, np.nan), object(), [], {}]
        noise = {agent: things[self.rng.integers(9)] for agent in self.env.agents if self.rng.random() < 0.7}
        for array in self.given:
            array[:] = 9
        found = self.env.step({**noise, **actions[0]})
        assert self.env.agents == ([] if any(found[2].values()) else self.env.possible_agents)
        return self.shown(found)

    def shown(self, found: Any) -> list[dict[str, Any]]:
        seen, *rest, infos = found
        self.given = [*seen.values(), *(info["action_mask"] for info in infos.values() if "action_mask" in info)]
        own = dict(zip(("rewards", "terminated", "truncated"), rest, strict=False))
        assert all(ends.keys() == seen.keys() == infos.keys() for ends in rest)
        own |= {"observations": seen, "infos": infos, "state": self.env.state()}
        return [{**own, "arrays": lasting(self.env.laboratories)}]


@pytest.mark.parametrize("name", ["failing", "refine"])
def test_one_script_is_one_episode(name: str) -> None:
    """Rewards, costs, scores, infos, observations, masks and the whole state, after every round."""
    assert assert_plays_rounds(Parallel(name), name, 1, 200, submit=0.1) > 0


def test_a_missing_action_is_asked_for() -> None:
    env = parallel_env()
    actions = env.laboratories.actions
    env.reset(seed=0)
    for move in (("start", "rxn_0", 0, "dodecane"), ("start", "ext_0", 1, "dodecane"), ("wait",)):
        *_, infos = env.step({"manager_0": actions.encode(*move)})
    chosen = {"rxn_0": np.full(6, 0.5), "ext_0": 3}
    assert [agent for agent in env.agents if infos[agent]["has_turn"]] == list(chosen)
    before = state_of(env)
    for missing in chosen:
        given = {agent: action for agent, action in chosen.items() if agent != missing}
        refused(f"{missing}: has the turn", env.step, given)
        assert state_of(env) == before


@pytest.mark.parametrize("make", [parallel_env, lambda name: BatchedLaboratory(1, name)], ids=["parallel", "batch"])
def test_a_start_with_a_safety_event_is_shown_to_the_bench(make: Any) -> None:
    """Though it has not acted in this round."""
    env: Any = make("wurtz_dodecane")
    env.reset(seed=0)
    labs, play = env.laboratories, env.laboratories.act_round

    def eventful(*arguments: Any) -> None:
        play(*arguments)
        labs.state.cost[1, 0] = 0.25
        labs.roles[1].events[0] = 1.0

    labs.act_round = eventful
    start = labs.actions.encode("start", "rxn_0", 0, "dodecane")
    infos = env.step({"manager_0": start if make is parallel_env else np.array([start])})[-1]
    assert np.ravel(infos["rxn_0"]["cost"]) == [0.25]
    assert np.ravel(infos["rxn_0"]["events"]).all()
