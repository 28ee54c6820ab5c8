"""Single benches as Gymnasium environments: registered ids and their documentation, alone and in batches."""

import gc
import os
import re
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from helpers import assert_is_singles, random_actions, random_legal, refused

from chemlab.config.loading import load_scenario
from chemlab.envs import role_env
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.roles import reaction_bench, separation_benches

WURTZ = "wurtz_dodecane"
BENCHES = {name for name, spec in gymnasium.registry.items() if {"bench", "scenario"} <= set(spec.kwargs or {})}
IDS = sorted((name for name in BENCHES if name.startswith("chemlab/")), reverse=True)
"""The last first: the quick tests take one, and the first has the slowest bench."""
KINDS = ["chemlab/FictitiousReaction-v0", "chemlab/WurtzExtraction-v0", "chemlab/WurtzDistillation-v0"]
"""One of each kind of bench, for what the environment does around it."""
STEPS = 120
"""More than two experiments of any bench."""


def single(name: str, **arguments: Any) -> RoleEnv:
    """The bare single environment of an id."""
    return RoleEnv(**{**gymnasium.spec(name).kwargs, **arguments})


def batch(name: str, num_envs: int, **arguments: Any) -> RoleVectorEnv:
    """The bare batch of an id."""
    return RoleVectorEnv(num_envs, **{**gymnasium.spec(name).kwargs, **arguments})


def assert_same_arrays(first: Any, second: Any) -> None:
    """Two get_state() results are equal bit for bit."""
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


ROW = re.compile(r"^\| `(chemlab/[\w-]+)` \| (\w+) of `(\w+)` \| Box\((\d+)\) \| (Box|Discrete)\((\d+)\) \|", re.M)
ROWS = {row[0]: row[1:] for row in ROW.findall(role_env.__doc__ or "")}
"""The table of the module's documentation."""


def test_every_bench_kind_is_registered() -> None:
    assert set(ROWS) == set(IDS)
    assert {gymnasium.spec(name).kwargs["bench"] for name in IDS} == {"rxn", "ext", "dit", "cry"}
    for name in [*IDS, "chemlab/Bench-v1"]:
        spec = gymnasium.spec(name)
        assert isinstance(spec.entry_point, str), "entry points are strings, so that importing chemlab stays light"
        assert isinstance(spec.vector_entry_point, str)


@pytest.mark.parametrize("name", IDS)
def test_spaces_are_the_laboratory_s(name: str) -> None:
    arguments = gymnasium.spec(name).kwargs
    laboratories = Laboratories(arguments["scenario"])
    agent = laboratories.agents.index(f"{arguments['bench']}_0")
    env, vector = gymnasium.make(name), batch(name, 3)
    assert env.observation_space == laboratories.observation_space(agent)
    assert env.action_space == laboratories.action_space(agent)
    assert vector.single_observation_space == env.observation_space
    assert vector.single_action_space == env.action_space
    assert vector.observation_space == gymnasium.vector.utils.batch_space(env.observation_space, 3)
    assert vector.action_space == gymnasium.vector.utils.batch_space(env.action_space, 3)
    assert env.unwrapped.action_meanings == laboratories.benches[agent - 1].action_meanings  # type: ignore[attr-defined]
    bench, scenario, observations, kind, actions = ROWS[name]
    assert (bench, scenario) == (arguments["bench"], arguments["scenario"])
    assert env.observation_space.shape == (int(observations),)
    assert repr(env.action_space).startswith(f"{kind}({actions}" if kind == "Discrete" else "Box(0.0, 1.0, (" + actions)


def test_bench_modules_tell_the_parts() -> None:
    """The parts that the benches' own tables name are the declared channels, in order and size."""
    names = {key: [c.name for c in ExperimentBatch(WURTZ, key).bench.channels] for key in ("rxn", "ext", "dit")}
    assert names["rxn"] == ["spectrum", "temperature", "volume", "pressure", "reagents", "goal"]
    assert names["ext"] == ["layers_EV", "layers_B1", "layers_B2", "goal"]
    assert names["dit"] == ["layers_DV", "layers_B1", "layers_B2", "temperature", "volume", "pressure", "goal"]
    assert "spectrum 200, temperature, volume, pressure, n reagents left, goal" in (reaction_bench.__doc__ or "")
    for told in ("41): 8 processes x 5 magnitudes", "35): 11 processes", "31): 3 processes x 10 magnitudes"):
        assert f"Discrete({told}, end" in (separation_benches.__doc__ or "")


def test_a_seed_is_an_experiment_and_a_first_reset_without_one_draws_it() -> None:
    """By the first observations of 20 experiments, whose goals are drawn: no chance of equal ones."""
    name = "chemlab/WurtzExtraction-v0"
    env = single(name)

    def beginnings(seed: int | None, env: RoleEnv = env) -> bytes:
        return b"".join(env.reset(seed=seed if i == 0 else None)[0].tobytes() for i in range(20))

    assert len({beginnings(seed) for seed in range(8)}) == 8
    again = beginnings(0)
    assert beginnings(None) != again, "without a seed the streams go on"
    assert beginnings(0) == again
    assert len({beginnings(None, single(name)) for _ in range(4)}) == 4
    for first in (None, [0, None, None, None]):
        vector, other = batch(name, 4), batch(name, 4)
        rows = [np.hstack([env.reset(seed=seed)[0] for env in (vector, other)]) for seed in [first, *[None] * 19]]
        half = rows[0].shape[1] // 2
        seen = {b"".join(row[i, at].tobytes() for row in rows) for i in range(4) for at in (np.s_[:half], np.s_[half:])}
        assert len(seen) == (8 if first is None else 7), "members without a seed get one each"


def test_a_state_of_another_environment_changes_nothing() -> None:
    """Another bench's, more, fewer or shorter arrays, other types; of batches and laboratories, too."""
    reaction, distillation = "chemlab/WurtzReaction-v0", "chemlab/WurtzDistillation-v0"
    env, more, labs = single(reaction), batch(reaction, 4), Laboratories("wurtz_dodecane")
    env.reset(seed=1)
    more.reset(seed=1)
    labs.reset(labs.members)
    ways: list[tuple[Any, Any]] = [(env.get_state, env.set_state), (more.get_state, more.set_state)]
    for take, put in [*ways, (labs.snapshot, labs.restore)]:
        state = take()
        wrong = [single(distillation).get_state(), batch(reaction, 3).get_state(), [], state[:-1], [*state, state[0]]]
        wrong += [[*state[:-1], state[-1][:0]], [state[0].astype(np.float32), *state[1:]], [*state[:-1], "a"]]
        for other in wrong:
            refused("state: does not fit this environment", put, other)
            assert_same_arrays(take(), state)
        put(state)
    more.close()


@pytest.mark.parametrize("name", IDS)
def test_members_are_single_environments(name: str) -> None:
    """Whatever the numbers of members and threads are, and however they are begun again."""
    actions = random_actions(single(name).action_space, STEPS, 7)
    for mode, count, threads in (("NextStep", 7, 2), ("NextStep", 3, 1), ("Disabled", 1, 1), ("SameStep", 3, 2)):
        env = batch(name, count, threads=threads, autoreset_mode=mode)
        ends = assert_is_singles(env, [single(name) for _ in range(count)], STEPS, lambda t, i: actions[t, i], 40)
        assert ends >= count
        env.close()


def test_a_lost_last_turn_is_reported_when_reset_at_once() -> None:
    """The step that ends may itself be illegal: at the step limit."""
    env = batch("chemlab/WurtzExtraction-v0", 1, autoreset_mode="SameStep")
    _, infos = env.reset(seed=0)
    illegal = int(np.flatnonzero(infos["action_mask"][0] == 0)[0])
    for step in range(1, env.bench.spec.step_limit + 1):
        _, rewards, terminated, _, infos = env.step(np.array([illegal]))
        assert infos["illegal_action"][0], f"step {step}"
        assert terminated[0] == (step == env.bench.spec.step_limit)
    assert rewards[0] == pytest.approx(infos["score"][0] - env.batch.scenario.costs.illegal_action)


def test_seeds_of_members() -> None:
    """One for each; None is the next episode of its series, and a member that is not reset needs none."""
    name = "chemlab/WurtzExtraction-v0"
    env, goes_on = batch(name, 4, autoreset_mode="Disabled"), single(name)
    first, _ = env.reset(seed=0)
    env.episodes.scores[:] = 0.5  # as if every experiment had just ended
    mask = np.array([True, True, True, False])
    observations, infos = env.reset(seed=[9, None, 2, 6], options={"reset_mask": mask})
    assert not infos["experiment_over"].any(), "a reset ends no experiment, nor one that is not reset"
    goes_on.reset(seed=1)
    expected = [single(name).reset(seed=9)[0], goes_on.reset()[0], single(name).reset(seed=2)[0], first[3]]
    np.testing.assert_array_equal(observations, expected)


FORK = """
import os, sys
import numpy as np
from chemlab.envs.role_env import RoleVectorEnv
env, alone = RoleVectorEnv(4, bench="rxn", threads=2), RoleVectorEnv(4, bench="rxn")
actions = np.random.default_rng(0).random((6, 4, 6))
for one in (env, alone):
    one.reset(seed=0)
    for action in actions[:3]:
        one.step(action)
child = os.fork()
for action in actions[3:]:
    np.testing.assert_array_equal(env.step(action)[0], alone.step(action)[0])
env.close()
if not child:
    sys.stdout.flush()
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_child_has_threads_of_its_own() -> None:
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORK], check=True, timeout=300)


def test_refused_arguments_are_one_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gymnasium closes every environment in the end, also those that have never been made."""
    noise: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", noise.append)
    for arguments in ({"num_envs": 2, "threads": 0}, {"num_envs": 2, "goals": "gold"}, {"num_envs": 0}):
        with pytest.raises(ValueError, match=r"threads|goals|num_envs"):
            RoleVectorEnv(**arguments)  # type: ignore[arg-type]
    gc.collect()
    assert noise == []
    for name, mode in (("chemlab/WurtzReaction-v0", "ansi"), ("chemlab/LabManager-v1", "hologram")):
        refused(f"render_mode: must be None.*{mode}", gymnasium.make_vec, name, num_envs=2, render_mode=mode)


@pytest.mark.parametrize("name", KINDS)
def test_returned_arrays_are_copies_unless_asked_otherwise(name: str) -> None:
    actions = random_actions(single(name).action_space, 5, 2)
    keeps, reuses = batch(name, 2), batch(name, 2, copy=False)
    kept, kept_infos = keeps.reset(seed=0)
    reused, _ = reuses.reset(seed=0)
    first, first_mask = kept.copy(), kept_infos.get("action_mask", np.zeros(0)).copy()
    for action in actions:
        observations, *_ = keeps.step(action)
        overwritten, *_ = reuses.step(action)
        np.testing.assert_array_equal(observations, overwritten)
    np.testing.assert_array_equal(kept, first)
    np.testing.assert_array_equal(kept_infos.get("action_mask", np.zeros(0)), first_mask)
    np.testing.assert_array_equal(reused, overwritten)
    assert not np.array_equal(first, overwritten)


@pytest.mark.parametrize("name", KINDS)
def test_goals_can_be_chosen(name: str) -> None:
    """Those of all episodes, or the one of the next."""
    names = load_scenario(gymnasium.spec(name).kwargs["scenario"]).goals
    for goals in (names[0], list(names[:2]), None):
        wanted = {goals} if isinstance(goals, str) else set(goals or names)
        env = batch(name, 256, goals=goals)
        observations, _ = env.reset(seed=0)
        hot = observations[:, -len(names) :]
        np.testing.assert_array_equal(hot.sum(axis=1), 1.0)
        assert {names[g] for g in hot.argmax(axis=1)} == wanted  # 256 draws miss one of 7 with probability 1e-16
    for env in (single(name), batch(name, 3)):
        for g, goal in enumerate(names):
            for row in np.atleast_2d(env.reset(seed=0, options={"goal": goal})[0]):
                np.testing.assert_array_equal(row[-len(names) :], np.eye(len(names))[g])


@pytest.mark.parametrize("name", IDS)
def test_an_episode_pays_its_score_and_ends(name: str) -> None:
    """The return is the bench's measure at the end minus at the start, less lost turns and priced events."""
    env = single(name)
    batch, rng = env.batch, np.random.default_rng(3)
    price = batch.scenario.safety.reward_price
    for seed in range(4):
        _, info = env.reset(seed=seed)
        start = float(batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0])
        total, cost, over, steps = 0.0, 0.0, False, 0
        while not over:
            _, reward, over, _, info = env.step(random_legal(env.action_space, info.get("action_mask"), rng))
            assert info["experiment_over"] == over
            assert over or info["score"] == 0.0
            total, cost, steps = total + reward, cost + info["cost"], steps + 1
            assert (info["cost"] > 0.0) <= bool(info["events"].any())
        end = float(batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0])
        assert info["score"] == pytest.approx(end - start, abs=1e-12)
        assert total == pytest.approx(end - start - price * cost, abs=1e-12)
        assert steps <= env.bench.spec.step_limit
        if not env.bench.action_count:
            assert steps == env.bench.spec.step_limit


@pytest.mark.parametrize("name", KINDS)
def test_a_step_after_the_end_is_refused(name: str) -> None:
    env = single(name)
    action = random_actions(env.action_space, 1, 1)[0, 0]
    env.reset(seed=0)
    while not env.step(action)[2]:
        pass
    before = env.get_state()
    with pytest.raises(ResetNeeded):
        env.step(action)
    assert_same_arrays(env.get_state(), before)
    env.reset()
    env.step(action)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "no_such"}, "no_such"),
        ({"bench": "lathe"}, r"rxn.*given 'lathe'"),
        ({"goals": "gold"}, r"goals: .*given 'gold'"),
        ({"goals": []}, r"goals"),
        ({"goal": "E"}, r"unexpected keyword argument 'goal'; choose from .* goals, "),
        ({"render_mode": "holography"}, r"render_mode.*given 'holography'"),
        ({"starts": "moon"}, r"'paper', 'lab' or 'both', given 'moon'"),
    ],
)
def test_unknown_arguments(arguments: dict[str, Any], message: str) -> None:
    for make in (RoleEnv, RoleVectorEnv):
        with pytest.raises((ValueError, TypeError), match=message):
            make(**{"bench": "rxn", **arguments})


def test_rendering_shows_no_contents() -> None:
    env = single("chemlab/WurtzExtraction-v0", render_mode="ansi")
    env.reset(seed=0, options={"goal": "dodecane"})
    text = env.render()
    assert text is not None
    assert all(position in text for position in env.bench.positions)
    hidden = set(env.batch.scenario.materials) - {"dodecane"}  # the goal is known
    body = text.split("\n", 1)[1]
    assert not any(material in body for material in hidden)
    env = RoleEnv("crude", bench="ext", render_mode="ansi")  # it hides temperatures, and shows volumes in quarters
    env.reset(seed=0)
    assert env.render().split("\n")[1:] == ["  EV     0.30/1.20 L", "  B1     0.00/1.20 L", "  B2     0.00/1.20 L"]
