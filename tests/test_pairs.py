"""Activity coefficients: NRTL, pair files and refusals, bundled pairs against UNIFAC and measured azeotropes."""

import csv
import itertools
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import script
from refusals import changed, refused

from chemlab.config.datafile import DataError
from chemlab.config.materials import shipped_materials
from chemlab.config.pairs import Pair, load_pairs, log_activity_coefficients, pair_table, shipped_pairs

ROOT = Path(__file__).parent.parent
MOLECULES = sorted(key for key, m in shipped_materials().items() if m.role in ("solvent", "solute") and m.real)

FILE = """
pairs = [
    { of = ["a", "b"], a = [1.0, 2.0], b = [10.0, 20.0], alpha = 0.3, low_k = 250.0, high_k = 400.0, error = 0.1, source = "made up" },
    { of = ["c", "b"], a = [3.0, 4.0], b = [30.0, 40.0], c = [0.5, 0.25], alpha = 0.2, low_k = 250.0, high_k = 400.0, error = 0.1, source = "made up" },
    { of = ["a", "c"], a = [5.0, 6.0], b = [50.0, 60.0], alpha = 0.4, low_k = 250.0, high_k = 400.0, error = 0.1, source = "made up" },
]

[lock]
made = "by hand"
"""  # noqa: E501


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "pairs.toml"
    path.write_text(FILE)
    return path


def test_two_materials_at_infinite_dilution_follow_the_closed_form() -> None:
    # ln gamma_1 = tau_21 + tau_12 exp(-alpha tau_12)
    tau = np.array([[0.0, 0.7], [1.9, 0.0]])
    dilute = log_activity_coefficients(np.array([0.0, 1.0]), tau, np.array(0.3))
    assert dilute[0] == pytest.approx(1.9 + 0.7 * math.exp(-0.3 * 0.7), abs=1e-14)
    assert dilute[1] == pytest.approx(0.0, abs=1e-14)


def test_activity_coefficients_obey_gibbs_and_duhem() -> None:
    # sum_i x_i d ln gamma_i = 0 along any way through a mixture.
    generator = np.random.default_rng(5)
    tau = generator.normal(0.0, 1.0, (4, 4)) * (1.0 - np.eye(4))
    alpha = generator.uniform(0.1, 0.4, (4, 4))
    alpha = (alpha + alpha.T) / 2.0
    x = np.array([0.1, 0.2, 0.3, 0.4])
    way = 1e-5 * np.array([1.0, -2.0, 0.5, 0.5])
    change = log_activity_coefficients(x + way, tau, alpha) - log_activity_coefficients(x - way, tau, alpha)
    assert abs(float(x @ change)) < 1e-12 < float(np.abs(change).max())


def test_activity_coefficients_are_those_of_another_library() -> None:
    thermo = pytest.importorskip("thermo", reason='thermo is not installed: pip install ".[test]"')
    generator = np.random.default_rng(3)
    tau = generator.normal(0.5, 1.0, (5, 5)) * (1.0 - np.eye(5))
    alpha = np.full((5, 5), 0.3) * (1.0 - np.eye(5))
    x = generator.dirichlet(np.ones(5))
    other = thermo.NRTL(T=300.0, xs=x.tolist(), tau_as=tau.tolist(), alpha_cs=alpha.tolist())
    np.testing.assert_allclose(log_activity_coefficients(x, tau, alpha), np.log(other.gammas()), rtol=1e-12)


def test_a_table_has_every_parameter_at_its_place(file: Path) -> None:
    table = pair_table(["b", "a", "c"], load_pairs([file]))
    np.testing.assert_array_equal(table.a, [[0, 2, 4], [1, 0, 5], [3, 6, 0]])
    np.testing.assert_array_equal(table.b, [[0, 20, 40], [10, 0, 50], [30, 60, 0]])
    np.testing.assert_array_equal(table.c, [[0, 0, 0.25], [0, 0, 0], [0.5, 0, 0]])
    np.testing.assert_array_equal(table.alpha, [[0, 0.3, 0.2], [0.3, 0, 0.4], [0.2, 0.4, 0]])
    tau = table.tau(360.0)
    assert tau[2, 0] == pytest.approx(3.0 + 30.0 / 360.0 + 0.5 * math.log(1.2))
    assert (tau[2, 0], tau[0, 2]) == pytest.approx(load_pairs([file])[frozenset("bc")].tau(360.0))
    other = file.with_name("mine.toml")
    rows = FILE.splitlines()
    other.write_text("\n".join([rows[1], rows[2].replace("alpha = 0.3", "alpha = 0.25"), *rows[5:]]))
    pairs = load_pairs([file, other])  # where the later one replaces what the earlier one says
    assert (len(pairs), pairs[frozenset("ab")].alpha, pairs[frozenset("bc")].alpha) == (3, 0.25, 0.2)


def test_a_missing_pair_is_named_with_what_makes_it(file: Path) -> None:
    parts = ("'a' with 'd', 'b' with 'd'", "chemlab data pairs 'a' 'b' 'd' -o", "pair_files")
    refused(lambda: pair_table(["a", "b", "d"], load_pairs([file])), *parts)
    with pytest.raises(DataError, match="'d' with 'e', 'd' with 'f', 'd' with 'g' and 3 more"):
        pair_table(["d", "e", "f", "g"], {})


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('of = ["c", "b"]', 'of = ["b", "a"]', ["'a' with 'b' is listed twice"]),
        ('of = ["c", "b"]', 'of = ["c", "c"]', ["pairs.1", "two different materials"]),
        ("c = [0.5, 0.25]", "c = [0.5]", ["pairs.1.c"]),
        ("alpha = 0.2", "alpha = 0.0", ["pairs.1.alpha", "0.01"]),
        ("b = [30.0, 40.0]", "b = [90000.0, 40.0]", ["pairs.1", "tau is beyond 100 at 250.0 K"]),
        ("alpha = 0.2, low_k = 250.0", "alpha = 0.2, low_k = 450.0", ["pairs.1", "must be above low_k = 450.0"]),
        ("c = [0.5, 0.25]", "d = [0.5, 0.25]", ["pairs.1.d", "unknown key"]),
    ],
)
def test_a_wrong_pair_is_refused(file: Path, old: str, new: str, parts: list[str]) -> None:
    file.write_text(changed(FILE, old, new))
    refused(lambda: load_pairs([file]), file, *parts)


def test_every_two_shipped_molecules_are_a_pair() -> None:
    assert set(shipped_pairs()) == {frozenset(two) for two in itertools.combinations(MOLECULES, 2)}
    assert np.isfinite(pair_table(MOLECULES, shipped_pairs()).tau(298.15)).all()


def log_gamma(pair: Pair, temperature: float, x: float) -> np.ndarray:
    """ln gamma of both at mole fraction x of the first."""
    one, other = pair.tau(temperature)
    return log_activity_coefficients(np.array([x, 1.0 - x]), np.array([[0.0, one], [other, 0.0]]), np.array(pair.alpha))


MISCIBLE = [
    ("diethyl_ether", "dodecane"),
    ("diethyl_ether", "1-chlorohexane"),
    ("1-chlorohexane", "dodecane"),
    ("2-chlorohexane", "dodecane"),
    ("diethyl_ether", "hexane"),
    ("diethyl_ether", "ethanol"),
    ("diethyl_ether", "toluene"),
    ("ethyl_acetate", "ethanol"),
    ("ethyl_acetate", "toluene"),
    ("acetic_acid", "water"),
]
OILS = ("hexane", "dodecane", "1-chlorohexane", "2-chlorohexane", "1-hexene", "toluene")
APART = [(oil, "water") for oil in OILS]


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """A script of ``studies/physics/``, of which ``mixtures`` knows UNIFAC and uses nothing of chemlab's."""
    pytest.importorskip("thermo", reason='thermo is not installed: pip install ".[test]"')
    monkeypatch.syspath_prepend(str(ROOT / "studies" / "physics"))
    return lambda name: script(f"studies/physics/{name}.py")


def oriented(one: str, other: str, temperature: float, x: float) -> np.ndarray:
    """ln gamma of ``one`` and ``other`` by the shipped pair, whichever of them it names first."""
    pair = shipped_pairs()[frozenset((one, other))]
    return log_gamma(pair, temperature, x) if pair.of[0] == one else log_gamma(pair, temperature, 1.0 - x)[::-1]


def test_stored_cuts_are_those_of_the_bench(study: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a folder of runs, the rows of trained agents stay as they are."""
    front, written = study("front"), []
    with front.TABLE.open(encoding="utf-8", newline="") as file:
        stored = [list(row.values()) for row in csv.DictReader(file) if row["at"] == "400" or row["by"] == "PPO"]
    monkeypatch.setattr(front, "CUTS_K", np.array([400.0]))
    monkeypatch.setattr(front, "write", lambda _, __, rows: written.extend(rows))
    monkeypatch.setattr(front, "draw", lambda _: None)
    monkeypatch.setattr(sys, "argv", ["front.py"])
    front.main()
    for row, old in zip(written, stored, strict=True):
        assert row[:2] == old[:2]
        assert list(map(float, row[2:])) == pytest.approx(list(map(float, old[2:])), abs=5e-4)


def test_activity_coefficients_are_those_of_unifac(study: Callable[[str], Any]) -> None:
    """By the form that a pair names as its source; of what stays apart, those at infinite dilution."""
    unifac = study("mixtures").activity_coefficients
    inside, ends = (0.05, 0.3, 0.6, 0.9), (1e-10, 1.0 - 1e-10)
    for one, other in MISCIBLE + APART:
        source = shipped_pairs()[frozenset((one, other))].source
        assert source in ("UNIFAC (Dortmund)", "UNIFAC")
        for kelvin, x in itertools.product((275.0, 310.0, 360.0, 410.0, 475.0), (*ends, *inside)):
            expected = np.log(unifac((one, other), kelvin, [x, 1.0 - x], dortmund=source != "UNIFAC"))
            off = np.abs(oriented(one, other, kelvin, x) - expected)
            if (one, other) in MISCIBLE:
                assert off.max() < 0.05, (one, other, kelvin, x)
            elif x in ends:
                assert off[0 if x < 0.5 else 1] < 0.2, (one, other, kelvin, x)


# Hydrogen bonds at high dilution, and how they change over 200 K, are beyond NRTL's reach.
BONDING = {
    "ethanol",
    "acetic_acid",
    "acetic_anhydride",
    "acetanilide",
    "benzoic_acid",
    "salicylic_acid",
    "acetylsalicylic_acid",
    "pyrrolidine",
}


def test_stated_errors_are_small() -> None:
    by_unifac = [pair for pair in shipped_pairs().values() if "UNIFAC" in pair.source]
    errors = [pair.error for pair in by_unifac]
    assert (np.median(errors), np.quantile(errors, 0.9), max(errors)) < (0.03, 0.2, 0.5)
    plain = [pair for pair in by_unifac if not BONDING & set(pair.of)]
    assert len(plain) > 120
    assert all(pair.error < (0.2 if "water" in pair.of else 0.05) for pair in plain)


def test_solids_dissolve_as_measured(study: Callable[[str], Any]) -> None:
    solubility = study("solubility")
    assert len({row[:2] for row in solubility.MEASURED}) >= 15
    for solute, solvent, kelvin, measured, _ in solubility.MEASURED:
        x = solubility.solve(solute, solvent, kelvin, solubility.shipped_coefficients)
        assert abs(math.log10(x / measured)) <= 0.12, (solute, solvent, kelvin)


def test_what_shares_out_between_a_solvent_and_water_is_as_measured(study: Callable[[str], Any]) -> None:
    phases, measured = study("mixtures").liquid_phases, study("layers").MEASURED
    for name, (in_water, of_water, _) in measured.items():
        poor, rich = phases(lambda x, name=name: np.exp(oriented(name, "water", 298.15, x)))
        if name in ("diethyl_ether", "ethyl_acetate"):
            assert (poor, 1.0 - rich) == (pytest.approx(in_water, rel=0.06), pytest.approx(of_water, rel=0.06))
        else:
            assert poor < 2e-4
    distribution = study("distribution")
    for (solute, solvent), (log_k, _) in distribution.MEASURED.items():
        found = distribution.log_k(solute, solvent, distribution.saturated(solvent), distribution.shipped_coefficients)
        assert found == pytest.approx(log_k, abs=0.2), (solute, solvent)


def test_the_advised_command_makes_the_shipped_row(tmp_path: Path) -> None:
    pytest.importorskip("thermo", reason='thermo is not installed: pip install ".[test]"')
    if not (ROOT / "studies" / "tools" / "pairs.py").exists():
        pytest.skip("studies/ is in the repository, not in what is installed")
    made = tmp_path / "my_pairs.toml"
    command = [sys.executable, "studies/tools/pairs.py", "diethyl_ether", "dodecane", "--out", str(made)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    (pair,) = load_pairs([made]).values()
    shipped = shipped_pairs()[frozenset(pair.of)]
    for temperature, x in itertools.product((280.0, 400.0), (1e-9, 0.5)):
        mine = log_gamma(pair, temperature, x) if pair.of == shipped.of else log_gamma(pair, temperature, 1.0 - x)[::-1]
        np.testing.assert_allclose(mine, log_gamma(shipped, temperature, x), atol=0.02)
