"""Making views of the laboratory by name: ids, background policies by name, agent or kind, and what is refused."""

from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import refused

import chemlab
from chemlab.agents.background import background_policies, role_env, role_vector_env
from chemlab.agents.policies import make_policies, policy_names
from chemlab.agents.random_policy import RandomPolicy
from chemlab.lab.engine import Laboratories

assert chemlab.__version__, "importing chemlab registers the ids"
LINES = "wurtz_two_lines"


def constant(action: int) -> Any:
    """A policy that does one thing."""
    return Mock(spec=["act"], act=Mock(side_effect=lambda seen, *_: np.full(len(seen), action)))


def chosen(background: Any, scenario: str = LINES) -> dict[str, Any]:
    """What ``background`` means for a laboratory."""
    given = background_policies(background)
    assert callable(given)
    return dict(given(Laboratories(scenario)))


def test_an_agents_own_policy_beats_its_kinds_and_that_beats_the_default() -> None:
    mine, ours = constant(40), constant(40)
    policies = chosen({"ext_1": mine, "ext": ours, "rxn": "random", "manager": "scripted:unsafe"})
    scripted = make_policies("scripted", Laboratories(LINES))
    assert policies["ext_1"] is mine
    assert policies["ext_0"] is ours
    assert isinstance(policies["rxn_0"], RandomPolicy)
    assert isinstance(policies["rxn_1"], RandomPolicy)
    assert policies["rxn_0"] is not policies["rxn_1"]
    assert type(policies["manager_0"]) is type(scripted["manager_0"])
    assert type(policies["dit_1"]) is type(scripted["dit_1"])
    assert all(isinstance(policy, RandomPolicy) for policy in chosen("random").values()), "one name is for everybody"


def test_nobody_else_moves_the_focal_agent() -> None:
    """A policy for the focal agent alone would never be asked; a role's may have another agent to play."""
    for agent, word in (("manager_0", "manager"), ("manager_0", "manager_0"), ("rxn_0", "rxn_0")):
        for make in (role_env, role_vector_env):
            arguments: Any = {"scenario": LINES, "agent": agent, "background": {word: "random", "dit": "random"}}
            refused(f"background: {agent} is played by the caller, .*; omit {word}$", make, **arguments)
    assert role_env(LINES, "rxn_0", {"rxn": "random"}).agent == "rxn_0"


def test_unknown_backgrounds_are_refused() -> None:
    cases: list[tuple[Any, type[Exception], list[str]]] = [
        ("omniscient", ValueError, ["'omniscient'", *policy_names()]),
        ({"rxn_0": "omniscient"}, ValueError, ["'omniscient'"]),
        ({"rxn_7": "random"}, ValueError, ["rxn_7", "rxn_0, rxn_1"]),
        ({"rxn": 3}, TypeError, ["rxn_0", "predict", "3"]),
        ({"dit": None}, TypeError, ["dit_0", "None"]),
    ]
    for background, error, parts in cases:
        for make, members in ((role_env, ()), (role_vector_env, (2,))):
            with pytest.raises(error) as caught:
                make(*members, LINES, background=background)  # type: ignore[operator]
            assert [part for part in parts if part not in str(caught.value)] == []
