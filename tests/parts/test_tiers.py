"""A tier of physics from outside: kernels that are given its chemistry follow its laws, and nobody else does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from chemlab.config.datafile import DataError
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.config.scenario import PHYSICS_TIERS as TIERS
from chemlab.config.scenario import Scenario
from chemlab.physics.backends import LAWS, rate_constant
from chemlab.physics.chemistry import AMOUNTS, build_chemistry
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.physics.mass_action import integrate as react
from chemlab.physics.mass_action import react_work_size
from chemlab.physics.shelf import Shelf

TEMPERATURE_K = 320.0


PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "physics-tier.md"


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the page's tier, to the letter; its kernels are compiled once for all tests here."""
    folder = tmp_path_factory.mktemp("laws")
    found = re.search(r"^# file: brisk_laws\.py\n.*?(?=^```$)", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    assert found is not None
    (folder / "brisk_laws.py").write_text(found[0], encoding="utf-8")
    return folder


@pytest.fixture
def brisk(laws: Path, monkeypatch: pytest.MonkeyPatch) -> Scenario:
    """The shipped scenario with the physics of ``brisk_laws.py``, in which every rate constant is twice as large."""
    monkeypatch.syspath_prepend(str(laws))
    monkeypatch.setitem(TIERS, "brisk", "brisk_laws")
    return load_scenario("wurtz_dodecane").model_copy(update={"physics": "brisk"})


def reacted(scenario: Scenario, time: float) -> np.ndarray:
    """[M] mol after some time."""
    shelf = Shelf(build_chemistry(scenario), 1, 1)
    row = shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "1-chlorohexane": 0.7, "3-chlorohexane": 0.4, "Na": 2.0}).row
    work = np.zeros(react_work_size(shelf.known()))
    react(row, shelf.chem(), 0.5, TEMPERATURE_K, time, 1e-10, 1e-13, work)
    return row[AMOUNTS : AMOUNTS + len(shelf.layout.materials)].copy()


@pytest.mark.slow
def test_its_kernels_follow_its_laws(brisk: Scenario) -> None:
    """Twice the rate constants are the same reactions in half the time."""
    paper = load_scenario("wurtz_dodecane")
    fast, slow, long = reacted(brisk, 0.01), reacted(paper, 0.01), reacted(paper, 0.02)
    np.testing.assert_allclose(fast, long, rtol=1e-8, atol=1e-11)
    assert np.abs(fast - slow).max() > 0.01
    # The paper's kernels are what they were, before and after.
    np.testing.assert_array_equal(reacted(paper, 0.01), slow)


def test_nobody_gets_another_tiers_laws_without_compiling_either() -> None:
    tests = [f"{__file__}::{test.__name__}" for test in (test_its_kernels_follow_its_laws, test_a_law_can_be_called)]
    words, plain = [sys.executable, "-m", "pytest", "-n", "0", "-q", *tests], {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(words, env=plain, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout


def test_a_law_can_be_called(brisk: Scenario) -> None:
    tables = {tier: build_chemistry(brisk.model_copy(update={"physics": tier})) for tier in ("paper", "brisk")}
    paper, other = tables["paper"].handles[0], tables["brisk"].handles[0]
    for r, step in enumerate(brisk.family.reaction):
        closed = step.pre_exponential * np.exp(-step.activation_energy_j_mol / (GAS_CONSTANT * TEMPERATURE_K))
        assert rate_constant(r, TEMPERATURE_K, paper) == pytest.approx(closed, rel=1e-13)
        assert rate_constant(r, TEMPERATURE_K, other) == pytest.approx(2.0 * closed, rel=1e-13)


def test_the_scenario_says_which(brisk: Scenario) -> None:
    assert build_chemistry(brisk).tier == "brisk"
    paper = build_chemistry(load_scenario("wurtz_dodecane"))
    assert paper.tier == "paper"
    assert len(paper.structure["laws"]) <= len(LAWS)  # functions of the backend real are not compiled for another
    assert restore_scenario(dump_scenario(brisk), "a copy").physics == "brisk"
    # Defaults are left out.
    assert "physics" not in dump_scenario(load_scenario("wurtz_dodecane"))["scenario"]
    with pytest.raises(DataError, match="unknown backend 'slow'; choose from paper, real, brisk"):
        build_chemistry(brisk.model_copy(update={"physics": "slow"}))
