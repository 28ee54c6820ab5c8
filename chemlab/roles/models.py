"""Physics models of a user's own, which a scenario names as ``benches.KEY.model`` in place of chemlab's."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ..config.datafile import DataError
from ..config.parts import PartError, blamed, checked_numbers, load_part
from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray

_CONSERVED = 1e-6
"""Maximum relative error of atoms in a user's integrator."""


class ReactionModel(Protocol):
    """A callable with this signature replaces the kinetics of reaction benches."""

    def __call__(self, amount_mol: FloatArray, temperature_k: float, volume_l: float, dt: float) -> FloatArray:
        """Return amounts [M] (mol, in the order of ``scenario.materials``) after ``dt`` at constant T and volume."""


class SeparationModel(Protocol):
    """An object with these two methods replaces layers and partition on extraction and distillation benches.

    L solvents, K dissolvable materials, C layers. A model receives the inputs of the built-in one.
    """

    def partition(
        self,
        dissolved_mol: FloatArray,
        total_mol: FloatArray,
        solvent_volume_l: FloatArray,
        clock_before: float,
        clock_after: float,
    ) -> FloatArray:
        """Return dissolved amounts [K, L] at ``clock_after``; row k must add up to ``total_mol[k]`` [K]."""

    def profile(self, volume_l: FloatArray, density_kg_l: FloatArray, clock: float, pixels: int) -> FloatArray:
        """Return the share [C, pixels] of each layer in each pixel, bottom first.

        ``volume_l`` [C] and ``density_kg_l`` [C] are those of the solids (density 0: they are at the bottom), the fluid
        layers, densest first, and air. Each pixel's shares add up to 1, each layer's pixels to its share of the volume.
        """


def load_model(scenario: Scenario, bench: str, methods: tuple[str, ...]) -> Any:
    """Load the physics model of a bench; a class is called with the scenario.

    Args:
        scenario: names the model.
        bench: key of the bench.
        methods: methods that a model of this kind of bench has.

    Returns:
        The model, or None where the scenario names none.

    Raises:
        DataError: the bench takes no model, or the model cannot be loaded or lacks a method.
        PartError: the class of the model cannot be called with the scenario.
    """
    name, key = scenario.benches[bench].model, f"benches.{bench}.model"
    if name is None:
        return None
    if not methods:
        raise DataError(f"{scenario.origin}: {key}: a bench of kind {scenario.benches[bench].kind!r} has no model")
    model = load_part(name, scenario, key)
    if isinstance(model, type):
        with blamed(f"{scenario.origin}: {key}: {name}"):
            model = model(scenario)
    lacking = [method for method in methods if not callable(getattr(model, method, None))]
    if lacking:
        raise DataError(
            f"{scenario.origin}: {key}: {name!r} has no {lacking[0]}(), which a model of a bench of kind "
            f"{scenario.benches[bench].kind!r} needs"
        )
    return model


def checked_reaction(
    model: ReactionModel,
    name: str,
    amounts: FloatArray,
    temperature: float,
    volume: float,
    dt: float,
    elements: FloatArray,
) -> FloatArray:
    """Call a user's reaction model and validate its result.

    Args:
        model: the user's model.
        name: where a scenario names it, for error messages.
        amounts: [M] mol before.
        temperature: temperature in K.
        volume: liquid volume in L.
        dt: reaction time.
        elements: [E, M] atoms of each element (and charge) in each material.

    Raises:
        PartError: the model fails, or returns a wrong shape, or amounts that are negative, not finite, or do not
            conserve atoms.
    """
    with blamed(name):
        returned = model(amounts.copy(), temperature, volume, dt)
    result = checked_numbers(returned, amounts.shape, name)
    if result.min(initial=0.0) < -1e-9:
        at = int(result.argmin())
        raise PartError(f"{name}: must not be negative; given {result[at]:g} at [{at}]")
    before, after = elements @ amounts, elements @ result
    worst = float(np.abs(after - before).max(initial=0.0))
    if worst > _CONSERVED * max(1.0, float(np.abs(before).max(initial=0.0))):
        raise PartError(f"{name}: does not conserve atoms: {worst:.3g} mol of an element too many or few")
    return np.maximum(result, 0.0)
