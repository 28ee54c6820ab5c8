"""A person as a policy: what they are shown is what their agent sees, and what they type is what is played."""

import io
import itertools
from collections.abc import Iterable
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import laboratory, refused
from rich.console import Console

from chemlab.agents.human import HumanPolicy, LetterShades, Menu, _manager_paths, parse_numbers
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env

REAGENTS = ("1-chlorohexane", "2-chlorohexane", "Na")


def person(env: raw_env, agent: str, lines: Iterable[str], width: int = 80) -> tuple[HumanPolicy, io.StringIO]:
    """A person who types these lines, and what is shown to them."""
    shown, ask = io.StringIO(), Mock(side_effect=[*lines, EOFError])
    console = Console(file=shown, width=width, highlight=False)
    return HumanPolicy(env.laboratories, env.possible_agents.index(agent), ask, console), shown


def turn(env: raw_env, policy: HumanPolicy, step: int = 0) -> Any:
    """What the person plays at the laboratory's next turn."""
    observation, _, _, _, info = env.last()
    mask = info.get("action_mask")
    return policy.act(observation[None], None if mask is None else mask[None], np.array([step]), np.array([0]))[0]


@pytest.fixture
def env() -> raw_env:
    """A laboratory at the beginning of an episode."""
    return laboratory("wurtz_dodecane")


def advance(env: raw_env, *actions: tuple[Any, ...]) -> None:
    """Let the manager decide."""
    for action in actions:
        env.step(env.laboratories.actions.encode(*action))


def test_continuous_actions_as_typed() -> None:
    for typed, numbers in (
        ("t- v-", [0, 0, 0, 0, 0]),
        ("T+0.5 V-50%", [0.75, 0.25, 0, 0, 0]),
        ("T=0.7, V0", [0.7, 0.5, 0, 0, 0]),
        ("1-chlorohexane=1 Na=25%", [0.5, 0.5, 1, 0, 0.25]),
        ("2 n", [0.5, 0.5, 0, 1, 1]),
        ("0 1 0.25 0 50%", [0, 1, 0.25, 0, 0.5]),
    ):
        assert parse_numbers(typed, 5, REAGENTS).tolist() == numbers, typed


def test_mistakes_are_explained() -> None:
    for typed, part in (
        ("0 1 0", "needs 5 numbers"),
        ("T+2", "from 0 to 1"),
        ("Na=nan", "from 0 to 1"),
        ("Na=much", "not a number"),
        ("gold=1", "unknown; choose from T, V, 1-chlorohexane"),
    ):
        refused(part, parse_numbers, typed, 5, REAGENTS)
    two = "could be 1-chlorohexane or 1-bromohexane"
    refused(two, parse_numbers, "1=1", 4, ("1-chlorohexane", "1-bromohexane"))
    for typed, part in (
        ("4", "from 1 to 3"),
        ("pour 2", "not possible now"),
        ("fly", "no action"),
        ("3 1", "3 is an action, not a group; leave out 1"),
        ("²", "no action"),
    ):
        refused(part, menu().take, typed)


def menu() -> Menu:
    """20 actions of 2 kinds and one by itself, of which the third is not possible."""
    meanings = [f"{kind} {number}" for kind in ("pour", "heat") for number in range(10)] + ["end the experiment"]
    paths = [meaning.split() for meaning in meanings[:-1]] + [meanings[-1:]]
    return Menu(meanings, paths, [i for i in range(21) if i != 2])


def test_words_choose_or_narrow() -> None:
    assert menu().take("e") == 20
    assert menu().take("heat 7") == 17
    found = menu()
    assert found.take("heat") is None
    assert [actions for _, actions in found.entries()] == [[i] for i in range(10, 20)]
    assert found.take("1") == 10
    narrowed = menu()
    assert narrowed.take("experiment") is None  # not how it begins: shown, not played
    assert [actions for _, actions in narrowed.entries()] == [[20]]


@pytest.mark.parametrize(
    ("typed", "slots"),
    [("slot 0", {0}), ("slot 1", {1}), ("start rxn 0 on slot 1", {1}), ("SLOT 1 oil", {1}), ("rxn_1", set(range(12)))],
)
def test_a_number_is_the_whole_number_of_the_word_before_it(typed: str, slots: set[int]) -> None:
    """Slot 1 is not slot 10, and slot 0 is not the 0 of rxn_0."""
    cases = itertools.product((0, 1), range(12), ("a", "oil"))
    meanings = [f"start rxn_{bench} on slot {slot}, goal {goal}" for bench, slot, goal in cases]
    found = Menu(meanings, [meaning.split(" ") for meaning in meanings], range(len(meanings)))
    found.take(typed)
    left = [meanings[action] for _, actions in found.entries() for action in actions]
    assert {int(meaning.split("slot ")[1].split(",")[0]) for meaning in left} == slots
    if "rxn" in typed:
        assert len({meaning.split()[1] for meaning in left}) == 1


@pytest.mark.parametrize("name", scenario_names())
def test_every_legal_action_can_be_typed(name: str) -> None:
    """By its whole meaning, and by numbers: whatever the scenario; and by numbers nothing else."""
    env = laboratory(name, 1)
    labs = env.laboratories
    meanings, paths = labs.actions.action_meanings, _manager_paths(labs)
    legal = np.flatnonzero(env.infos["manager_0"]["action_mask"]).tolist()
    for action in legal:
        assert Menu(meanings, paths, legal).take(meanings[action]) == action
    reached, open_lists = [], [""]
    while open_lists:
        numbers = open_lists.pop()
        menu = Menu(meanings, paths, legal)
        action = menu.take(numbers) if numbers else None
        if action is not None:
            reached.append(action)
        else:
            open_lists += [f"{numbers} {i}".strip() for i in range(1, len(menu.entries()) + 1)]
    assert sorted(reached) == legal


def test_layers_have_letters_of_their_own() -> None:
    scenario = load_scenario("wurtz_dodecane")
    shades = LetterShades(scenario)
    assert len(set(shades.letters)) == len(shades.letters)
    pixels = np.repeat([scenario.materials[name].shade for name in ("water", "diethyl_ether", "air")], [50, 30, 20])
    line = shades.line(pixels, 10).plain
    water, ether = line[0], line[5]
    assert line == water * 5 + ether * 3 + ".."
    assert f"{water} water" in shades.legend(pixels)
    assert f"{ether} diethyl_ether" in shades.legend(pixels)


def test_the_manager_sees_outsides_and_readings_only(env: raw_env) -> None:
    """A vessel's contents are told by what was measured, and not before."""
    policy, shown = person(env, "manager_0", ["measure slot 0 with gas_chromatograph", "discard slot 1"])
    env.step(turn(env, policy))
    assert "at tick" not in shown.getvalue()
    assert "0.4187/1.2 L" in shown.getvalue()  # 4 mol x 74.12 g/mol / 708.1 g/L
    turn(env, policy, 1)
    later = " ".join(shown.getvalue().split())
    assert "gas_chromatograph at tick 0 (%): slot 0 diethyl_ether 100" in later
    assert "instruments 0.0100" in later
    assert "59 actions" in later


def test_what_is_shown_comes_from_the_observation_alone(env: raw_env) -> None:
    """With other true contents behind it, the same observation shows the same."""
    policy, _ = person(env, "manager_0", [])
    seen = env.observe("manager_0")

    def text() -> str:
        console = Console(file=io.StringIO(), width=80)
        for part in policy.view(seen, 0):
            console.print(part)
        return console.file.getvalue()  # type: ignore[attr-defined]

    before = text()
    env.laboratories.shelf.amounts[0] *= 0.3
    env.laboratories.state.ticks[0] = 77
    assert text() == before


@pytest.mark.parametrize("width", [30, 80, 200])
def test_narrow_and_wide_terminals(env: raw_env, width: int) -> None:
    policy, shown = person(env, "manager_0", ["?", "xyz", "discard slot 1"], width)
    turn(env, policy)
    assert max(map(len, shown.getvalue().splitlines())) <= width
    advance(env, ("start", "ext_0", 0, "dodecane"), ("wait",))
    policy, shown = person(env, "ext_0", ["?", "end"], width)
    assert turn(env, policy) == 40
    assert max(map(len, shown.getvalue().splitlines())) <= width


def test_reaction_gauges_are_in_their_units(env: raw_env) -> None:
    advance(env, ("start", "rxn_0", 0, "dodecane"), ("wait",))
    policy, shown = person(env, "rxn_0", ["?", "T+ V- Na=0.5"])
    action = turn(env, policy)
    np.testing.assert_array_equal(action, [1.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    assert "temperature 298.2 K" in shown.getvalue()  # ambient, rounded
    assert "temperature: 275 to 350 K" in shown.getvalue()
    assert "volume 1.2 L" in shown.getvalue()
    assert "Na 3 mol" in shown.getvalue()
    env.step(action)
    policy, shown = person(env, "rxn_0", [""])
    turn(env, policy, 1)
    for part in ("313.2 K", "1.1 L", "Na 1.5 mol"):  # a step of 15 K up, of 0.1 L in, half of the sodium
        assert part in shown.getvalue()


def test_enter_repeats(env: raw_env) -> None:
    """The last action; at the beginning of an experiment nothing is changed."""
    advance(env, ("start", "rxn_0", 0, "dodecane"), ("wait",))
    policy, _ = person(env, "rxn_0", ["", "T+", "", ""])
    hold = [0.5, 0.5, 0.0, 0.0, 0.0, 0.0]
    assert turn(env, policy, 0).tolist() == hold
    heat = turn(env, policy, 1)
    assert turn(env, policy, 2).tolist() == heat.tolist() == [1.0, *hold[1:]]
    assert turn(env, policy, 0).tolist() == hold


def test_wrong_input_is_asked_again(env: raw_env) -> None:
    policy, shown = person(env, "manager_0", ["wait", "99", "", "what?", "submit slot 1"])
    assert turn(env, policy) == env.laboratories.actions.encode("submit", 1)
    for part in ("'wait' is not possible now", "the list goes from 1 to", "type a number", "no action is called"):
        assert part in shown.getvalue()


def test_terminals_without_unicode(env: raw_env) -> None:
    raw = io.BytesIO()
    console = Console(file=io.TextIOWrapper(raw, encoding="ascii", write_through=True), width=80)
    advance(env, ("start", "rxn_0", 0, "dodecane"), ("wait",))
    turn(env, HumanPolicy(env.laboratories, env.possible_agents.index("rxn_0"), lambda prompt: "T+", console))
    assert b"spectrum" in raw.getvalue()
