"""Joint training: regimes, clones, beginnings from other runs, and a run that stops goes on as if it had not."""

import pickle
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import refused
from run_files import trained

pytest.importorskip("sb3_contrib", reason='needs the extra: pip install ".[train]"')

import torch

from chemlab.agents.evaluate.benchmark import find_rows
from chemlab.agents.notes import notes_size
from chemlab.agents.policies import agent_policy
from chemlab.agents.pretrained import load_pretrained
from chemlab.agents.runs import Run
from chemlab.agents.train import imitate, joint
from chemlab.agents.train.arguments import IPPO, MAPPO
from chemlab.agents.train.export import export_run
from chemlab.agents.train.learn import train
from chemlab.agents.train.loop import Progress, Watcher
from chemlab.agents.train.ppo import PPOTeam
from chemlab.lab.engine import Laboratories

SMALL: dict[str, Any] = {"envs": 4, "rollout": 12, "steps": 400, "batch_size": 32, "epochs": 1}
SMALL |= {"evaluations": 2, "checkpoints": 2, "eval_episodes": 1, "final_episodes": 1}


def team_of(arguments: IPPO) -> PPOTeam:
    """What a run with these arguments begins with, but for clones."""
    run = joint.Team(arguments)
    run.make()
    return run.team


@pytest.mark.parametrize("rewards", [None, "cooperative", "mixed"])
def test_no_reward_is_lost_or_another_agents(rewards: str | None) -> None:
    """What all laboratories paid an agent after its first turn is what its turns are learned from."""
    given: dict[str, Any] = {"envs": 6, "rollout": 150, "practice": 0.0, "refund": 0.0}
    team = team_of(IPPO(scenario="wurtz_two_lines", rewards=rewards, **given))
    step, paid = team.batch.step, dict.fromkeys(team.agents, 0.0)
    begun = {agent: np.zeros(6, dtype=np.bool_) for agent in team.agents}

    def watched(actions: Any) -> Any:
        for agent in team.agents:
            begun[agent] |= team._infos[agent]["has_turn"].astype(np.bool_)
        found = step(actions)
        for agent in team.agents:
            earned = found[1][agent]
            assert rewards is not None or not earned[~begun[agent]].any()
            paid[agent] += float(earned[begun[agent]].sum())
            ended = rewards is None and agent != "manager_0"
            over = found[2] | (found[4][agent]["experiment_over"] if ended else False)
            begun[agent] &= ~over
        return found

    team.batch.step = watched  # type: ignore[method-assign]
    team.collect(1.0)
    assert any(value != 0.0 for value in paid.values())
    for agent, track in team._tracks.items():
        if agent == "manager_0":  # credited at once, and for unfinished work: what its rewards add up to is in test_ppo
            paid[agent] = float(track.reward.sum())
        track.value[:] = 0.0
        whole = track.finished(np.zeros(6, dtype=np.float32), np.ones(6, dtype=np.bool_), 1.0, 0.0)
        assert float(np.sum(whole["advantage"])) == pytest.approx(paid[agent], rel=1e-4, abs=1e-5), agent
        masks = whole["mask"]
        if masks is not None:
            chosen = np.asarray(whole["action"])
            assert masks[np.arange(len(chosen)), chosen].all(), "only legal actions are explored"


def weights(run: Path) -> dict[str, Any]:
    checkpoint = Run(run).checkpoint("last")
    files = {file.stem: load_pretrained(file).weights for file in checkpoint.glob("*.safetensors")}
    return {f"{stem} {name}": array for stem, own in files.items() for name, array in own.items()}


class _Stop(Exception):
    pass


class _Stopping(Watcher):
    """Ends training a rollout after the first checkpoint."""

    checkpoint = False

    def evaluated(self, evaluation: Any, best: bool) -> None:
        self.checkpoint = True

    def advanced(self, step: int, mean: float | None, note: str = "") -> None:
        if self.checkpoint:
            raise _Stop


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        (IPPO, {}),
        (IPPO, {"regime": "in-turns", "period": 1}),
        (IPPO, {"roles": ("manager",), "background": "scripted@0.5"}),
        (MAPPO, {}),
    ],
)
def test_a_stopped_run_goes_on_alike(kind: type[IPPO], more: dict[str, Any], tmp_path: Path) -> None:
    arguments = kind(**SMALL, **more)
    whole = train(arguments, tmp_path / "whole")
    with pytest.raises(_Stop):
        train(arguments, tmp_path / "stopped", _Stopping())
    torch.manual_seed(99)
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


@pytest.mark.usefixtures("hasty")
def test_what_others_draw_depends_on_the_seed_of_the_episode_alone() -> None:
    """And every agent, of those that are cloned, too, draws for itself."""
    given = {**SMALL, "rollout": 1, "scenario": "wurtz_two_lines", "background": "random"}
    team = team_of(IPPO(**given, roles=("manager",)))
    benches = [policy for policy in team._players._policies if policy is not None]
    assert len({policy._stream[0, 0] for policy in benches}) == len(benches) > 2
    while not team.scores:
        team.collect(1.0)
    (member, *_) = np.flatnonzero(team.labs.episodes.begun > 1).tolist()
    now = [policy._stream[member, 0] for policy in benches]
    team._players.seed(member, team.labs.episodes.sequence(member))
    assert now == [policy._stream[member, 0] for policy in benches]
    clones = team_of(IPPO(**given, roles=("rxn",), bc="random"))
    teachers, collect = list[set[float]](), clones.collect

    def watched(remaining: float) -> None:
        collect(remaining)
        teachers.append({float(one._policy._seeds.generate_state(1)[0]) for one in clones._teachers.values()})

    clones.collect = watched  # type: ignore[method-assign]
    clones.clone("random", 1, 1, 0.1)
    assert len(teachers[0]) == len(clones._tracks) > 1


def test_a_checkpoint_has_what_self_imitation_remembers_and_no_empty_rows() -> None:
    team = team_of(IPPO(**SMALL, scenario="rush", roles=("manager",)))
    for _ in range(4):
        team.collect(1.0)
    best: Any = team._best
    pickled = pickle.dumps(best)
    again, taken = pickle.loads(pickled), int((best._env >= 0).sum())
    row = sum(array[0].nbytes for array in (*best._turns.values(), best._env, best._following, best._ended))
    assert 0 < taken * row < len(pickled) < taken * row + 10_000
    for name, value in vars(best).items():
        np.testing.assert_equal(vars(again)[name], value, err_msg=name)


def test_one_role_can_learn_alone_and_start_from_another_run(tmp_path: Path) -> None:
    train(IPPO(**{**SMALL, "steps": 60}, roles=("rxn",)), tmp_path / "first")
    second = IPPO(**{**SMALL, "steps": 40}, roles=("rxn", "dit"), begin_from=str(tmp_path / "first"))
    assert train(second, tmp_path / "second").steps >= 40
    assert {name.partition(" ")[0] for name in weights(tmp_path / "second")} == {"rxn", "dit"}
    nowhere = IPPO(**SMALL, begin_from=str(tmp_path))
    refused("neither a training run nor a checkpoint", train, nowhere, tmp_path / "third")
    assert not (tmp_path / "third").exists(), "another name may be given for the same folder"


@pytest.mark.usefixtures("hasty")
@pytest.mark.slow
def test_a_team_begins_as_clones(tmp_path: Path) -> None:
    """In laboratories that have begun anew; clones are scored before they learn, and a run can be exported."""
    small = {**SMALL, "scenario": "wurtz_dodecane_direct", "roles": ("rxn", "dit"), "rewards": "mixed"}
    team = team_of(IPPO(**small, bc="scripted"))
    assert set(team.clone("scripted", 60, 1, 0.02)) == {"rxn", "dit"}
    assert not any(track.acted.any() for track in team._tracks.values())
    assert not team.scores
    assert (team.labs.state.ticks == 0).all()
    arguments = IPPO(**{**small, "steps": 40}, bc="scripted", bc_steps=50)
    assert (arguments.practice, arguments.refund, arguments.own_goals) == (0.0, 0.0, 0.0), "help is for nothing"
    assert (arguments.learning_rate, arguments.ent_coef, arguments.gae_lambda) == (1e-4, 0.0, 0.98)
    assert arguments.tied is None
    train(arguments, tmp_path / "run")
    run = Run(tmp_path / "run")
    assert (run.evaluations()[0].step, run.checkpoint("first")) == (0, run.checkpoints / "first-0")
    assert [row.name.rpartition(" ")[2] for row in find_rows([str(run.path)])] == ["(first)", "(best)", "(last)"]
    card = export_run(tmp_path / "run", tmp_path / "mine", "dit")
    assert (card.name, card.bench, card.background) == ("mine", "dit", "scripted")
    assert "--bc scripted --bc-steps 50" in card.command
    for role, message in ((None, "give one of its roles: dit, rxn; given None"), ("ext", "dit, rxn; given 'ext'")):
        refused(message, export_run, tmp_path / "run", tmp_path / "other", role)


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [("relay", {"rxn": {"F"}, "fin": {"E"}}), ("wurtz_dodecane_direct", {"rxn": {"dodecane"}, "dit": {"dodecane"}})],
)
def test_benches_practise_what_a_laboratory_asks_of_them(scenario: str, expected: dict[str, set[str]]) -> None:
    """A bench may make what another goes on with; it would never earn anything for the laboratory's own goal."""
    team = team_of(IPPO(scenario=scenario, roles=tuple(expected), envs=16, rollout=16))
    names = team.labs.scenario.goals
    practised = {
        role: {names[goal] for goal in practice.batch.batch.experiments.goal}
        for role, practice in team.practices.items()
    }
    assert practised == expected


def test_scripted_scores_are_those_of_scripted_policies_in_the_roles_that_learn() -> None:
    found = []
    for background in ("scripted", "random"):
        run = joint.Team(IPPO(**{**SMALL, "scenario": "wurtz_dodecane_direct", "background": background}))
        run.make()
        found.append(run.scripted(2, 0))
    assert found[0] == found[1]
    assert min(found[0].values()) > 0.5


def test_practised_benches_are_greedy_under_a_sampled_manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = joint.Team(IPPO(scenario="wurtz_dodecane_direct", roles=("all",), envs=4, rollout=16))
    run.make()
    played, kept = [], tmp_path / "kept"
    kept.mkdir()

    def play(labs: Any, policies: Any, goal: str, seed: int) -> Any:
        played.append({agent for agent, policy in policies.items() if policy.card.sampled})
        return SimpleNamespace(returns=np.zeros(1), measures={"nothing": np.ones(1)})

    monkeypatch.setattr(joint, "play_laboratory", play)
    run.save(kept, Progress(1, sampled=True), None)
    run.team.fixed = {"rxn", "dit"}
    run.scores(1, 0, True)
    run.take(kept)
    with pytest.warns(UserWarning, match="the best checkpoint submits nothing in 100% of the episodes; give more"):
        run.scores(1, 0, True)
    assert played == [{"manager_0"}, {"manager_0", "rxn_0", "dit_0"}], "a checkpoint plays as it did before that"


def test_a_checkpoint_before_the_first_evaluation_plays_as_asked(tmp_path: Path) -> None:
    stopping = _Stopping()
    stopping.checkpoint = True
    given = {**SMALL, "scenario": "wurtz_dodecane_direct", "evaluations": 1, "checkpoints": 100}
    with pytest.raises(_Stop):
        train(IPPO(**given, roles=("manager",), play="sampled"), tmp_path, stopping)
    assert load_pretrained(Run(tmp_path).checkpoint("last") / "manager").card.sampled


def test_what_a_team_has_learned_is_exported(tmp_path: Path) -> None:
    """Also a manager with shared rewards, a bench without all goals, and a user's scenario without recorded vessels."""
    small = {**SMALL, "scenario": "relay", "roles": ("manager", "fin"), "steps": 40, "rewards": "mixed"}
    train(IPPO(**small), tmp_path / "run")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        card = export_run(tmp_path / "run", tmp_path / "mine", "manager")
        load_pretrained(tmp_path / "mine").check(Laboratories("relay", 1).manager.workplace)
    assert card.bench == "manager"
    assert export_run(tmp_path / "run", tmp_path / "fin", "fin").goals == ["E"]
    own = tmp_path / "own.toml"
    own.write_text('base = "wurtz_dodecane_direct"\nname = "own"\n[limits]\nticks = 90\n')
    train(IPPO(**{**SMALL, "scenario": str(own), "roles": ("manager", "dit"), "steps": 40}), tmp_path / "own")
    assert export_run(tmp_path / "own", tmp_path / "two", "manager").scenario == "own"
    refused(r"run: chemlab export starts .*own\.toml", export_run, tmp_path / "own", tmp_path / "two", "dit")


@pytest.mark.slow
def test_clones_that_explore_still_do_what_they_were_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers are drawn about as far from the shown ones as the clone misses them."""
    small = {**SMALL, "scenario": "wurtz_dodecane_direct", "roles": ("rxn", "dit"), "rewards": "mixed"}
    team = team_of(IPPO(**small, bc="scripted"))
    hit = team.clone("scripted", 600, 2, 0.02)
    spread = team.learners["rxn"].network.log_std.detach().exp()
    assert hit["dit"] > 0.95, "share of turns"
    assert hit["rxn"] < 0.05, "mean difference of numbers from 0 to 1"
    assert (spread >= 0.019).all()
    assert spread.mean() < 4.0 * hit["rxn"] + 0.03
    monkeypatch.setattr(imitate, "_UPDATES", 1)
    team.clone("scripted", 100, 1, 0.3)
    np.testing.assert_allclose(team.learners["rxn"].network.log_std.detach().exp(), 0.3, rtol=1e-6)


def test_in_rounds_learners_play_and_the_policy_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is learned from then is what the policy would have played, not what was; rounds go on to an end."""
    team = team_of(IPPO(**{**SMALL, "scenario": "relay", "roles": ("manager",)}, bc="scripted"))
    shown, learner, ended = agent_policy("scripted", team.labs, 0), team.learners["manager"], list[bool]()
    batches: list[dict[str, Any]] = []

    def clone(batch: dict[str, Any], rng: Any, least_std: float) -> float:
        batches.append(batch)
        return 0.0

    monkeypatch.setattr(learner, "clone", clone)
    collect = team.collect

    def watched(remaining: float) -> None:
        collect(remaining)
        ended.append(any(track.ended.any() for track in team._tracks.values()))

    monkeypatch.setattr(team, "collect", watched)
    helped = list[float]()
    monkeypatch.setattr(team, "_read", lambda done, over: helped.append(done))
    team.clone("scripted", 3, 2, 0.02)
    assert set(helped[:-1]) == {1.0}, "demonstrations have no free readings"
    assert helped[-1] == 0.0
    assert any(ended)
    first, both = (len(batch["action"]) for batch in batches)
    assert both > first
    late = {name: array[first:] for name, array in batches[1].items() if array is not None}
    tried, _ = learner.act(late["observed"], late["mask"], greedy=True)
    assert (late["action"] != tried).mean() > 0.2
    rows = np.arange(len(tried))
    assert late["mask"][rows, late["action"]].mean() > 0.9
    asked = shown.act(late["observed"][:1], late["mask"][:1].astype(np.int8), rows[:1] * 0, rows[:1])
    assert late["action"][0] == asked[0]


def test_a_critic_sees_the_state_and_the_actor_does_not() -> None:
    """The actor has the size of the observation; the critic's first layer has that of the state as well."""
    arguments = MAPPO(**SMALL, scenario="rush", net_arch=(48, 24), tied=False)
    team = team_of(arguments)
    state = team.batch.state_space.shape[0]
    for role, learner in team.learners.items():
        sizes = [(layer.in_features, layer.out_features) for layer in learner.network.actor if hasattr(layer, "bias")]
        own = len(learner.columns)
        assert sizes[:2] == [(own, 48), (48, 24)], role
        assert learner.network.critic[0].in_features == own + state  # type: ignore[union-attr]
    for _ in range(4):
        team.collect(1.0)
    track = team._tracks["manager_0"]
    assert track.seen[track.acted][:, -state:].std(axis=0).max() > 0.1, "states of turns differ"
    exported = team.weights("manager")["0.weight"].shape[1]
    assert exported == team.labs.observation_sizes[0] + notes_size(team.labs.manager.workplace)
    assert arguments.folder() != IPPO(**SMALL, scenario="rush").folder()


def test_a_last_minibatch_of_one_does_no_harm() -> None:
    """The spread of one advantage is not a number, and neither is a network that has learned from it."""
    learner = team_of(IPPO(**{**SMALL, "batch_size": 16}, roles=("dit",))).learners["dit"]
    count, actions = 33, learner.network.actor[-1].out_features
    rng = np.random.default_rng(0)
    observed = rng.random((count, learner.size), dtype=np.float32)
    mask = np.ones((count, actions), dtype=np.bool_)
    action, log_probability = learner.act(observed, mask)
    numbers = rng.random((2, count), dtype=np.float32)
    batch: dict[str, Any] = {"observed": observed, "seen": observed, "mask": mask, "action": action}
    before = {name: value.clone() for name, value in learner.network.state_dict().items()}
    more = {"log_probability": log_probability, "advantage": numbers[0], "target": numbers[1]}
    learner.update({**batch, **more}, 1.0, rng)
    for name, value in learner.network.state_dict().items():
        assert torch.isfinite(value).all(), name
    assert any((value != before[name]).any() for name, value in learner.network.state_dict().items())


def test_policies_of_single_benches_go_on_together(tmp_path: Path) -> None:
    """A bench's PPO, masked or not, and a reaction bench's become the team's before it has learned anything."""
    for role, algo in (("rxn", "ppo"), ("dit", "ppo"), ("ext", "maskable-ppo")):
        trained(tmp_path / role, bench=role, algo=algo)
    begin = ",".join(f"{role}={tmp_path / role}" for role in ("rxn", "dit", "ext"))
    for text in (begin, str(tmp_path)):
        team = team_of(IPPO(**SMALL, begin_from=text, net_arch=(64, 64)))
        for role in ("rxn", "dit", "ext"):
            single = load_pretrained(Run(tmp_path / role).checkpoint("best") / role).weights
            for name, value in team.weights(role).items():
                np.testing.assert_array_equal(value, single[name], err_msg=f"{role} {name}")
    for wrong, message in (
        (f"cook={tmp_path / 'rxn'}", "no cook learns; roles: manager, rxn, ext, dit"),
        (f"rxn={tmp_path / 'nowhere'}", "nowhere: neither a training run nor a checkpoint"),
        (f"ext={tmp_path / 'dit'}", "holds no policy of ext"),
        (f"{tmp_path / 'dit'},ext={tmp_path / 'ext'}", "must be one policy or folder, or ROLE=POLICY"),
    ):
        refused(message, team_of, IPPO(**SMALL, begin_from=wrong))
    recurrent: Any = SimpleNamespace(card=SimpleNamespace(memory=8), weights={"0.weight": np.zeros((4, 8))})
    assert not joint.Team(IPPO(**SMALL))._observes_wide({"manager": recurrent}), "take() refuses it"
    other = IPPO(**SMALL, begin_from=begin, net_arch=(32,))
    refused(r"rxn: rxn has hidden layers \[64, 64\].*--net-arch", team_of, other)


def test_bad_arguments_are_named(tmp_path: Path) -> None:
    run, cook = tmp_path / "run", "roles: wurtz_dodecane has manager, rxn, ext, dit; given cook"
    refused(cook, train, IPPO(roles=("cook",)), run)
    refused(r"regime\s.*'together' or 'in-turns'", lambda: IPPO(regime="chaos"))  # type: ignore[arg-type]
    assert IPPO(regime="in-turns").practice == 0.0
    refused("do not learn in-turns", train, IPPO(**SMALL, regime="in-turns", practice=0.5), run)
    for role, name, value in (("manager", "gamma", 0.5), ("rxn", "notes", False), ("rxn", "regime", "in-turns")):
        no_effect = IPPO(roles=(role,), **{name: value})
        refused(f"{name}: has no effect, because only {role} learns; leave it out", train, no_effect, run)
    refused("clone would replace the policies", lambda: IPPO(bc="scripted", begin_from="rush_manager"))
    refused("heuristc", train, IPPO(**SMALL, bc="heuristc"), run)
    refused("heuristc", train, IPPO(**SMALL, background="heuristc"), run)
    assert not run.exists()
