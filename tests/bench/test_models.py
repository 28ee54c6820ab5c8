"""A user's own physics: agrees where it is the same, changes the result where it differs, is refused where wrong."""

from collections.abc import Callable

import numpy as np
import pytest
from helpers import PIXELS, Glassware, play_experiments
from scipy.integrate import solve_ivp

from chemlab.agents.policies import scripted_bench
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.parts import PartError, strangers_code
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import build_chemistry


class ScipyReactions:
    """The scenario's reactions, integrated by SciPy's BDF."""

    def __init__(self, scenario: Scenario) -> None:
        names = list(scenario.materials)
        self.calls = 0
        self.steps = []
        for step in scenario.family.reaction:
            reactants = {names.index(name): order for name, order in step.orders.items()}
            change = np.zeros(len(names))
            for name, number in step.products.items():
                change[names.index(name)] += number
            for name, number in step.reactants.items():
                change[names.index(name)] -= number
            self.steps.append((reactants, change, step.pre_exponential, step.activation_energy_j_mol))

    def __call__(self, amount_mol: FloatArray, temperature_k: float, volume_l: float, dt: float) -> FloatArray:
        self.calls += 1

        def slope(_: float, amounts: FloatArray) -> FloatArray:
            total = np.zeros_like(amounts)
            for reactants, change, factor, energy in self.steps:
                rate = factor * np.exp(-energy / (8.31446261815324 * temperature_k))
                for i, order in reactants.items():
                    rate *= max(amounts[i] / volume_l, 0.0) ** order
                total += rate * volume_l * change
            return total

        solution = solve_ivp(slope, (0.0, dt), amount_mol, method="BDF", rtol=1e-7, atol=1e-10)
        return np.asarray(np.maximum(solution.y[:, -1], 0.0))


def modelled(name: str, bench: str, model: str) -> Scenario:
    """A shipped scenario with a model of this file at one of its benches."""
    return load_scenario({"base": name, "name": "modelled", "benches": {bench: {"model": f"{__name__}:{model}"}}})


def begun(batch: ExperimentBatch, goal: str | None = None, seed: int = 0) -> ExperimentBatch:
    """A batch of one experiment, at its start."""
    batch.seed(0, seed)
    batch.reset(batch.members, None if goal is None else batch.scenario.goals.index(goal))
    return batch


def recipe(steps: int, size: int) -> FloatArray:
    """[steps, size] actions: warm up, add a third of everything that is left for six steps, then wait."""
    actions = np.full((steps, size), 0.5)
    actions[:, 0] = 0.8
    actions[:, 2:] = 0.0
    actions[:6, 2:] = 1.0 / 3.0
    return actions


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "fictitious"])
def test_a_reaction_model_of_the_same_network_gives_the_same_amounts(scenario: str) -> None:
    """SciPy's BDF in place of the kernel, through a whole experiment: final amounts within 1e-3 (1e-3 mol + 0.1 %)."""
    specs = (scenario, modelled(scenario, "rxn", "ScipyReactions"))
    batches = [begun(ExperimentBatch(spec, "rxn"), seed=3) for spec in specs]
    for batch in batches:
        for action in recipe(20, batch.bench.action_space.shape[0]):
            batch.act(action[None])
    assert batches[1].bench.model.calls == 20
    built_in, own = (batch.shelf.amounts[0, 0] for batch in batches)
    names = batches[0].shelf.layout.materials
    assert own[names.index("dodecane" if scenario == "wurtz_dodecane" else "F")] > 0.1
    np.testing.assert_allclose(own, built_in, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(*(batch.finish(batch.members) for batch in batches), rtol=0.0, atol=1e-3)


SEEN: list[tuple[float, float, float]] = []


def inert(amount_mol: FloatArray, temperature_k: float, volume_l: float, dt: float) -> FloatArray:
    SEEN.append((temperature_k, volume_l, dt))
    return amount_mol


def test_a_reaction_model_is_told_temperature_volume_and_tick() -> None:
    """A model that does nothing sees kelvins, litres of liquid and the scenario's tick, and nothing happens."""
    batch = begun(ExperimentBatch(modelled("wurtz_dodecane", "rxn", "inert"), "rxn"))
    SEEN.clear()
    batch.act(np.array([[1.0, 0.5, 1.0, 0.0, 0.0, 1.0]]))
    glass = Glassware("wurtz_dodecane", 1)
    glass.fill(0, {"diethyl_ether": 4.0, "1-chlorohexane": 1.0})
    assert [(pytest.approx(298.15 + 15.0), pytest.approx(glass.volume(0), rel=1e-9), 0.008)] == SEEN
    vessel = batch.shelf.vessel(0, 0).amounts()
    assert vessel == pytest.approx({"diethyl_ether": 4.0, "1-chlorohexane": 1.0, "Na": 3.0})


GARBAGE: dict[str, Callable[[FloatArray], FloatArray]] = {
    "negative": lambda amounts: amounts - 1.0,
    "not finite": lambda amounts: np.where(amounts > 0.0, np.inf, amounts),
    "no number": lambda amounts: amounts * np.nan,
    "too short": lambda amounts: amounts[:-1],
    "out of nothing": lambda amounts: amounts + 0.1,
    "an error": lambda amounts: amounts[99:][0],
}


@pytest.mark.parametrize("kind", GARBAGE)
def test_a_reaction_model_that_returns_garbage_is_refused(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A PartError that names the scenario's key and the model."""

    def spoilt(amounts: FloatArray, *others: float) -> FloatArray:
        return GARBAGE[kind](amounts)

    monkeypatch.setitem(globals(), "inert", spoilt)
    batch = begun(ExperimentBatch(modelled("wurtz_dodecane", "rxn", "inert"), "rxn"))
    with pytest.raises(PartError, match=r"benches\.rxn\.model: test_models:inert: (must|does|IndexError: )"):
        batch.act(np.array([[0.5, 0.5, 1.0, 0.0, 0.0, 1.0]]))


class IdealSeparation:
    """Every solute is wholly in the solvent nearest to it in polarity, and layers are always fully settled."""

    def __init__(self, scenario: Scenario) -> None:
        self.partitions = self.profiles = 0
        materials, layout = scenario.materials, build_chemistry(scenario).layout
        self.gap = np.array(
            [[abs(materials[k].polarity - materials[s].polarity) for s in layout.solvents] for k in layout.dissolved]
        )

    def partition(
        self,
        dissolved_mol: FloatArray,
        total_mol: FloatArray,
        solvent_volume_l: FloatArray,
        before: float,
        after: float,
    ) -> FloatArray:
        self.partitions += 1
        nearest = np.where(solvent_volume_l > 0.0, self.gap, np.inf).argmin(axis=1)
        result = np.zeros_like(dissolved_mol)
        result[np.arange(len(nearest)), nearest] = total_mol
        return result

    def profile(self, volume_l: FloatArray, density_kg_l: FloatArray, clock: float, pixels: int) -> FloatArray:
        self.profiles += 1
        edges = np.concatenate(([0.0], np.cumsum(volume_l))) / volume_l.sum() * pixels
        bottom = np.arange(pixels)
        overlap = np.minimum(edges[1:, None], bottom + 1.0) - np.maximum(edges[:-1, None], bottom)
        return np.asarray(np.clip(overlap, 0.0, None))


def test_a_separation_model_runs_the_extraction_and_changes_its_result() -> None:
    """With ideal separation one wash takes all dissolved salt and no product: more than the paper's partition gives."""
    scores, batches = [], []
    for spec in ("wurtz_dodecane", modelled("wurtz_dodecane", "ext", "IdealSeparation")):
        batch = begun(ExperimentBatch(spec, "ext"), "5-methylundecane", 1)
        scores.append(float(play_experiments(batch, scripted_bench(batch.bench))[0]))
        batches.append(batch)
    model = batches[1].bench.model
    assert model.partitions > 10
    assert model.profiles > 10
    assert scores[1] > scores[0] + 0.05
    extracted = batches[1].shelf.vessel(0, 0).amounts()
    assert extracted["5-methylundecane"] > 0.95
    salt = min(extracted.get("Na+", 0.0), extracted.get("Cl-", 0.0)) + extracted.get("NaCl", 0.0)
    assert salt < 0.05
    total = batches[1].shelf.total()[0]
    assert total[batches[1].shelf.layout.index("5-methylundecane")] == pytest.approx(1.0, rel=1e-12)


def test_without_solvent_a_separation_model_leaves_nothing_dissolved() -> None:
    """Once all ether has boiled off, the vessel lists no solute as dissolved, as with the built-in separation."""
    for spec in ("wurtz_dodecane", modelled("wurtz_dodecane", "dit", "IdealSeparation")):
        batch = begun(ExperimentBatch(spec, "dit"), "dodecane")
        assert batch.shelf.dissolved[0, 0].sum() == pytest.approx(1.0 + 2.0 * batch.shelf.vessel(0, 0).amounts()["Na+"])
        for _ in range(3):
            batch.act(np.array([batch.bench.action_meanings.index("heat DV, 50 kJ")]))
        assert batch.shelf.vessel(0, 0).amounts() == pytest.approx({"dodecane": 1.0, "NaCl": 1.0})
        assert (batch.shelf.dissolved[0, 0] == 0.0).all()


def swapped(shares: FloatArray) -> FloatArray:
    """Each layer's share of the vessel as it was, but pixels that hold more or less than a pixel."""
    return np.stack([row if i % 2 else row[::-1] for i, row in enumerate(shares)])


def below_zero(shares: FloatArray) -> FloatArray:
    """Row and pixel sums as they were, but negative shares."""
    spoilt, wave = shares.copy(), np.where(np.arange(PIXELS) % 2, 0.5, -0.5)
    spoilt[1] += wave
    spoilt[-1] -= wave
    return spoilt


SPOILT: dict[str, tuple[str, Callable[[FloatArray], FloatArray]]] = {
    "solute lost": ("partition", lambda x: x * 0.5),
    "NaN dissolved": ("partition", lambda x: x * np.nan),
    "wrong shape dissolved": ("partition", lambda x: x[:, :1]),
    # the same totals, but less than nothing in one solvent
    "negative dissolved": ("partition", lambda x: x + np.array([1.0, -1.0] + [0.0] * (x.shape[1] - 2))),
    "volume lost": ("profile", lambda x: x * 0.5),
    "wrong shape profile": ("profile", lambda x: x[:-1]),
    "an error": ("profile", lambda x: x[:, 99:][0, 99]),
    "pixels not filled": ("profile", swapped),
    "negative share": ("profile", below_zero),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_separation_model_that_returns_garbage_is_refused(kind: str) -> None:
    """Ideal separation with one answer spoilt: a PartError that names the scenario's key and the model."""
    method, spoil = SPOILT[kind]
    batch = ExperimentBatch(modelled("wurtz_dodecane", "ext", "IdealSeparation"), "ext")
    model = batch.bench.model
    begun(batch)
    right = getattr(model, method)
    setattr(model, method, lambda *given: spoil(right(*given)))
    with pytest.raises(PartError, match=rf"benches\.ext\.model: test_models:IdealSeparation: {method}\(\): "):
        batch.act(np.array([batch.bench.action_meanings.index("add water to EV, 0.2 L")]))


@pytest.mark.parametrize(
    ("bench", "model", "problem"),
    [
        ("rxn", "nowhere", r"benches\.rxn\.model: cannot load 'test_models:nowhere'"),
        ("ext", "inert", r"benches\.ext\.model: 'test_models:inert' has no partition\(\), which a model of a bench of"),
        ("rxn", "PIXELS", r"'test_models:PIXELS' has no __call__\(\)"),
    ],
)
def test_a_model_that_is_none_is_refused(bench: str, model: str, problem: str) -> None:
    with pytest.raises(DataError, match=problem):
        ExperimentBatch(modelled("wurtz_dodecane", bench, model), bench)


def test_code_of_models_is_run_only_if_it_is_allowed() -> None:
    spec = modelled("wurtz_dodecane", "rxn", "inert")
    needed = r"benches\.rxn\.model: needs the untrusted code 'test_models:inert'"
    with strangers_code(allowed=False), pytest.raises(DataError, match=needed):
        ExperimentBatch(spec, "rxn")
