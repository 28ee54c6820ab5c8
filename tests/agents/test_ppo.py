"""PPO of teams: advantages against a direct sum, help that ends, resuming, export, and that it learns from nothing."""

from collections.abc import Mapping
from pathlib import Path
from threading import get_ident
from typing import Any

import numpy as np
import pytest
from helpers import refused

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
import torch

from chemlab.agents.episodes import play_episode, play_laboratory
from chemlab.agents.evaluate.jobs import without_instruments
from chemlab.agents.evaluate.play import find_target, notes
from chemlab.agents.notes import notes_size
from chemlab.agents.policies import make_policies
from chemlab.agents.pretrained import load_pretrained
from chemlab.agents.runs import RESULT_SEED, Run
from chemlab.agents.train.arguments import IPPO, MAPPO
from chemlab.agents.train.export import export_run
from chemlab.agents.train.learn import train
from chemlab.agents.train.ppo import PPOTeam, _drawn, _Learner, _Shown, _Track
from chemlab.agents.train.tied import TiedLinear, Unit, action_units, notes_units, observed_units
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import AMOUNTS
from chemlab.record import Recorder, read_record, verify_record
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import DISCARD, MEASURE, START, SUBMIT
from chemlab.roles.manager_state import LEAST_AMOUNT, PRICE

QUICK = {"envs": 8, "rollout": 16, "batch_size": 64, "evaluations": 2, "eval_episodes": 4, "final_episodes": 4}

NO_HELP = dict.fromkeys(("refund", "processed", "own_goals", "shown_readings", "partial", "free_readings"), 0.0)


def direct(rewards: list[float], values: list[float], last: float, gamma: float, lam: float) -> list[float]:
    """Generalized advantage estimates of consecutive turns by their definition."""
    following = [*values[1:], last]
    deltas = [r + gamma * v - own for r, v, own in zip(rewards, following, values, strict=True)]
    return [sum((gamma * lam) ** k * d for k, d in enumerate(deltas[t:])) for t in range(len(deltas))]


def test_advantages_follow_their_definition() -> None:
    """One laboratory: turns at rounds 1, 3 and 4, an end at 4, another turn at 6, whose next is there at the end."""
    track = _Track(6, 1, 2, 2, (), 3)
    track.acted[[1, 3, 4, 6], 0] = True
    track.ended[4, 0] = True
    track.value[[1, 3, 4, 6], 0] = values = [0.5, -0.2, 0.1, 0.7]
    track.reward[:, 0] = rewards = [0.0, 0.1, 0.2, 0.3, 0.4, 0.0, 0.6]
    found = track.finished(np.array([0.9], dtype=np.float32), np.array([True]), 0.9, 0.8)
    first = direct([rewards[1] + rewards[2], rewards[3], rewards[4]], values[:3], 0.0, 0.9, 0.8)
    second = direct([rewards[6]], values[3:], 0.9, 0.9, 0.8)
    assert found["advantage"] == pytest.approx([*first, *second], rel=1e-5)
    assert found["target"] == pytest.approx(np.array([*first, *second]) + values, rel=1e-5)


def test_a_discount_of_ticks_is_of_the_ticks_between_turns() -> None:
    track = _Track(2, 1, 1, 1, (), 0)
    track.acted[[1, 2], 0] = True
    track.tick[[1, 2], 0] = [3, 8]
    track.value[[1, 2], 0] = [0.5, 0.25]
    track.reward[[1, 2], 0] = [1.0, 2.0]
    last, turn = np.array([0.75], dtype=np.float32), np.array([True])
    shown = _Shown({"manager_0": track}, {"manager": 0.9}, by_ticks=True)
    shown._rounds["manager_0"] = [(track.acted, np.array([[False], [False], [True]]), track.reward, track.tick)]
    assert shown._returns("manager_0")[1] == pytest.approx([1.0 + 0.9**5 * 2.0, 2.0])
    found = track.finished(last, turn, 0.9, 0.8, np.array([10]))
    second = 2.0 + 0.9**2 * 0.75 - 0.25
    first = 1.0 + 0.9**5 * 0.25 - 0.5 + 0.9**5 * 0.8 * second
    assert found["advantage"] == pytest.approx([first, second], rel=1e-5)


def test_a_turn_without_its_next_waits_for_it() -> None:
    """Its reward goes on over the rollouts, and it is learned from once."""
    track = _Track(2, 1, 1, 1, (), 0)
    track.acted[1, 0], track.value[1, 0], track.observed[1, 0] = True, 0.3, 7.0
    track.reward[:, 0] = [0.0, 0.1, 0.2]
    nothing, no_turn = np.zeros(1, dtype=np.float32), np.zeros(1, dtype=np.bool_)
    assert len(track.finished(nothing, no_turn, 1.0, 0.95)["advantage"]) == 0  # type: ignore[arg-type]
    track.reward[1:, 0] = [0.4, 0.8]
    track.ended[2, 0] = True
    found = track.finished(nothing, no_turn, 1.0, 0.95)
    assert found["advantage"] == pytest.approx([0.1 + 0.2 + 0.4 + 0.8 - 0.3], rel=1e-5)
    assert found["observed"] == pytest.approx(np.array([[7.0]]))
    assert len(track.finished(nothing, no_turn, 1.0, 0.95)["advantage"]) == 0  # type: ignore[arg-type]


def test_actions_are_drawn_by_their_probabilities() -> None:
    """Actions of probability 0 never are, at either end of a row, too."""
    torch.manual_seed(3)
    rows = torch.tensor([[0.0, 0.3, 0.0, 0.7, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]]).repeat(5000, 1)
    drawn = _drawn(rows)
    assert (drawn.shape, drawn[1::2].unique().tolist()) == ((10_000, 1), [4])
    assert drawn[::2].unique().tolist() == [1, 3]
    assert float((drawn[::2] == 3).float().mean()) == pytest.approx(0.7, abs=0.03)


def managers(scenario: str | Scenario = "wurtz_dodecane", **given: Any) -> PPOTeam:
    """A manager that learns in a scenario."""
    arguments = IPPO(roles=("manager",), **{**QUICK, **given})
    return PPOTeam(load_scenario(scenario), ["manager"], arguments, "scripted", False)


def through(weights: Mapping[str, Any], x: Any) -> Any:
    """What exported layers make of observations."""
    for layer in range(3):
        x = x @ weights[f"{layer}.weight"].T + weights[f"{layer}.bias"]
        x = np.tanh(x) if layer < 2 else x
    return x


def test_help_is_of_the_mask_and_ends() -> None:
    """Raw vessels are not submitted, nothing is discarded, and every second laboratory starts for its order alone."""
    made = managers(processed=0.5, own_goals=0.8)
    table, rows, goals = made.labs.actions.table, made.labs.members, made.labs.state.goal[:, 0]
    mask = made._infos["manager_0"]["action_mask"].astype(np.bool_)
    helped, kinds = made._helped(mask, rows, 0.0), table[:, 0]
    starts, submits = np.flatnonzero(kinds == START), kinds == SUBMIT
    assert mask[:, submits].any()
    assert not helped[:, submits | (kinds == DISCARD)].any()
    assert helped[:, starts].any()
    alone = [bool((table[starts[row], 3] == goal).all()) for row, goal in zip(helped[:, starts], goals, strict=True)]
    assert alone == [number % 2 == 0 for number in range(len(rows))], "goals of no order may be on the way to it"
    fading = made._helped(mask, rows, 0.25)[:, submits]
    assert not fading[len(rows) // 2 :].any()
    assert (fading[: len(rows) // 2] == mask[: len(rows) // 2, submits]).all()
    later = made._helped(mask, rows, 0.5)
    assert (later[:, submits] == mask[:, submits]).all()
    assert not (later[:, starts] == mask[:, starts]).all()
    assert (made._helped(mask, rows, 0.8) == mask).all(), "a policy is tried with all actions before training ends"


def test_a_refund_makes_the_sum_of_rewards_not_negative() -> None:
    """It comes with each cost, and is taken back as far as the score rises again."""
    made = managers(refund=1.0, rollout=400, envs=4, self_imitation=0.0)
    made.collect(1.0)
    track = made._tracks["manager_0"]
    ends = np.flatnonzero(track.ended[:, 0])
    scores = made.scores
    assert len(ends)
    sums = [float(part.sum()) for part in np.split(track.reward[:, 0], ends + 1)[: len(ends)]]
    assert min(scores) < -0.01, "random managers lose"
    assert min(sums) >= -1e-6
    assert max(sums) <= max(*scores, 0.0) + 1e-6


def test_own_turns_that_went_better_than_expected_are_learned_again() -> None:
    """Returns are sums of rewards to the end of each turn's episode; turns of open episodes wait."""
    made = managers(self_imitation=1.0, batch_size=8)
    learner, best = made.learners["manager"], made._best
    rows, track, reward, over = np.array([2, 5]), made._tracks["manager_0"], np.zeros(8), np.zeros(8, dtype=np.bool_)
    observed = np.random.default_rng(0).random((2, len(learner.columns)), dtype=np.float32)
    track.observed[1, rows], track.mask[1, rows] = observed, True
    for action, (first, second) in enumerate([(0.25, 0.5), (0.5, 0.0)]):
        track.action[1, rows] = action
        best.add(track, 1, rows)
        reward[rows] = first, second
        over[5] = action == 1
        best.rewarded(reward, over)
    assert best._ended[:4].tolist() == [False, True, False, True]
    assert best._following[[1, 3]] == pytest.approx([0.5, 0.0])

    def probability() -> float:
        """Of the better action."""
        with torch.no_grad():
            return float(learner.network.judge(torch.from_numpy(observed[1:]), None, torch.tensor([0]))[0].exp())

    before = probability()
    for _ in range(20):
        best.learn(learner, np.random.default_rng(1))
    assert probability() > 2.0 * before
    best._following[:] = -9.0  # none is better than expected
    before = probability()
    best.learn(learner, np.random.default_rng(1))
    assert probability() == before


def test_instruments_read_ever_fewer_vessels_unasked() -> None:
    """What they read is observed, costs nothing, and cannot be measured again at first."""
    made = managers("rush", shown_readings=0.5, refund=0.0, free_readings=0.0, rollout=1)
    labs, age = made.labs, made.labs.state.age
    column = channel_slices(labs.roles[0].channels)["slot_0_gas_chromatograph_age"]
    assert (age == 0).all()
    assert not made._observed["manager_0"][:, column].any()
    measures = labs.actions.table[:, 0] == MEASURE
    everywhere = np.ones((made.settings.envs, len(measures)), dtype=np.bool_)
    rows = np.arange(made.settings.envs)
    assert not made._helped(everywhere, rows, 0.0)[:, measures].any()
    assert made._helped(everywhere, rows, 0.5)[:, measures].all()
    begun = np.ones(made.settings.envs, dtype=np.bool_)
    for done, least, most in ((0.25, 0.3, 0.7), (0.5, 0.0, 0.0)):
        age[:] = -1
        made._read(done, begun)
        assert least <= (age == 0).mean() <= most
        before = age.copy()
        made._read(done, ~begun)  # what was passed over once is not read later
        assert (age == before).all()
    assert not labs.state.charges.any()
    assert (managers("wurtz_dodecane").labs.state.age == -1).all(), "where nothing is hidden, nothing is read"
    arguments = IPPO(scenario="rush", roles=("manager",), **QUICK)
    blind = PPOTeam(without_instruments(load_scenario("rush")), ["manager"], arguments, "scripted")
    assert (blind.labs.state.age == -1).all()


def test_a_bench_begins_with_the_action_that_changes_nothing() -> None:
    """Reagents that do not matter to its own score are not poured later either, since their numbers begin below 0."""
    benches = PPOTeam(load_scenario("failing"), ["east"], IPPO(scenario="failing", **QUICK), "scripted")
    learner = benches.learners["east"]
    action, _ = learner.act(np.random.default_rng(0).random((20, len(learner.columns)), dtype=np.float32), None, True)
    assert action[:, :2] == pytest.approx(np.full((20, 2), 0.5), abs=0.1)
    assert (action[:, 2:] < -0.1).all()


def test_a_rollout_is_as_long_as_half_of_the_manager_s_actions() -> None:
    names = {"wurtz_dodecane": 32, "runaway": 40, "rush": 100, "campaign": 128}
    found = {name: PPOTeam(load_scenario(name), ["manager"], IPPO(envs=2), "scripted").rounds for name in names}
    assert found == names
    assert managers().rounds == QUICK["rollout"]


def test_failing_submissions_are_paid_in_part() -> None:
    """Half of the worth, by the share of amount and purity; never in a score."""
    labs = managers("failing").labs
    members, state = labs.members, labs.state
    least = labs.scenario.specifications["2-chlorohexane"].purity_at_least
    state.submitted[:, :, 0], state.submitted[:, :, 1] = 2.0, 0.9 * least
    whole = 2.0 * 0.9 * least / labs.rules.arrays.maximum[state.goal[0, 0]]
    assert labs.partial_worth(members) == pytest.approx(0.5 * 0.9**4 * whole)
    assert not labs.worth(members).any()
    state.submitted[:, :, 1] = least
    assert not labs.partial_worth(members).any()
    assert labs.worth(members).all()
    orders = managers("rush").labs
    terms = orders.state.terms
    orders.state.submitted[:, :, 0], orders.state.submitted[:, :, 1] = 0.5 * terms[..., LEAST_AMOUNT], 1.0
    assert orders.partial_worth(orders.members) == pytest.approx(0.25 * terms[..., PRICE].mean(axis=1))


@pytest.mark.usefixtures("hasty")
def test_observations_of_the_manager_are_normalized() -> None:
    """The exported weights are of the observation as it is; a policy that was cloned keeps its scale."""
    made = managers("rush")
    learner = made.learners["manager"]
    for rounds in range(3):
        made.learn(0.1 * rounds, rounds)
    assert (learner.network.scale > 1.5).any()
    weights, seen = made.weights("manager"), made._noted("manager_0", np.arange(made.settings.envs))
    whole = np.zeros((len(seen), learner.size), dtype=np.float32)
    whole[:, learner.columns] = seen
    whole = through(weights, whole)
    learner.network.eval()
    with torch.no_grad():
        assert whole == pytest.approx(learner.network.logits(torch.from_numpy(seen), None).numpy(), abs=1e-4)
    same = learner.network.scale.clone()
    batch = {"observed": seen, "seen": seen, "mask": None, "action": np.zeros(len(seen), np.int64)}
    learner.clone({**batch, "target": np.zeros(len(seen), np.float32)}, made.rng, 0.1)
    learner.normalize(seen)
    assert torch.equal(learner.network.scale, same)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_measurements_are_refunded_ever_less(share: float) -> None:
    """By what the manager pays: its share of the result."""
    scenario = load_scenario("rush")
    mix = scenario.rewards.model_copy(update={"manager_local": share})
    price = share * scenario.instruments["gas_chromatograph"].price
    for remaining, kept in ((1.0, 0.0), (0.75, 0.5), (0.5, 1.0)):
        given = {"free_readings": 0.5, "refund": 0.0, "shown_readings": 0.0, "rollout": 1}
        made = managers(scenario.model_copy(update={"rewards": mix}), **given)
        mask = made._infos["manager_0"]["action_mask"]
        mask[:] = 0
        mask[:, np.flatnonzero(made.labs.actions.table[:, 0] == MEASURE)[0]] = 1
        made.collect(remaining)
        assert made._tracks["manager_0"].reward[1] == pytest.approx(-kept * price, abs=1e-6)


@pytest.mark.parametrize("scenario", ["failing", "crude", "rush"])
def test_credit_comes_at_once_and_adds_up_to_the_score(scenario: str) -> None:
    """Without help, the rewards of an episode are its score, less what its vessels were nearly worth at first."""
    made = managers(scenario, **NO_HELP, rollout=600, envs=2, self_imitation=0.0)
    before = made._earned.copy()
    made.collect(1.0)
    track, earlier = made._tracks["manager_0"], 0
    ends = np.argwhere(track.ended)
    assert len(ends)
    firsts = {int(member): int(t) for t, member in ends[::-1]}
    for member, t in firsts.items():
        rewards = track.reward[: t + 1, member]
        score = made.scores[int(np.flatnonzero((ends == (t, member)).all(axis=1))[0])]
        assert rewards.sum() == pytest.approx(score - before[member], abs=1e-5)
        earlier += int((np.abs(rewards[:-1]) > 1e-7).sum())
    assert earlier > len(firsts), "costs and progress are credited before the end"


@pytest.mark.parametrize("given", [{"manager_gamma": 0.9}, {"manager_gamma": 0.99, "by_ticks": True}])
def test_unfinished_work_shifts_a_discounted_return_by_a_constant(given: dict[str, Any]) -> None:
    """The same turns are worth the same with and without it, but for what vessels are worth at the beginning."""
    sums, shifts = list[Any](), np.zeros(2)
    for counts in (True, False):
        made = managers("rush", **NO_HELP, rollout=600, envs=2, **given)
        if not counts:
            shifts, made._earned = made._earned, np.zeros(2)
            made.labs.unfinished_worth = np.zeros_like  # type: ignore[method-assign, assignment]
        made.collect(1.0)
        tracks, turns = made._tracks, np.argwhere(made._tracks["manager_0"].acted)[:, 1]
        shown = _Shown(tracks, {"manager": given["manager_gamma"]}, "by_ticks" in given)
        shown.add(tracks)
        known, returns = shown._returns("manager_0")
        assert known[:2].all()
        sums.append((returns[[int((turns == member).argmax()) for member in (0, 1)]], returns))
    assert sums[0][0] + shifts == pytest.approx(sums[1][0], abs=1e-5)
    assert np.abs(sums[0][1] - sums[1][1]).max() > 0.01


def test_unfinished_work_is_nearly_worth_something() -> None:
    """Half of the order's worth, by the share of amount and purity of the best vessels; each vessel for one order."""
    labs = managers("failing").labs
    members, rules = labs.members, labs.rules.arrays
    assert not labs.unfinished_worth(members).any(), "the vessels hold feed only"
    goal = int(rules.parts[labs.state.goal[0, 0], 0])
    vessels = labs.shelf.vessels[:, :, AMOUNTS : AMOUNTS + rules.counts.shape[1]]
    vessels[:, 0], vessels[:, 1] = 0.0, 0.0
    vessels[:, 0, goal] = 3.0
    one = labs.unfinished_worth(members)
    assert one == pytest.approx(0.5 * 3.0 / rules.maximum[labs.state.goal[0, 0]] / labs.scenario.orders)
    vessels[:, 1, goal] = 3.0
    assert labs.unfinished_worth(members) == pytest.approx(2.0 * one)
    labs.state.filled[:, 1:] = True
    assert labs.unfinished_worth(members) == pytest.approx(one)


def test_slots_and_orders_share_weights() -> None:
    """Where two slots and two orders change places, so do their actions; the matrix is exported."""
    made = managers("rush", tied=True)
    labs, learner = made.labs, made.learners["manager"]
    observed, acted = [*observed_units(labs), *notes_units(labs)], action_units(labs)
    assert len(observed) == len(learner.columns)

    def exchanged(units: list[Unit]) -> list[int]:
        """Where each unit goes when slots 0 and 3, and orders 1 and 2, change places."""
        slots, orders = {0: 3, 3: 0}, {1: 2, 2: 1}
        return [units.index((kind, slots.get(s, s), orders.get(o, o))) for kind, s, o in units]

    seen = torch.rand(5, len(observed))
    for mode in (True, False):  # in evaluation the whole matrix is made once
        learner.network.train(mode)
        with torch.no_grad():
            logits = learner.network.logits(seen, None)
            other = learner.network.logits(seen[:, exchanged(observed)], None)
        assert other.numpy() == pytest.approx(logits[:, exchanged(acted)].numpy(), abs=1e-6)
        assert not np.allclose(other.numpy(), logits.numpy(), atol=1e-4)
    weights = made.weights("manager")
    x = np.zeros((5, learner.size), dtype=np.float32)
    kept = learner.columns >= 0
    x[:, learner.columns[kept]] = seen[:, kept].numpy()
    seen[:, ~kept] = 0.0
    assert (learner.seen(x) == seen.numpy()).all()
    with torch.no_grad():
        assert learner.network.logits(seen, None).numpy() == pytest.approx(through(weights, x), abs=1e-5)


def test_weights_are_shared_where_parameters_are_hidden() -> None:
    """Level 1 reveals all of them, the last one only one."""
    world, name = load_scenario("rush").world, next(iter(load_scenario("rush").world.draws))
    draws = {**world.draws, name: world.draws[name].model_copy(update={"told": ("manager",)})}
    partly = load_scenario("rush").model_copy(update={"world": world.model_copy(update={"draws": draws})})
    cases: list[tuple[Any, dict[str, Any], bool]] = [("rush", {}, True), ("rush@1", {}, False), (partly, {}, True)]
    for scenario, given, tied in [*cases, ("rush", {"tied": False}, False), ("wurtz_dodecane", {}, False)]:
        layers = managers(scenario, **given).learners["manager"].network.actor
        assert isinstance(layers[0], TiedLinear) == tied, (scenario, given)


def test_what_is_exported_takes_the_whole_observation() -> None:
    """Weights of wide readings are 0: the exported policy is the network."""
    made = managers()
    learner = made.learners["manager"]
    assert learner.size > len(learner.columns)
    whole = np.random.default_rng(0).random((5, learner.size), dtype=np.float32)
    with torch.no_grad():
        expected = learner.network.logits(torch.from_numpy(whole[:, learner.columns]), None).numpy()
    assert through(made.weights("manager"), whole) == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_a_run_is_played_sampled_and_greedy_by_name(tmp_path: Path) -> None:
    """Evaluations have both ways, the card the better one; names and exports choose; records of both are verified."""
    out = tmp_path / "run"
    result = train(IPPO(scenario="wurtz_dodecane_direct", roles=("manager",), steps=300, **QUICK), out)
    evaluations = Run(out).evaluations()
    assert all(one.other_mean is not None and one.other_mean <= one.mean for one in evaluations)
    assert load_pretrained(Run(out).checkpoint("best") / "manager").card.sampled == result.sampled
    sampled, greedy = (export_run(Path(f"{out}:{way}"), tmp_path / way) for way in ("sampled", "greedy"))
    assert (sampled.sampled, greedy.sampled) == (True, False)
    assert sampled.evaluation["mean"] != greedy.evaluation["mean"]
    target = find_target("wurtz_dodecane_direct")
    names = [f"{out}:sampled", f"{tmp_path / 'greedy'}:sampled", str(tmp_path / "greedy"), f"{out}:greedy"]
    returns = [target.play(name, "dodecane", 4, 10).returns.tolist() for name in names]
    assert returns[0] == returns[1] != returns[2] == returns[3]
    env = raw_env("wurtz_dodecane_direct")
    with Recorder(tmp_path / "record.jsonl", env.laboratories) as recorder:
        policies = make_policies(names[0], env.laboratories)
        score = play_episode(env, policies, 11, names[0], recorder=recorder).score
    proof = verify_record(read_record(tmp_path / "record.jsonl"))
    assert (proof.status, proof.score) == ("ok", pytest.approx(score))
    assert score == pytest.approx(returns[0][1])  # the second episode of the batch
    with pytest.raises(ValueError, match="scripted:sampled: only learned policies are greedy or sampled"):
        make_policies("scripted:sampled", env.laboratories)


def test_a_policy_that_mostly_does_nothing_gets_a_note() -> None:
    def row(name: str, **measures: float) -> dict[str, Any]:
        return {"policy": name, "measures": measures}

    usual = row("scripted", limit=0.1, nothing=0.0)
    results = {"baseline": "scripted", "policies": [usual, row("random", limit=0.9, nothing=0.6), row("a", limit=0.5)]}
    said = ["random ran out of actions or ticks in 90%", "random submitted nothing in 60%"]
    assert [line.partition(" of the episodes")[0] for line in notes(results)] == said
    results["policies"][0] = row("scripted", limit=1.0, nothing=0.0)  # type: ignore[index]
    results["policies"].append(row("rush_manager:sampled", nothing=0.9))  # type: ignore[attr-defined]
    assert notes(results)[-1].endswith("; compare rush_manager:greedy and rush_manager:sampled")


@pytest.mark.slow
def test_a_manager_learns_from_nothing(tmp_path: Path) -> None:
    """Without a clone or hints it comes past the scripted manager over the same scripted benches."""
    made = IPPO(scenario="wurtz_dodecane", roles=("manager",), steps=60_000, evaluations=2, checkpoints=2, seed=1)
    result = train(made, tmp_path / "run")
    assert result.mean > result.scripted_mean > 0.7


@pytest.mark.parametrize("algorithm", [IPPO, MAPPO])
def test_a_second_core_changes_no_number(monkeypatch: pytest.MonkeyPatch, algorithm: type[IPPO]) -> None:
    threads, learned = set(), []
    values = _Learner._learn_values
    monkeypatch.setattr(_Learner, "_learn_values", lambda *own: threads.add(get_ident()) or values(*own))
    for cores in (1, 2):
        monkeypatch.setattr("chemlab.agents.train.ppo._CORES", cores)
        threads.clear()
        torch.manual_seed(0)
        team = PPOTeam(load_scenario("rush"), ["manager"], algorithm(scenario="rush", **QUICK), "scripted", False)
        for number in range(3):
            team.learn(0.1 * number, number)
        learned.append(team.learners["manager"].network.state_dict())
        assert (get_ident() in threads) == (cores == 1)
    torch.testing.assert_close(*learned, rtol=0.0, atol=0.0)


@pytest.mark.slow
def test_the_time_of_training_is_measured_by_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the table of docs/performance.md has them."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies" / "speed"))  # its scripts import one another
    monkeypatch.setattr("chemlab.agents.train.ppo._CORES", 1)
    from studies.speed.throughput import shares

    found = shares("wurtz_dodecane", False, 1)
    assert {"turns a second", "updates", "laboratories", "scripted benches"} < found.keys()
    assert all(figure > 0.0 for figure in found.values())


def test_a_policy_to_begin_from_has_no_shared_weights_and_learns_in_small_steps() -> None:
    """And returns of self-imitation are not discounted."""
    rush: dict[str, Any] = {"scenario": "rush", "roles": ("manager",)}
    assert IPPO(**rush, manager_gamma=0.9).self_imitation == 0.0
    with pytest.raises(ValueError, match="self_imitation: learns from returns that are not discounted"):
        IPPO(**rush, manager_gamma=0.9, self_imitation=1.0)
    begun, new = (IPPO(**rush, begin_from=policy) for policy in ("runs/first", None))
    assert begun.tied is False
    assert (begun.learning_rate, begun.ent_coef) < (new.learning_rate, new.ent_coef)
    assert (new.rollout, begun.rollout, begun.batch_size) == (None, 128, 4 * new.batch_size)
    with pytest.raises(ValueError, match="tied: the policy of begin_from has weights of its own for each slot"):
        IPPO(**rush, begin_from="runs/first", tied=True)


def test_while_the_critic_learns_alone_no_own_turns_are_learned_again() -> None:
    made = managers("rush", tied=False, self_imitation=1.0, net_arch=(256, 256), rollout=200)
    made.learners["manager"].take(load_pretrained("rush_manager"))
    made.learners["manager"].critic_first, again = 2, list[int]()
    made._best.learn = lambda learner, rng: again.append(learner.critic_first)  # type: ignore[method-assign]
    for rounds in range(3):
        made.learn(0.0, rounds)
    assert len(again) == 1


def test_a_policy_to_begin_from_plays_as_before_when_its_observation_is_normalized() -> None:
    """Its critic is new, and learns at the rate of learning from nothing."""
    learner = managers("rush", tied=False, learning_rate=1e-4, net_arch=(256, 256)).learners["manager"]
    learner.take(load_pretrained("rush_manager"))
    seen = 1.0 + 0.1 * torch.rand(64, len(learner.columns))
    with torch.no_grad():
        before = learner.network.logits(seen, None)
        for _ in range(2):
            learner.normalize(seen.numpy())
            assert learner.network.logits(seen, None).numpy() == pytest.approx(before.numpy(), abs=1e-3)
            assert learner.network._normalized(seen).mean(dim=0).abs().max() < 1e-3
    count, actions = len(seen), before.shape[1]
    zeros, rng = np.zeros(count, dtype=np.float32), np.random.default_rng(0)
    batch: dict[str, Any] = {"observed": seen.numpy(), "seen": None, "mask": np.ones((count, actions), dtype=np.bool_)}
    batch |= {"action": zeros.astype(np.int64), "log_probability": zeros, "advantage": zeros, "target": zeros + 1.0}
    learner.update(batch, 1.0, rng)
    assert [group["lr"] for group in learner.optimizer.param_groups] == [1e-4, 1e-3]
    with torch.no_grad():
        assert learner.network.logits(seen, None).numpy() == pytest.approx(before.numpy(), abs=1e-3)
        assert learner.network.value(seen).mean() > 0.0


def test_a_policy_with_notes_is_played_and_exported(tmp_path: Path) -> None:
    """By the score of its run, whoever plays it; without notes it observes less."""
    made = IPPO(scenario="failing", roles=("manager",), steps=200, play="greedy", **QUICK)
    result = train(made, tmp_path / "run")
    card = export_run(tmp_path / "run", tmp_path / "own")
    assert card.notes
    assert card.evaluation["mean"] == pytest.approx(result.mean)
    labs = Laboratories(load_scenario("failing"), 4, split=made.evaluation_split)
    for policy in (tmp_path / "run", tmp_path / "own"):
        policies = make_policies(f"scripted,manager={policy}", labs, RESULT_SEED)
        played = play_laboratory(labs, policies, labs.scenario.lab_goals[0], RESULT_SEED)
        assert played.returns.mean() == pytest.approx(result.mean)
    train(made.model_copy(update={"notes": False}), tmp_path / "without")
    other = export_run(tmp_path / "without", tmp_path / "other")
    assert other.observation_size == card.observation_size - notes_size(labs.manager.workplace)
    hidden = tuple(len(load_pretrained(tmp_path / "own").weights[f"{layer}.bias"]) for layer in range(2))
    learners = [managers("failing", tied=False, notes=on, net_arch=hidden).learners for on in (False, True)]
    blind, seeing = (own["manager"] for own in learners)
    own = load_pretrained(tmp_path / "own")
    refused("observes its notes, which are off here; add --notes", blind.take, own)
    seeing.take(own)
    own.card = own.card.model_copy(update={"notes": False, "advice": "scripted"})
    refused("observes the hints of scripted, which ippo and mappo do not give", seeing.take, own)
