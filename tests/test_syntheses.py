"""The shipped syntheses: what their files say, what scripted agents make of them, what was published about them."""

import csv
import functools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import script, slow_but

import chemlab.scenarios
from chemlab.agents.episodes import EpisodeResult, play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.inherit import scenario_names, shipped_file, synthesis_names
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE

ROOT = Path(__file__).parent.parent
SYNTHESES = synthesis_names()

WORTH = {"aspirin": 0.7, "benzoic": 0.8, "fischer": 0.25, "snar": 0.6}
"""Scores that scripted agents reach."""


@functools.cache
def played(name: str, policy: str, seed: int = 0) -> EpisodeResult:
    env = raw_env(name)
    return play_episode(env, make_policies(policy, env.laboratories, seed), seed, policy)


def test_they_are_those_of_the_folder_and_have_names_of_their_own() -> None:
    folder = Path(chemlab.scenarios.__path__[0]) / "syntheses"
    assert sorted(path.stem for path in folder.glob("*.toml")) == SYNTHESES
    assert not set(SYNTHESES) & set(scenario_names())
    assert all(shipped_file(name) == folder / f"{name}.toml" for name in SYNTHESES)
    assert shipped_file("unheard_of") is None


@pytest.mark.parametrize("name", SYNTHESES)
def test_lint(name: str) -> None:
    scenario = load_scenario(name)
    assert (scenario.name, scenario.physics, scenario.argument) == (name, "real", name)
    assert scenario.summary.endswith(".")
    assert set(scenario.costs.stock_per_mol) <= set(scenario.stock)
    # A synthesis of one's own may begin with it.
    assert load_scenario({"base": name, "name": "cheap", "costs": {"tick": 0.0}}).materials == scenario.materials


@pytest.mark.parametrize("name", slow_but(SYNTHESES, "aspirin", "snar"))
def test_scripted_agents_make_it_safely(name: str) -> None:
    result = played(name, "scripted")
    assert result.score > WORTH[name]
    assert result.score > played(name, "random").score + 0.3
    assert result.costs["illegal_actions"] == 0.0
    assert not {event: amount for event, amount in result.safety_events.items() if amount > 0.0}


def test_the_table_of_results_is_of_these_scenarios() -> None:
    text = (ROOT / "docs" / "syntheses.md").read_text(encoding="utf-8")
    block = text.partition("<!-- results: begin -->")[2].partition("<!-- results: end -->")[0]
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \| ([\d.]+) \| ([\d.]+) \| (-?[\d.]+) \|", block, re.M)
    assert {row[:2] for row in rows} == {(name, policy) for name in SYNTHESES for policy in ("scripted", "random")}
    for name, policy, *numbers in rows:
        if policy == "scripted":  # whose episodes differ by how well layers were shaken and parted
            result = played(name, policy)
            expected = [result.submitted_mol, result.purity, result.score]
            assert [float(number) for number in numbers] == pytest.approx(expected, rel=0.2, abs=0.02)


@functools.cache
def rows_of(name: str) -> list[Any]:
    rows: list[Any] = script("studies/physics/syntheses.py").SYNTHESES[name]()
    return rows


@pytest.mark.parametrize("name", SYNTHESES)
def test_the_committed_table_is_what_comes_out(name: str) -> None:
    with (ROOT / "studies" / "physics" / "syntheses.csv").open(encoding="utf-8", newline="") as handle:
        committed = [row for row in csv.DictReader(handle) if row["synthesis"] == name]
    rows = rows_of(name)
    assert [row["quantity"] for row in committed] == [row.quantity for row in rows]
    for line, row in zip(committed, rows, strict=True):
        for key in ("published", "independent", "chemlab"):
            number = getattr(row, key)
            assert float(line[key]) == pytest.approx(number, rel=1e-3, abs=1e-7, nan_ok=True), row.quantity


@pytest.mark.parametrize("name", SYNTHESES)
def test_chemlab_agrees_with_what_was_worked_out_without_it(name: str) -> None:
    rows = [row for row in rows_of(name) if not (math.isnan(row.independent) or math.isnan(row.chemlab))]
    assert rows
    for row in rows:
        # The volume of a liquid changes by steps of up to 2 %: at most 0.2 % of the charge, 0.2 mol/L.
        least = 4e-4 if name == "snar" else 1e-6
        assert row.chemlab == pytest.approx(row.independent, rel=2e-3, abs=least), row.quantity


def test_fischer_comes_to_the_published_equilibrium_and_conversion() -> None:
    judged = {row.quantity: row for row in rows_of("fischer")}
    for quantity, row in judged.items():
        if quantity.startswith("ester of"):
            assert row.chemlab == pytest.approx(row.published, abs=0.015), quantity
    # Volumes add up here, so that the charge is thinner than it is said to be, and a little slower.
    assert judged["conversion of the acid after 120 min at 100 C"].chemlab == pytest.approx(0.35, abs=0.03)
    assert judged["conversion of the acid after 100000 min at 100 C"].chemlab == pytest.approx(0.54, abs=0.02)
    # What makes the equilibrium follow the temperature, by formation enthalpies, against a calorimeter.
    assert judged["heat of esterification"].independent == pytest.approx(-3.6, abs=0.5)
    for quantity, row in judged.items():
        if "azeotrope" in quantity:
            assert row.chemlab == pytest.approx(row.published, abs=1.5 if row.unit == "K" else 0.03), quantity


def test_benzoic_acid_follows_the_base_into_water_and_leaves_it_with_the_acid() -> None:
    judged = {row.quantity: row for row in rows_of("benzoic")}
    assert judged["solubility in water at 25 C"].chemlab == pytest.approx(0.0278, rel=0.1)
    assert judged["acid that 0.36 mol of sodium bisulfate gives back of 0.25 mol"].chemlab > 0.93


def test_water_takes_aspirin_and_the_anhydride_apart_as_fast_as_was_measured() -> None:
    for row in rows_of("aspirin"):
        assert row.chemlab == pytest.approx(row.published, rel=0.05), row.quantity


def test_snar_follows_the_published_profile() -> None:
    """Which is with one amine to a substitution: they differ the less the more amine there is."""
    rows = [row for row in rows_of("snar") if "ortho" in row.quantity and "5 equivalents" in row.quantity]
    assert [row.chemlab for row in rows] == pytest.approx([row.published for row in rows], rel=0.12)
    assert len(rows) == 6


def test_what_rounding_leaves_of_a_liquid_is_none() -> None:
    """Traces in a dry vessel, and crystals put in: concentrations in 8e-14 litres are too stiff."""
    batch = ExperimentBatch("aspirin", "rxn")
    batch.reset(batch.members)
    row, layout = batch.shelf.rows[batch.experiments.places[0, 0]], batch.shelf.layout
    row[AMOUNTS:] = 0.0
    traces = {"salicylic_acid": 4.4e-22, "acetic_anhydride": 2.7e-28, "water": 4.2e-12, "acetic_acid": 4.3e-22}
    for name, mol in {**traces, "acetylsalicylic_acid": 1.482e-12}.items():
        row[AMOUNTS + layout.index(name)] = mol
        place = AMOUNTS + len(layout.materials) + 2 * layout.dissolved.index(name)
        row[place] = 1.2e-15 if name == "acetylsalicylic_acid" else mol
    batch.experiments.jacket[:] = row[TEMPERATURE] = 298.13
    batch.act(np.array([[1.0, 0.0, 0.598, 0.0]]))
    assert row[AMOUNTS + layout.index("salicylic_acid")] == pytest.approx(0.1794)
