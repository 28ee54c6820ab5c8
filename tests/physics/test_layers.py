"""Layers: the profile conserves volume for every vessel, has the design's limits and slopes; the camera samples it."""

from collections.abc import Mapping

import numpy as np
import pytest
from helpers import PIXELS, Glassware, four_solvents, molar_volume
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from chemlab.kernels.arrays import FloatArray
from chemlab.physics.chemistry import CLOCK, PRESENT
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX
from chemlab.physics.stratification import camera

GLASS = Glassware("wurtz_dodecane", 1)
FOUR = Glassware(four_solvents(), 1)
FICTITIOUS = Glassware("fictitious", 1)


def densities(glass: Glassware, names: list[str]) -> list[float]:
    return [glass.scenario.materials[name].density_kg_l for name in names]


def expected_volumes(glass: Glassware, names: list[str], capacity: float) -> list[float]:
    """Litres of each column: a solvent with what is dissolved in it, or a liquid alone, the solids, the rest is air."""
    solvents = [name for name in names if name in glass.layout.solvents]
    volumes = []
    for name in names[1:-1]:
        litres = glass.volume(0, name)
        for k, solute in enumerate(glass.layout.dissolved if name in solvents else ()):
            layer = glass.layout.solvents.index(name)
            litres += glass.dissolved(0)[k, layer] * molar_volume(glass.scenario, solute)
        volumes.append(litres)
    solid = [n for n, m in glass.scenario.materials.items() if m.role == "solid" or (m.role == "ion" and not solvents)]
    solids = sum(glass.volume(0, name) for name in solid)
    return [solids, *volumes, max(capacity - solids - sum(volumes), 0.0)]


def stacked(volumes: list[float]) -> FloatArray:
    """Each column's overlap with each pixel where the columns lie one above the other."""
    edges = np.concatenate(([0.0], np.cumsum(volumes))) / sum(volumes) * PIXELS
    low, high = edges[:-1, None], edges[1:, None]
    bottom = np.arange(PIXELS)
    return np.clip(np.minimum(high, bottom + 1.0) - np.maximum(low, bottom), 0.0, None)


def check_profile(glass: Glassware, contents: Mapping[str, float], capacity: float, clock: float) -> None:
    glass.fill(0, contents, capacity, clock=clock)
    glass.phases(0)
    glass.partition(0)
    names, shares = glass.profile(0)
    assert names[0] == "solids"
    assert names[-1] == "air"
    present = {n for n in glass.layout.materials if glass.amount(0, n) > 1e-12}
    solvents = present & set(glass.layout.solvents)
    liquids = solvents or {n for n in present if glass.scenario.materials[n].role == "solute"}
    assert set(names[1:-1]) == liquids
    fluid_densities = densities(glass, names[1:])
    assert fluid_densities == sorted(fluid_densities, reverse=True)
    volumes = expected_volumes(glass, names, capacity)
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(shares.mean(axis=1), np.array(volumes) / sum(volumes), rtol=0.0, atol=1e-9)


amounts = st.one_of(
    st.just(0.0),
    st.floats(0.01, 3.0),
    st.floats(-12.0, -2.0).map(lambda power: 10.0**power),  # down to less than a thousandth of a pixel
)
clocks = st.one_of(
    st.sampled_from([T_MIX, T_MIX + 1e-6, CLOCK_SETTLED - 1e-6, CLOCK_SETTLED]), st.floats(T_MIX, CLOCK_SETTLED)
)


@given(
    st.dictionaries(
        st.sampled_from(["water", "diethyl_ether", "hexane", "ethyl_acetate", "dodecane", "1-chlorohexane", "NaCl"]),
        amounts,
        min_size=3,
    ),
    st.one_of(st.just(1.0), st.floats(0.02, 1.0)),
    clocks,
)
@settings(max_examples=200)
def test_profile_conserves_volume_with_four_solvents(contents: dict[str, float], full: float, clock: float) -> None:
    """The same with up to four solvent layers and what is dissolved in them."""
    litres = sum(mol * molar_volume(FOUR.scenario, name) for name, mol in contents.items())
    if litres < 1e-6:
        litres, contents = 1.0, {}
    check_profile(FOUR, contents, litres / full, clock)


@pytest.mark.parametrize(
    ("mol", "capacity", "clock"),
    [
        ((0.00025, 0.00026, 0.01165, 0.0, 0.0, 0.00015, 0.6925, 0.0, 0.0), 1.121, 3.712),
        ((1.414, 0.01, 0.073, 0.0012, 0.084, 0.00144, 0.2275, 3e-4, 1e-4), 2.508, 4.289),
        ((1.016e-4, 0.2136, 0.8647, 0.826, 0.3518, 0.4001, 0.2535, 0.5186, 6.445e-4), 1.093, 4.373),
        ((0.0061621, 0.017538, 0.019458, 0.028493, 0.58966, 1.9817, 0.0010992, 0.26272, 0.0014615), 1.1049, 4.255),
        ((2.4e-8, 4.07, 1.03, 0.137, 0.58, 0.0146, 0.0, 3.21e-8, 3.04), 4.08, 4.38),
        ((4.2865e-11, 0.0, 1.9318e-9, 0.0, 0.0, 0.0, 3.9534, 0.0, 5.8846e-11), 0.57114, 4.3879),
    ],
)
def test_profile_conserves_volume_with_thin_layers(mol: tuple[float, ...], capacity: float, clock: float) -> None:
    """The same where layers thinner than a pixel lie between thick ones, with sharp boundaries."""
    contents = {name: amount for name, amount in zip("IHEGFBCAD", mol, strict=True) if amount}
    check_profile(FICTITIOUS, contents, capacity, clock)


def test_fully_mixed_vessel_shows_the_same_fluid_everywhere() -> None:
    """At t_mix every pixel above the solids has the fluids in the proportion of their volumes, air included."""
    FOUR.mixed(0, {"water": 8.0, "hexane": 1.0, "ethyl_acetate": 2.0, "dodecane": 0.3, "NaCl": 20.0}, 1.7)
    names, shares = FOUR.profile(0)
    volumes = np.array(expected_volumes(FOUR, names, 1.7))
    assert volumes[0] > 0.05 * 1.7  # there are solids, of five pixels and more
    above = int(np.ceil(volumes[0] / 1.7 * PIXELS))
    expected = volumes[1:] / volumes[1:].sum()
    np.testing.assert_allclose(shares[1:, above:], np.repeat(expected[:, None], PIXELS - above, axis=1), atol=1e-12)
    assert shares[0, above:].max() == 0.0
    assert shares[0, : above - 1].min() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    "contents",
    [
        {"water": 8.0, "diethyl_ether": 3.0, "NaCl": 1.0, "dodecane": 0.2},
        {"1-chlorohexane": 1.0, "dodecane": 0.7, "5-methylundecane": 0.6, "4,5-diethyloctane": 0.9, "NaOH": 2.0},
        {"2-chlorohexane": 1.0, "3-chlorohexane": 2.0, "dodecane": 0.1},
        {"NaCl": 3.0},
        {"water": 3.0},
        {},
    ],
    ids=["two solvents", "no solvent", "equal densities", "solids", "one solvent", "air"],
)
def test_fully_settled_vessel_is_stacked(contents: dict[str, float]) -> None:
    """At the end of the clock every layer fills exactly its interval of heights, densest lowest, solids below all."""
    GLASS.fill(0, contents, 1.3, clock=CLOCK_SETTLED)
    GLASS.phases(0)
    GLASS.partition(0)
    names, shares = GLASS.profile(0)
    fluids = densities(GLASS, names[1:])
    assert fluids == sorted(fluids, reverse=True)
    np.testing.assert_allclose(shares, stacked(expected_volumes(GLASS, names, 1.3)), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("since_mixed", [0.2, 1.0, 2.0, 3.0])
@pytest.mark.parametrize(
    "contents",
    [{"water": 12.0}, {"diethyl_ether": 6.0}, {"dodecane": 2.0, "1-chlorohexane": 3.0}, {"water": 9.0, "hexane": 3.0}],
    ids=["water", "ether", "no solvent", "two solvents"],
)
def test_layers_part_with_the_designs_slope(contents: dict[str, float], since_mixed: float) -> None:
    """Of any two fluids the log ratio of their shares is linear in height with slope (mu_i - mu_j) / sigma^2."""
    clock = T_MIX + since_mixed
    FOUR.fill(0, contents, 1.3, clock=clock)
    FOUR.partition(0)
    names, shares = FOUR.profile(0)
    fluids, height, compared = names[1:], (np.arange(PIXELS) + 0.5) / PIXELS, 0
    density = densities(FOUR, fluids)
    mean = [since_mixed * sum(other - own for other in density) for own in density]
    for i in range(len(fluids)):
        for j in range(i):
            both = (shares[1 + i] > 1e-12) & (shares[1 + j] > 1e-12)
            ratio = np.log(shares[1 + i, both] / shares[1 + j, both])
            steps = np.diff(ratio) / np.diff(height[both])
            expected = (mean[i] - mean[j]) * np.sqrt(2.0 * np.pi) * np.exp(clock)  # PHYSICS, section 2
            assert expected > 0.0  # columns go from dense to light: the lighter one wins with height
            np.testing.assert_allclose(steps, expected, rtol=1e-4)
            compared += both.sum()
    assert compared > 10 * len(fluids)


def pictures(glass: Glassware, seed: int, number: int) -> FloatArray:
    """[number, pixels] of the vessel, one after the other from one stream."""
    glass.profile(0)
    stream, out = np.array([seed], dtype=np.uint64), np.zeros((number, PIXELS))
    for picture in out:
        camera(glass.rows[0], glass.shares, glass.layers, glass.chem, stream, picture)
    return out


@pytest.mark.parametrize("since_mixed", [0.0, 0.7, 1.5])
def test_camera_samples_the_profile(since_mixed: float) -> None:
    """Over 1500 pictures each grey value comes up in each pixel as often as the profile says (chi-square, 1e-6)."""
    number = 1500
    GLASS.fill(0, {"water": 10.0, "diethyl_ether": 3.0, "NaCl": 4.0}, 0.9, clock=T_MIX + since_mixed)
    GLASS.partition(0)  # the salt is left undissolved here: a layer of one solid
    names, shares = GLASS.profile(0)
    seen = pictures(GLASS, 7, number)
    shades = [GLASS.scenario.materials[n if n != "solids" else "NaCl"].shade for n in names]
    assert len(set(shades)) == len(shades)
    counts = np.stack([(seen == shade).sum(axis=0) for shade in shades])
    assert (counts.sum(axis=0) == number).all()  # every pixel shows one of the layers
    assert counts[shares < 1e-12].sum() == 0
    expected = shares * number
    likely = expected > 5.0
    statistic = ((counts - expected)[likely] ** 2 / expected[likely]).sum()
    freedom = int((likely.sum(axis=0) - 1).clip(min=0).sum())
    assert freedom > 50
    assert chi2.sf(statistic, freedom) > 1e-6
    assert (pictures(GLASS, 7, 2) == seen[:2]).all()
    assert (pictures(GLASS, 8, 2) != seen[:2]).any()


def test_camera_shows_solids_by_volume() -> None:
    """Of two solids in a pixel each is shown as often as its share of the solids' volume (binomial, 5 sigma)."""
    GLASS.fill(0, {"NaCl": 10.0, "NaOH": 20.0}, 0.5)
    solids = GLASS.volume(0, "NaCl", "NaOH")
    share = GLASS.volume(0, "NaCl") / solids
    seen = pictures(GLASS, 3, 200)[:, : int(solids / 0.5 * PIXELS)]
    salt, base = (GLASS.scenario.materials[name].shade for name in ("NaCl", "NaOH"))
    assert np.isin(seen, [salt, base]).all()
    spread = np.sqrt(share * (1.0 - share) / seen.size)
    assert (seen == salt).mean() == pytest.approx(share, abs=5.0 * spread)


def test_layers_of_real_have_the_shade_of_their_contents() -> None:
    """Their grey values, by volume, add up to those of the materials, though each layer holds some of both."""
    glass = Glassware("wurtz_real")
    glass.fill(0, {"water": 20.0, "diethyl_ether": 4.0}, 0.9)
    glass.partition(0)
    _, upper, lower = np.unique(pictures(glass, 7, 300))
    shades = {name: glass.scenario.materials[name].shade for name in ("water", "diethyl_ether")}
    assert shades["diethyl_ether"] < upper < lower < shades["water"]
    _, wet, organic, _ = glass.profile(0)[1].sum(axis=1) / PIXELS * 0.9
    expected = sum(shade * glass.volume(0, name) for name, shade in shades.items())
    assert wet * lower + organic * upper == pytest.approx(expected, rel=1e-6)


def test_no_vessel_is_black() -> None:
    """Where no vessel stands every pixel is 0, though the stream holds random numbers."""
    GLASS.fill(0, {"water": 10.0}, 0.9)[PRESENT] = 0.0
    names, _ = GLASS.profile(0)
    assert names == []
    assert (pictures(GLASS, 1, 3) == 0.0).all()


def test_profile_leaves_the_vessel_alone() -> None:
    """Looking at the layers changes nothing in the vessel, bit for bit."""
    row = GLASS.mixed(0, {"water": 10.0, "diethyl_ether": 3.0, "NaCl": 1.0}, 0.9)
    row[CLOCK] = 0.3
    GLASS.partition(0)
    before = row.copy()
    pictures(GLASS, 5, 2)
    assert (row == before).all()
