"""Wrappers: shaping that keeps the order of returns, the goal-conditioned view, noise, the curriculum.

Shaped returns are compared with the telescoping sum, batches with single environments, achieved goals with the scores
of experiments that were really run for them.
"""

from __future__ import annotations

import copy
import pickle
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from chemlab.envs.bench_env import BenchEnv, BenchVectorEnv
from chemlab.envs.wrappers import (
    GoalConditioned,
    LinearSchedule,
    ObservationNoise,
    PotentialShaping,
    RandomStartCurriculum,
    VectorObservationNoise,
    VectorPotentialShaping,
)
from chemlab.roles.bench import channel_slices

BENCHES = ["rxn", "ext", "dit"]
MODES = ["NextStep", "SameStep", "Disabled"]
GAMMA = 0.93


def bench(key: str, **arguments: Any) -> BenchEnv:
    """A bench of the dodecane scenario."""
    return BenchEnv("wurtz_dodecane", key, **arguments)


def potential(observations: npt.NDArray[Any]) -> Any:
    """A potential without any sense, of one observation or of a batch."""
    weights = np.sin(np.arange(observations.shape[-1], dtype=np.float64))
    return np.asarray(observations, dtype=np.float64) @ weights


def plan(env: Any, shape: tuple[int, ...], seed: int = 0, ends: float = 0.03) -> npt.NDArray[Any]:
    """Random actions; of discrete ones, a share ends the experiment."""
    space = env.unwrapped.bench.action_space
    rng = np.random.default_rng(seed)
    if isinstance(space, gymnasium.spaces.Discrete):
        actions: npt.NDArray[Any] = rng.integers(space.n - 1, size=shape)
        actions[rng.random(shape) < ends] = space.n - 1
        return actions
    return rng.random((*shape, *space.shape), dtype=np.float32)  # type: ignore[misc]


def play(env: gymnasium.Env[Any, Any], actions: npt.NDArray[Any], **reset: Any) -> tuple[list[Any], list[float]]:
    """(observations, rewards) of one episode, which ends with the experiment or with the actions."""
    observations, rewards = [env.reset(**reset)[0]], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(float(reward))
        if terminated or truncated:
            break
    return observations, rewards


def discounted(rewards: list[float]) -> float:
    """The discounted return."""
    return sum(GAMMA**t * reward for t, reward in enumerate(rewards))


# -- shaping ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", BENCHES)
def test_shaping_keeps_the_order_of_returns(key: str) -> None:
    env, shaped = bench(key), PotentialShaping(bench(key), potential, GAMMA)
    plain_returns, shaped_returns = [], []
    for sequence in range(12):
        actions = plan(env, (60,), sequence)
        observations, rewards = play(env, actions, seed=4)
        _, shaped_rewards = play(shaped, actions, seed=4)
        assert len(shaped_rewards) == len(rewards)
        assert discounted(shaped_rewards) == pytest.approx(discounted(rewards) - potential(observations[0]), abs=1e-9)
        assert not np.allclose(shaped_rewards, rewards)
        plain_returns.append(discounted(rewards))
        shaped_returns.append(discounted(shaped_rewards))
    assert len(set(plain_returns)) > 1
    # The same start, so the same shift: whichever sequence is best stays best.
    np.testing.assert_allclose(np.diff(shaped_returns), np.diff(plain_returns), atol=1e-9)
    assert np.argmax(shaped_returns) == np.argmax(plain_returns)


def test_a_truncated_state_keeps_its_potential() -> None:
    """The sum telescopes to gamma^T phi(s_T) - phi(s_0), because the learner bootstraps at s_T."""
    limit = 7
    actions = plan(bench("rxn"), (limit,))
    observations, rewards = play(bench("rxn"), actions, seed=1)
    _, shaped = play(PotentialShaping(TimeLimit(bench("rxn"), limit), potential, GAMMA), actions, seed=1)
    assert len(shaped) == limit
    expected = discounted(rewards) + GAMMA**limit * potential(observations[-1]) - potential(observations[0])
    assert discounted(shaped) == pytest.approx(expected, abs=1e-9)


def test_the_unshaped_reward_is_in_the_info() -> None:
    env, shaped = bench("ext"), PotentialShaping(bench("ext"), potential, GAMMA)
    env.reset(seed=0)
    shaped.reset(seed=0)
    illegal = int(np.flatnonzero(~env.action_masks())[0])
    reward = env.step(illegal)[1]
    assert reward != 0.0
    assert shaped.step(illegal)[4]["unshaped_reward"] == reward


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("key", BENCHES)
def test_shaping_of_batches_is_shaping_of_members(key: str, mode: str) -> None:
    inner = BenchVectorEnv(4, "wurtz_dodecane", key, autoreset_mode=mode)
    env = VectorPotentialShaping(inner, potential, GAMMA)
    singles = [PotentialShaping(bench(key), potential, GAMMA) for _ in range(4)]
    actions = plan(inner, (110, 4))
    env.reset(seed=3)
    over = np.zeros(4, dtype=bool)
    for i, one in enumerate(singles):
        one.reset(seed=3 + i)
    resets = 0
    for action in actions:
        if mode == "Disabled" and over.any():
            env.reset(options={"reset_mask": over})
        _, rewards, terminated, _, infos = env.step(action)
        for i, one in enumerate(singles):
            if over[i] and mode != "SameStep":
                one.reset()
                resets += 1
            if over[i] and mode == "NextStep":
                assert rewards[i] == 0.0, "only a reset"
                assert infos["unshaped_reward"][i] == 0.0
                assert not terminated[i]
                continue
            _, reward, ended, _, info = one.step(action[i])
            assert rewards[i] == pytest.approx(reward, abs=1e-9)
            assert infos["unshaped_reward"][i] == info["unshaped_reward"]
            assert terminated[i] == ended
            if ended and mode == "SameStep":
                one.reset()
                resets += 1
        over = np.array(terminated)
    assert resets >= 8


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_truncated_members_keep_their_potential(mode: AutoresetMode) -> None:
    """A batch of Gymnasium's, whose last observations come one by one."""
    limit = 6
    made = SyncVectorEnv([lambda: TimeLimit(bench("rxn"), limit)] * 2, autoreset_mode=mode)
    env = VectorPotentialShaping(made, potential, GAMMA)
    actions = plan(bench("rxn"), (limit, 2))
    env.reset(seed=3)
    shaped: list[list[float]] = [[], []]
    for action in actions:
        _, rewards, _, truncated, _ = env.step(action)
        for i in range(2):
            shaped[i].append(float(rewards[i]))
    assert truncated.all()
    for i in range(2):
        observations, plain = play(bench("rxn"), actions[:, i], seed=3 + i)
        expected = discounted(plain) + GAMMA**limit * potential(observations[-1]) - potential(observations[0])
        assert discounted(shaped[i]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("gamma", [-0.1, 1.1, np.nan])
def test_bad_discounts(gamma: float) -> None:
    with pytest.raises(ValueError, match="gamma must be from 0 to 1, given"):
        PotentialShaping(bench("rxn"), potential, gamma)
    with pytest.raises(ValueError, match="gamma must be from 0 to 1, given"):
        VectorPotentialShaping(BenchVectorEnv(2), potential, gamma)


def test_a_potential_of_the_wrong_shape() -> None:
    env = VectorPotentialShaping(BenchVectorEnv(3), lambda observations: observations, GAMMA)
    with pytest.raises(ValueError, match="potential: must give 3 numbers"):
        env.reset(seed=0)


# -- goal-conditioned -------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings(
    "error::UserWarning", "ignore:.*Box observation space m.*infinity", "ignore:.*different from the unwrapped version"
)
@pytest.mark.parametrize("key", BENCHES)
def test_the_goal_conditioned_view_is_an_environment(key: str) -> None:
    check_env(GoalConditioned(bench(key)), skip_render_check=True)


@pytest.mark.parametrize("key", BENCHES)
def test_parts_of_the_goal_conditioned_view(key: str) -> None:
    env, view = bench(key), GoalConditioned(bench(key))
    goals = env.batch.scenario.goals
    for g, goal in enumerate(goals):
        flat, info = env.reset(seed=g, options={"goal": goal})
        seen, view_info = view.reset(seed=g, options={"goal": goal})
        assert seen in view.observation_space
        np.testing.assert_array_equal(seen["observation"], flat[: -len(goals)])
        np.testing.assert_array_equal(seen["desired_goal"], np.eye(len(goals))[g])
        np.testing.assert_array_equal(seen["achieved_goal"], np.zeros(len(goals)))
        assert view_info.keys() == info.keys()


@pytest.mark.parametrize("key", BENCHES)
def test_rewards_are_the_environment_s_and_recomputed(key: str) -> None:
    env, view = bench(key), GoalConditioned(bench(key))
    steps = []
    for g, goal in enumerate(env.batch.scenario.goals):
        actions = plan(env, (60,), g)
        env.reset(seed=g, options={"goal": goal})
        view.reset(seed=g, options={"goal": goal})
        for action in actions:
            _, reward, terminated, _, info = env.step(action)
            seen, viewed_reward, viewed_end, _, viewed_info = view.step(action)
            steps.append((seen["achieved_goal"], seen["desired_goal"], viewed_info, viewed_reward))
            assert viewed_end == terminated
            assert viewed_reward == pytest.approx(reward, rel=1e-6, abs=1e-7)  # float32
            assert viewed_reward == view.compute_reward(seen["achieved_goal"], seen["desired_goal"], viewed_info)
            if terminated:
                paid = view.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})
                assert paid == pytest.approx(info["score"], rel=1e-6, abs=1e-7)
                break
            # Hidden until the end, whatever has been made; and no score is paid before.
            assert not seen["achieved_goal"].any()
            assert view.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}) == 0.0
    achieved, desired, infos, rewards = (list(column) for column in zip(*steps, strict=True))
    assert sum(info["experiment_over"] for info in infos) == len(env.batch.scenario.goals)
    for many in (infos, np.array(infos)):
        np.testing.assert_array_equal(view.compute_reward(np.array(achieved), np.array(desired), many), rewards)
    without = [{} for _ in infos]
    scores = [info["score"] for info in infos]
    again = view.compute_reward(np.array(achieved), np.array(desired), without)
    np.testing.assert_allclose(again, scores, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "fictitious"])
def test_the_achieved_goal_is_what_other_goals_would_have_paid(scenario: str) -> None:
    """On the reaction bench the goal changes nothing but the score, so the same actions can be played for each."""
    env, view = BenchEnv(scenario, "rxn"), GoalConditioned(BenchEnv(scenario, "rxn"))
    goals = env.batch.scenario.goals
    actions = plan(env, (env.bench.spec.step_limit,))
    scores = [sum(play(env, actions, seed=0, options={"goal": goal})[1]) for goal in goals]
    assert len(set(scores)) > 2
    for goal in goals:
        observations, _ = play(view, actions, seed=0, options={"goal": goal})
        np.testing.assert_allclose(observations[-1]["achieved_goal"], scores, rtol=1e-6, atol=1e-7)


def test_measuring_other_goals_leaves_no_trace() -> None:
    env, inner = bench("dit"), bench("dit")
    view = GoalConditioned(inner)
    env.reset(seed=2)
    view.reset(seed=2)
    for action in [*plan(env, (20,), ends=0.0), env.bench.action_count - 1]:
        env.step(action)
        view.step(action)
        for one, other in zip(env.get_state(), inner.get_state(), strict=True):
            np.testing.assert_array_equal(one, other)


def test_noise_underneath_does_not_change_the_goal() -> None:
    seen, _ = GoalConditioned(ObservationNoise(bench("ext"), 0.5, ["goal", "layers_EV"])).reset(seed=0)
    assert sorted(set(seen["desired_goal"].tolist())) == [0.0, 1.0]


@pytest.mark.parametrize(
    "wrap", [GoalConditioned, lambda env: ObservationNoise(env, 0.1)], ids=["GoalConditioned", "ObservationNoise"]
)
def test_only_benches_have_goals_and_channels(wrap: Any) -> None:
    with pytest.raises(TypeError, match="BenchEnv"):
        wrap(gymnasium.make("CartPole-v1"))


def test_masks_come_through() -> None:
    for wrap in (
        GoalConditioned,
        lambda env: ObservationNoise(env, 0.1),
        lambda env: PotentialShaping(env, potential, 1.0),
    ):
        inner = bench("ext")
        env: Any = wrap(inner)
        env.reset(seed=0)
        np.testing.assert_array_equal(env.get_wrapper_attr("action_masks")(), inner.action_masks())


# -- noise ------------------------------------------------------------------------------------------------------------


def test_noise_has_its_scale_and_its_channels() -> None:
    scale, channels = 0.02, ["temperature", "layers_B1"]
    env, noisy = bench("dit"), ObservationNoise(bench("dit"), scale, channels)
    where = np.zeros(env.observation_space.shape, dtype=bool)  # type: ignore[arg-type]
    for name in channels:
        where[channel_slices(env.bench.channels)[name]] = True
    actions = plan(env, (40,), ends=0.0)
    errors = []
    clean, disturbed = play(env, actions, seed=0)[0], play(noisy, actions, seed=0)[0]
    for one, other in zip(clean, disturbed, strict=True):
        np.testing.assert_array_equal(one[~where], other[~where])
        assert other in env.observation_space
        inside = where & (one > 5 * scale) & (one < 1 - 5 * scale)  # where nothing is clipped
        errors += (other[inside] - one[inside]).tolist()
    n = len(errors)
    assert n > 300
    assert abs(np.mean(errors)) < 5 * scale / np.sqrt(n)
    assert abs(np.std(errors) - scale) < 5 * scale / np.sqrt(2 * n)


@pytest.mark.parametrize("key", BENCHES)
def test_noise_is_clipped_spares_the_goal_and_leaves_the_play_alone(key: str) -> None:
    env, noisy = bench(key), ObservationNoise(bench(key), 3.0)
    goals = len(env.bench.goals.names)
    actions = plan(env, (60,))
    clean, rewards = play(env, actions, seed=6)
    seen, noisy_rewards = play(noisy, actions, seed=6)
    assert rewards == noisy_rewards
    values = np.array(seen)
    assert (values.min(), values.max()) == (0.0, 1.0)
    np.testing.assert_array_equal(values[:, -goals:], np.array(clean)[:, -goals:])
    assert all(one in env.observation_space for one in seen)


def test_noise_is_seeded() -> None:
    actions = plan(bench("rxn"), (20,))
    noisy = ObservationNoise(bench("rxn"), 0.1)
    first, again, other = (np.array(play(noisy, actions, seed=seed)[0]) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    noisy.reset(seed=1)
    assert not np.array_equal(first, play(noisy, actions)[0]), "without a seed the noise goes on"


def test_no_noise() -> None:
    actions = plan(bench("dit"), (20,))
    for wrapped in (ObservationNoise(bench("dit"), 0.0), ObservationNoise(bench("dit"), 0.3, [])):
        np.testing.assert_array_equal(play(wrapped, actions, seed=0)[0], play(bench("dit"), actions, seed=0)[0])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("key", ["rxn", "dit"])
def test_noise_of_batches_is_noise_of_members(key: str, mode: str) -> None:
    scale = 0.2
    inner = BenchVectorEnv(3, "wurtz_dodecane", key, autoreset_mode=mode)
    env = VectorObservationNoise(inner, scale)
    singles = [ObservationNoise(bench(key), scale) for _ in range(3)]
    observations, _ = env.reset(seed=8)
    for i, one in enumerate(singles):
        np.testing.assert_array_equal(observations[i], one.reset(seed=8 + i)[0])
    over, resets = np.zeros(3, dtype=bool), 0
    for action in plan(inner, (90, 3)):
        if mode == "Disabled" and over.any():
            before = observations
            observations, _ = env.reset(options={"reset_mask": over})
            np.testing.assert_array_equal(observations[~over], before[~over])
            for i in np.flatnonzero(over):
                np.testing.assert_array_equal(observations[i], singles[i].reset()[0])
        observations, _, terminated, _, infos = env.step(action)
        for i, one in enumerate(singles):
            expected = one.reset()[0] if over[i] and mode == "NextStep" else one.step(action[i])[0]
            if terminated[i]:
                resets += 1
                if mode == "SameStep":
                    np.testing.assert_array_equal(infos["final_obs"][i], expected)
                    expected = one.reset()[0]
            np.testing.assert_array_equal(observations[i], expected)
        over = np.array(terminated)
    assert resets >= 6


def test_seeds_of_members_that_are_not_reset_change_nothing() -> None:
    env, other = (VectorObservationNoise(BenchVectorEnv(2, autoreset_mode="Disabled"), 0.2) for _ in range(2))
    action = np.full(env.action_space.shape, 0.5)  # type: ignore[arg-type]
    only = np.array([True, False])
    for one, seed in ((env, 1), (other, 2)):
        one.reset(seed=0)
        one.reset(seed=seed, options={"reset_mask": only})
    first, second = env.step(action)[0], other.step(action)[0]
    np.testing.assert_array_equal(first[1], second[1])
    assert not np.array_equal(first[0], second[0])


def test_bad_noise() -> None:
    for scale in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="scale must be a finite number of at least 0, given"):
            ObservationNoise(bench("rxn"), scale)
    with pytest.raises(ValueError, match=r"bench 'rxn' has spectrum, .*given 'smell'"):
        ObservationNoise(bench("rxn"), 0.1, ["spectrum", "smell"])
    with pytest.raises(ValueError, match="given 'smell'"):
        VectorObservationNoise(BenchVectorEnv(2), 0.1, ["smell"])
    with pytest.raises(TypeError, match="BenchVectorEnv"):
        VectorObservationNoise(SyncVectorEnv([lambda: bench("rxn")]), 0.1)


# -- curriculum -------------------------------------------------------------------------------------------------------


class Witness(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Counts steps and lost turns of every episode."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.steps, self.illegal, self.goals = 0, 0, []

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        self.steps = 0
        observation, info = self.env.reset(**arguments)
        self.goals.append(int(self.env.unwrapped.batch.experiments.goal[0]))  # type: ignore[attr-defined]
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.illegal += info["illegal_action"]
        return observation, float(reward), terminated, truncated, info


def always(ended: int) -> float:
    """A schedule without growth."""
    return 1.0


def test_random_starts_are_uniform() -> None:
    env = RandomStartCurriculum(bench("rxn"), 4, always)  # shorter than an experiment, so none is thrown away
    n = 400
    counts = Counter(env.reset(seed=0 if i == 0 else None)[1]["random_steps"] for i in range(n))
    assert set(counts) == {0, 1, 2, 3, 4}
    spread = np.sqrt(n * 0.2 * 0.8)
    assert all(abs(count - n / 5) < 5 * spread for count in counts.values())


@pytest.mark.parametrize("key", BENCHES)
def test_what_is_handed_over_is_running_and_was_reached_legally(key: str) -> None:
    witness = Witness(bench(key))
    limit = witness.env.unwrapped.bench.spec.step_limit  # type: ignore[attr-defined]
    env = RandomStartCurriculum(witness, 3 * limit, always)
    hold = np.full(env.action_space.shape, 0.5) if key == "rxn" else 0
    played = []
    for seed in range(25):
        observation, info = env.reset(seed=seed)
        assert observation in env.observation_space
        assert info["random_steps"] == witness.steps < limit
        experiments = witness.env.unwrapped.batch.experiments  # type: ignore[attr-defined]
        assert experiments.busy[0]
        assert experiments.steps[0] == witness.steps
        if "action_mask" in info:
            np.testing.assert_array_equal(info["action_mask"], env.get_wrapper_attr("action_masks")())
        played.append(witness.steps)
        illegal = witness.illegal
        assert illegal == 0
        env.step(hold)  # does not raise: it was not over
        witness.illegal = 0
    assert max(played) > 3


def test_the_curriculum_grows_as_episodes_end() -> None:
    env = RandomStartCurriculum(bench("dit"), 10, LinearSchedule(5))
    end = env.unwrapped.bench.action_count - 1  # type: ignore[attr-defined]
    largest = []
    for ended in range(8):
        assert env.episodes_ended == ended
        largest.append(max(env.reset(seed=seed)[1]["random_steps"] for seed in range(60)))
        assert not env.step(0)[2]
        assert env.episodes_ended == ended
        assert env.step(end)[2]
    bounds = [0, 2, 4, 6, 8, 10, 10, 10]
    assert largest[0] == 0
    assert all(reached <= bound for reached, bound in zip(largest, bounds, strict=True))
    assert largest[-1] > largest[1] > 0


def test_linear_schedule() -> None:
    schedule = LinearSchedule(200)
    assert [schedule(n) for n in (0, 50, 200, 1000)] == [0.0, 0.25, 1.0, 1.0]
    assert LinearSchedule(0)(0) == 1.0


def test_random_starts_are_seeded_and_keep_the_goal() -> None:
    witness = Witness(bench("ext"))
    env = RandomStartCurriculum(witness, 30, always)
    seeds = range(12)
    first = [env.reset(seed=seed)[0] for seed in seeds]
    for seed in seeds:
        np.testing.assert_array_equal(env.reset(seed=seed)[0], first[seed])
    tries = []
    for seed in seeds:
        witness.goals = []
        env.reset(seed=seed)
        tries.append(witness.goals)
    assert any(len(set(goals)) > 1 for goals in tries), "what was thrown away is not begun once more"
    witness.goals = []
    for seed in seeds:  # also where the first tries came to an end
        env.reset(seed=seed, options={"goal": "NaCl"})
    assert len(witness.goals) > len(seeds)
    assert set(witness.goals) == {env.unwrapped.bench.goals.names.index("NaCl")}  # type: ignore[attr-defined]


def test_no_random_steps_is_the_plain_environment() -> None:
    env = RandomStartCurriculum(bench("ext"), 0)
    np.testing.assert_array_equal(env.reset(seed=3)[0], bench("ext").reset(seed=3)[0])


def test_bad_curricula() -> None:
    with pytest.raises(ValueError, match="steps must be at least 0, given -1"):
        RandomStartCurriculum(bench("rxn"), -1)
    with pytest.raises(ValueError, match=r"schedule\(0\) must be from 0 to 1, given 1.5"):
        RandomStartCurriculum(bench("rxn"), 3, lambda ended: 1.5).reset(seed=0)
    other = gymnasium.Env[Any, Any]()
    other.action_space = gymnasium.spaces.MultiBinary(3)
    with pytest.raises(TypeError, match="Box or Discrete"):
        RandomStartCurriculum(other, 3)


# -- copies -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
@pytest.mark.parametrize("key", BENCHES)
def test_wrapped_copies_go_on_alike(key: str, how: Any) -> None:
    stack = PotentialShaping(ObservationNoise(RandomStartCurriculum(bench(key), 5, always), 0.1), potential, GAMMA)
    env = GoalConditioned(bench(key))
    for one in (stack, env):
        actions = plan(one, (15,), ends=0.0)
        play(one, actions[:5], seed=1)
        twin = how(one)
        for action in actions[5:]:
            first, second = one.step(action), twin.step(action)
            assert first[1] == second[1]
            for key_or_none in first[0] if isinstance(first[0], dict) else [...]:
                np.testing.assert_array_equal(first[0][key_or_none], second[0][key_or_none])
