"""Roles: everything about an agent is asked of its role, and its index has no meaning."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import record_episode

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.seats import Room
from chemlab.config.scenario import Scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.lab.engine import Laboratories


def played(folder: Path, name: str) -> list[dict[str, Any]]:
    """What agents see, do, earn and cost in a recorded episode, by name."""
    lines = record_episode(folder / "episode.jsonl", name).read_text("utf-8").splitlines()
    return [{key: told for key, told in json.loads(line).items() if key != "hidden"} for line in lines[1:]]


@pytest.mark.parametrize("name", ["wurtz_dodecane", "failing"])
def test_no_episode_depends_on_the_order_of_agents(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    usual, agents = played(tmp_path, name), Scenario.agents
    assert len({agent for turn in usual for agent in turn.get("play", ())}) > 2
    monkeypatch.setattr(Scenario, "agents", lambda self: agents(self)[::-1])
    assert Laboratories(name).agents[-1] == "manager_0"
    assert played(tmp_path, name) == usual


def test_a_batch_pays_each_role_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def sums() -> dict[str, list[float]]:
        batch = BatchedLaboratory(3, "wurtz_dodecane")
        _, infos = batch.reset(seed=2)
        found, rng = {agent: np.zeros(3) for agent in batch.possible_agents}, np.random.default_rng(0)
        for _ in range(80):
            drawn = {}
            for agent in sorted(batch.possible_agents):
                mask, shape = infos[agent].get("action_mask"), batch.action_space(agent).shape or ()
                legal = [] if mask is None else [rng.choice(np.flatnonzero(row)) for row in mask]
                drawn[agent] = rng.random((3, *shape)) if mask is None else np.array(legal)
            _, rewards, _, _, infos = batch.step(drawn)
            for agent, own in rewards.items():
                found[agent] += own
        return {agent: own.tolist() for agent, own in sorted(found.items())}

    usual, agents = sums(), Scenario.agents
    assert np.any(usual["manager_0"])
    assert sum(np.any(own) for own in usual.values()) > 1
    monkeypatch.setattr(Scenario, "agents", lambda self: [*agents(self)[2:], *agents(self)[:2]])
    assert sums() == usual


def test_seats_and_learners_ask_for_roles(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    from chemlab.agents.train.ppo import wide_columns
    from chemlab.agents.train.tied import observed_units

    def found() -> tuple[Any, ...]:
        room = Room("unlabelled", ("manager_0", "dit_0"), salt="0123456789abcdef" * 2, seed=3)
        room.call("manager_0", "start", {"bench": "dit_0", "slot": 1, "goal": "dodecane"})
        room.call("manager_0", "wait")
        texts = [room.call(seat, "look").text for seat in ("manager_0", "dit_0")]
        labs = Laboratories("wurtz_dodecane")
        measures = play_laboratory(labs, make_policies("scripted", labs), None, 1).measures
        made = {name: values.tolist() for name, values in measures.items()}
        return texts, wide_columns(room.laboratories.scenario).tolist(), observed_units(room.laboratories), made

    usual, agents = found(), Scenario.agents
    monkeypatch.setattr(Scenario, "agents", lambda self: agents(self)[::-1])
    assert found() == usual
