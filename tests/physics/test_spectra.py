"""Spectra: linear in concentration, clipped to [0, 1], and a linear fit finds every material again."""

import numpy as np
import numpy.typing as npt
import pytest
from helpers import Glassware

from chemlab.config.scenario import Scenario
from chemlab.physics.spectra import spectrum

WAVELENGTHS = np.linspace(200.0, 800.0, 200)


def peaks(scenario: Scenario) -> npt.NDArray[np.float64]:
    """[M, 200] absorption per mol/L: each material's Gaussian peaks, from the data files."""
    basis = np.zeros((len(scenario.materials), len(WAVELENGTHS)))
    for i, material in enumerate(scenario.materials.values()):
        for peak in material.absorption:
            basis[i] += peak.height_l_mol * np.exp(-0.5 * ((WAVELENGTHS - peak.center_nm) / peak.width_nm) ** 2)
    return basis


def seen(glass: Glassware, contents: dict[str, float], capacity: float = 3.0) -> npt.NDArray[np.float64]:
    row, out = glass.fill(0, contents, capacity), np.zeros(200)
    spectrum(row, glass.chem, out)
    return out


def chemicals(scenario: Scenario) -> list[str]:
    """Reactants and products of the scenario's reactions."""
    found = [name for step in scenario.family.reaction for name in (*step.reactants, *step.products)]
    return list(dict.fromkeys(found))


def litres_of_liquid(glass: Glassware) -> float:
    return glass.volume(0, *(n for n, m in glass.scenario.materials.items() if m.role not in ("solid", "gas")))


@pytest.mark.parametrize("left_out", [0, 1])
@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "fictitious"])
def test_absorption_is_concentration_times_peaks(scenario: str, left_out: int) -> None:
    """A dilute vessel absorbs the sum over materials of mol per litre of liquid times their peaks."""
    glass = Glassware(scenario, 1)
    there = chemicals(glass.scenario)[left_out:]
    found = seen(glass, {"diethyl_ether": 8.0, **{n: 0.01 * (i + 1) for i, n in enumerate(there)}})
    expected = (glass.amounts(0) / litres_of_liquid(glass)) @ peaks(glass.scenario)
    assert expected.max() < 1.0
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_strong_absorption_is_cut_at_one() -> None:
    """Where concentration times peak exceeds 1 the spectrum is exactly 1, elsewhere it is unchanged."""
    glass = Glassware("wurtz_dodecane", 1)
    found = seen(glass, {"Na": 3.0, "diethyl_ether": 1.0})
    expected = (glass.amounts(0) / litres_of_liquid(glass)) @ peaks(glass.scenario)
    assert expected.max() > 1.5
    assert (found[expected >= 1.0] == 1.0).all()
    np.testing.assert_allclose(found[expected < 1.0], expected[expected < 1.0], rtol=1e-12)


@pytest.mark.parametrize("contents", [{}, {"NaCl": 1.0, "Na": 1.0}], ids=["empty", "dry solids"])
def test_without_liquid_there_is_nothing_to_see(contents: dict[str, float]) -> None:
    """No liquid, no spectrum: zeros."""
    assert (seen(Glassware("wurtz_dodecane", 1), contents) == 0.0).all()
