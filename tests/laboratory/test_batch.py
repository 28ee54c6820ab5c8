"""Batched laboratories: every member is the single laboratory, whatever the batch; what is refused; what is ignored."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, slow_but

from chemlab.config.loading import load_scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.laboratory import parallel_env
from chemlab.roles.manager_actions import SUBMIT, WAIT
from studies.speed.soak import broken, soak

SEED = 30


def choose(batch: BatchedLaboratory, member: int, rng: np.random.Generator) -> dict[str, Any]:
    """Actions of the agents with the turn in one laboratory: three of four legal."""
    labs, members = batch.laboratories, np.array([member])
    actions: dict[str, Any] = {}
    for number in np.flatnonzero(labs.turns(members)[:, 0]):
        agent = labs.agents[number]
        mask = labs.mask(int(number), members)
        if mask is None:
            actions[agent] = rng.random(labs.action_space(int(number)).shape)  # type: ignore[arg-type]
            continue
        legal = np.flatnonzero(mask[0]) if rng.random() < 0.75 else np.arange(mask.shape[1])
        if number == 0:
            kinds = labs.actions.table[legal, 0]
            if WAIT in kinds and rng.random() < 0.3:
                legal = legal[kinds == WAIT]
            elif rng.random() < 0.7 and (kinds != SUBMIT).any():
                legal = legal[kinds != SUBMIT]
        actions[agent] = int(rng.choice(legal))
    return actions


def stacked(batch: BatchedLaboratory, chosen: list[dict[str, Any]]) -> dict[str, npt.NDArray[Any]]:
    """One array an agent; rows of members without the turn are no actions at all."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    for agent in batch.possible_agents:
        shape = batch.action_space(agent).shape
        if not any(agent in actions for actions in chosen):
            continue  # nobody asks for it
        rows = np.full((len(chosen), *shape), np.nan) if shape else np.full(len(chosen), -5)  # type: ignore[misc]
        for member, actions in enumerate(chosen):
            if agent in actions:
                rows[member] = actions[agent]
        arrays[agent] = rows
    return arrays


def assert_same_seen(one: dict[str, npt.NDArray[Any]], member: int, other: dict[str, npt.NDArray[Any]]) -> None:
    """Observations of one member and of a single laboratory."""
    for agent, array in one.items():
        np.testing.assert_array_equal(array[member], other[agent])


@pytest.mark.parametrize(
    ("name", "count"), slow_but([("wurtz_two_lines", 3), ("wurtz_scarce", 8)], ("wurtz_two_lines", 3))
)
def test_members_are_single_laboratories(name: str, count: int) -> None:
    """Member i with seed s + i is a parallel laboratory with that seed, through several episodes, in everything."""
    batch = BatchedLaboratory(count, name, idle_observations=True)
    singles = [parallel_env(name) for _ in range(count)]
    rngs = [np.random.default_rng(i) for i in range(count)]
    seen, infos = batch.reset(seed=SEED)
    for member, single in enumerate(singles):
        own, own_infos = single.reset(seed=SEED + member)
        assert_same_seen(seen, member, own)
        compare_infos(infos, member, own_infos)
    ended = 0
    for _ in range(250):
        chosen = [choose(batch, member, rng) for member, rng in enumerate(rngs)]
        seen, rewards, terminated, truncated, infos = batch.step(stacked(batch, chosen))
        np.testing.assert_array_equal(infos["manager_0"]["experiment_over"], terminated | truncated)
        assert not infos["manager_0"]["score"][~(terminated | truncated)].any()
        order = np.flatnonzero(terminated | truncated)
        assert all(("final_obs" in infos[agent]) == bool(len(order)) for agent in batch.possible_agents)
        for member, single in enumerate(singles):
            own, paid, over, cut, own_infos = single.step(chosen[member])
            for agent in batch.possible_agents:
                assert rewards[agent][member] == paid[agent]
                assert terminated[member] == over[agent]
                assert truncated[member] == cut[agent]
                assert infos[agent].keys() - {"final_obs"} == own_infos[agent].keys()
                for key in own_infos[agent].keys() - {"action_mask", "has_turn"}:  # of the step; those are of the next
                    np.testing.assert_array_equal(infos[agent][key][member], own_infos[agent][key], key)
            if not single.agents:
                ended += 1
                place = int(np.flatnonzero(order == member)[0])
                for agent in batch.possible_agents:
                    np.testing.assert_array_equal(infos[agent]["final_obs"][place], own[agent])
                result = single.laboratories.result(single.laboratories.members)[0]
                assert infos["manager_0"]["score"][member] == result
                own, own_infos = single.reset()
            assert_same_seen(seen, member, own)
            compare_infos(infos, member, own_infos)
    assert ended > 0 or count < 8


def compare_infos(infos: dict[str, dict[str, Any]], member: int, own: dict[str, dict[str, Any]]) -> None:
    """Turns and masks of one member and of a single laboratory."""
    for agent, info in infos.items():
        assert info["has_turn"][member] == own[agent]["has_turn"]
        assert ("action_mask" in info) == ("action_mask" in own[agent])
        if "action_mask" in info:
            np.testing.assert_array_equal(info["action_mask"][member], own[agent]["action_mask"])


@pytest.mark.parametrize("name", FEATURED)
def test_idle_rows_may_be_left_as_they_were(name: str) -> None:
    """Without ``idle_observations`` agents with the turn see the same, and results are the same."""
    whole, fast = BatchedLaboratory(5, name, idle_observations=True), BatchedLaboratory(5, name, copy=False)
    rng = np.random.default_rng(0)
    seen, infos = whole.reset(seed=1)
    quick, _ = fast.reset(seed=1)
    for _ in range(60):
        for agent in whole.possible_agents:
            turn = infos[agent]["has_turn"]
            np.testing.assert_array_equal(seen[agent][turn], quick[agent][turn])
        actions = stacked(whole, [choose(whole, member, rng) for member in range(5)])
        kept = {agent: array.copy() for agent, array in seen.items()}
        before = dict(seen)
        seen, rewards, terminated, truncated, infos = whole.step(actions)
        for agent, array in before.items():
            np.testing.assert_array_equal(array, kept[agent])  # copies are the caller's
        quick, others, *rest, _ = fast.step(actions)
        for agent in whole.possible_agents:
            np.testing.assert_array_equal(rewards[agent], others[agent])
        np.testing.assert_array_equal(terminated, rest[0])
        np.testing.assert_array_equal(truncated, rest[1])


# -- seeds and resets -----------------------------------------------------------------------------------------------


def test_short_infos_change_nothing_else() -> None:
    """Without complete infos, all else is the same, over the ends of episodes."""
    name, rng = "wurtz_two_lines", np.random.default_rng(SEED)
    full, short = BatchedLaboratory(3, name), BatchedLaboratory(3, name, infos=False)
    seen, brief = full.reset(seed=SEED), short.reset(seed=SEED)
    ended = 0
    for _ in range(250):
        for agent in full.possible_agents:
            told = {"has_turn", "experiment_over", "score"} | ({"action_mask"} & set(seen[-1][agent]))
            assert set(brief[-1][agent]) == told | ({"paid", "partial"} if agent == "manager_0" else set())
            np.testing.assert_array_equal(seen[0][agent], brief[0][agent])
            for key in told:
                np.testing.assert_array_equal(seen[-1][agent][key], brief[-1][agent][key])
        actions = stacked(full, [choose(full, member, rng) for member in range(3)])
        seen, brief = full.step(actions), short.step(actions)
        np.testing.assert_equal(seen[1:4], brief[1:4])
        manager, over = seen[-1]["manager_0"], seen[2]
        paid = brief[-1]["manager_0"]["paid"]
        assert paid[over] == pytest.approx((manager["score"] + manager["costs"].sum(axis=1))[over])
        assert not paid[~over].any()
        ended += int(over.sum())
    assert ended > 0


def test_seeds_of_members_and_resets_of_some() -> None:
    batch = BatchedLaboratory(4, "wurtz_any")
    seen, _ = batch.reset(seed=[7, 3, 7, 5])
    np.testing.assert_array_equal(seen["manager_0"][0], seen["manager_0"][2])
    first = batch.laboratories.snapshot()
    start = batch.laboratories.actions.encode("start", "rxn_0", 0, "dodecane")
    batch.step({"manager_0": np.full(4, start)})
    moved = batch.laboratories.snapshot()
    batch.reset(seed=[9, 3, 9, 9], options={"reset_mask": np.array([False, True, False, False])})
    for now, was, then in zip(batch.laboratories.snapshot()[:3], first, moved, strict=False):
        np.testing.assert_array_equal(now[1], was[1])
        np.testing.assert_array_equal(now[[0, 2, 3]], then[[0, 2, 3]])
    batch.reset(seed=1, options={"goal": "NaCl"})
    goals = batch.laboratories.state.goal[:, 0]
    assert {batch.scenario.goals[goal] for goal in goals} == {"NaCl"}
    # A batch that was never seeded draws seeds, and not the same for all.
    other = BatchedLaboratory(6, "wurtz_any")
    other.reset()
    assert len(set(other.laboratories.state.stream[:, 0].tolist())) == 6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": [1, 2]}, "3 members, given 2"),
        ({"options": {"gaol": "dodecane"}}, "reset options"),
        ({"options": {"goal": "gold"}}, "'gold'"),
        ({"options": {"reset_mask": np.ones(3)}}, "3 booleans"),
        ({"options": {"reset_mask": np.ones(2, dtype=bool)}}, "3 booleans"),
    ],
)
def test_bad_resets_change_nothing(arguments: dict[str, Any], message: str) -> None:
    batch = BatchedLaboratory(3)
    batch.reset(seed=0)
    before = batch.laboratories.snapshot()
    with pytest.raises(ValueError, match=message):
        batch.reset(**arguments)
    for was, now in zip(before, batch.laboratories.snapshot(), strict=True):
        np.testing.assert_array_equal(now, was)


def test_a_first_reset_is_of_all_and_comes_first() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        BatchedLaboratory(0)
    batch = BatchedLaboratory(2)
    with pytest.raises(ValueError, match="first reset"):
        batch.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match=r"call reset\(\)"):
        batch.step({"manager_0": np.zeros(2, dtype=np.int64)})


# -- actions --------------------------------------------------------------------------------------------------------


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


def after(batch: BatchedLaboratory, actions: dict[str, Any]) -> list[npt.NDArray[Any]]:
    """The state after a step."""
    batch.step(actions)
    return batch.laboratories.snapshot()


@pytest.mark.parametrize(
    ("agent", "rows"),
    [
        ("manager_0", np.array([-1, 0, 0])),
        ("manager_0", np.array([0.0, 0.0, 0.0])),
        ("manager_0", np.zeros(2, dtype=np.int64)),
        ("manager_0", None),
        ("manager_0", "wait"),
        ("manager_0", np.array([2**64 - 1, 0, 0], dtype=np.uint64)),
        ("ext_0", np.array([0, 3, 41])),
        ("ext_0", np.array([[0], [3], [3]])),
        ("ext_0", [[0], [3, 4], [3]]),
        ("rxn_0", np.where(np.arange(18).reshape(3, 6) == 9, np.nan, 0.5)),
        ("rxn_0", np.where(np.arange(18).reshape(3, 6) == 17, 1.0001, 0.5)),
        ("rxn_0", np.full((3, 5), 0.5)),
        ("rxn_0", np.full((3, 6), 0.5, dtype=object)),
        ("rxn_0", [[0.5] * 6, [0.5] * 6, [0.5] * 5]),
    ],
    ids=lambda value: " ".join(repr(value).split())[:30],
)
def test_one_bad_action_spoils_the_step(agent: str, rows: Any) -> None:
    batch, actions = mixed()
    before = batch.laboratories.snapshot()
    with pytest.raises(ValueError, match=f"^{agent}: actions must be"):
        batch.step({**actions, agent: rows})
    with pytest.raises(ValueError, match=f"^{agent}: has the turn"):
        batch.step({name: array for name, array in actions.items() if name != agent})
    for was, now in zip(before, batch.laboratories.snapshot(), strict=True):
        np.testing.assert_array_equal(now, was)
    for one, other in zip(after(batch, actions), after(*mixed()), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_played_without_the_turn_is_ignored() -> None:
    expected = after(*mixed())
    noise: list[dict[str, Any]] = [
        {"manager_0": np.array([0, -9, 10**12]), "ext_0": np.array([999, 3, 3])},
        {"rxn_0": np.array([[np.nan] * 6, [0.5] * 6, [0.5] * 6])},
        {"rxn_0": np.array([[1e30] * 6, [0.5] * 6, [0.5] * 6], dtype=np.float32)},
        {"dit_0": None},
        {"dit_0": "heat"},
        {"dit_0": np.full(3, -1), "nobody_0": object()},
    ]
    for wrong in noise:
        batch, actions = mixed()
        kept = {"manager_0": np.array([actions["manager_0"][0], *wrong.get("manager_0", [0, 0, 0])[1:]])}
        for one, other in zip(after(batch, {**actions, **wrong, **kept}), expected, strict=True):
            np.testing.assert_array_equal(one, other)


def test_any_layout_width_and_byte_order_will_do() -> None:
    """Slices of a plan, transposed arrays, what a network in half precision gives."""
    expected = after(*mixed())
    plan = np.full((3, 6, 5), 0.5)
    written: list[Any] = [
        plan[:, :, 2],
        np.full((6, 3), 0.5).T,
        np.broadcast_to(np.float64(0.5), (3, 6)),
        np.full((3, 6), 0.5, dtype=np.float16),
        np.full((3, 6), 0.5, dtype=">f4"),
        np.full((3, 6), 0.5, dtype=np.longdouble),
        [[0.5] * 6] * 3,
    ]
    for rows in written:
        batch, actions = mixed()
        for one, other in zip(after(batch, {**actions, "rxn_0": rows}), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    numbers = mixed()[1]["ext_0"]
    for whole in (
        np.repeat(numbers, 2)[::2],
        numbers[::-1].copy()[::-1],
        numbers.astype(">i4"),
        numbers.astype(np.uint8),
        numbers.tolist(),
    ):
        batch, actions = mixed()
        for one, other in zip(after(batch, {**actions, "ext_0": whole}), expected, strict=True):
            np.testing.assert_array_equal(one, other)


# -- soak -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["crude", "wurtz_two_lines"])
def test_a_short_soak(name: str) -> None:
    """A small version of studies/speed/soak.py, which plays ten thousand episodes of each scenario."""
    world = bool(load_scenario(name).world.draws)
    figures = soak(name, 50, 32, seed=1)
    assert figures["broken"] == []
    assert figures["episodes"] >= 50
    # Where limits are generous, random agents submit everything before they are reached, and some worlds are harmless.
    assert figures["limits_reached"] > 0 or world
    assert figures["episodes"] > figures["limits_reached"]
    assert figures["lost_manager_turns"] > (25 if world else 50)  # play was not only legal
    assert sum(figures["safety_events"].values()) > 0.0 or world


def test_a_soak_notices() -> None:
    """Each bound can be broken, by NaN too."""
    figures = soak("fictitious", 5, 4)
    assert broken(figures) == []
    for name in ("atoms_drift", "charge", "numbers_outside_0_1", "rewards_not_finite", "amounts_not_sound"):
        assert broken({**figures, name: 1.0}) == [name]
        assert broken({**figures, name: float("nan")}) == [name]
    assert broken({**figures, "memory_growth_mib": 100.0}) == ["memory_growth_mib"]
