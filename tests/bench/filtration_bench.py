"""A bench of a user's own, for test_custom_bench: a funnel that lets liquids through and keeps solids back.

It is written as a user would write one: numpy alone, no kernel, nothing of chemlab's but what a bench needs.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.physics.chemistry import AMOUNTS, CAPACITY, ROLE_SOLID, ChemistryTable
from chemlab.physics.shelf import Shelf
from chemlab.roles.bench import Bench, Channel, Experiments, check_discrete

FILTER, END = range(2)


class FiltrationOptions(BaseModel):
    """Scenario keys of the filtration bench."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    auxiliary_capacity_l: float = Field(default=1.2, gt=0.0)


class FiltrationBench(Bench):
    """Filtration bench: ``filter`` moves all liquids, with what they dissolve, from the funnel to the filtrate."""

    options_model = FiltrationOptions
    positions = ("funnel", "filtrate")

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        super().__init__(key, scenario, chemistry)
        layout, known = self.layout, self.known
        # Of a row's contents (amounts, then dissolved amounts) everything but solids runs through.
        dissolved = layout.width - AMOUNTS - len(layout.materials)
        self._runs_through = np.concatenate((known.role != ROLE_SOLID, np.ones(dissolved, dtype=np.bool_)))
        channels = [
            Channel(f"fill_{name}", 1, "fraction", 0.0, 1.0, f"how full the {name} is") for name in self.positions
        ]
        self._set_spaces(channels, gymnasium.spaces.Discrete(2))

    @property
    def action_meanings(self) -> list[str]:
        return ["filter", "end the experiment"]

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.absolute_counts)

    def _wet(self, shelf: Shelf, experiments: Experiments, member: int) -> bool:
        return bool(shelf.rows[experiments.places[member, 0], AMOUNTS:][self._runs_through].any())

    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        for m, action in zip(members, actions, strict=True):
            experiments.events[m] = 0.0
            experiments.illegal[m] = action == FILTER and not self._wet(shelf, experiments, m)
            if action == FILTER and not experiments.illegal[m]:
                funnel, filtrate = (shelf.rows[place, AMOUNTS:] for place in experiments.places[m])
                filtrate[self._runs_through] += funnel[self._runs_through]
                funnel[self._runs_through] = 0.0
            experiments.steps[m] += 1
            experiments.ended[m] = action == END or experiments.steps[m] >= self.spec.step_limit

    def see(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        out[:] = 0.0
        for row, m in zip(out, members, strict=True):
            if experiments.busy[m]:
                vessels = shelf.rows[experiments.places[m]]
                amounts = vessels[:, AMOUNTS : AMOUNTS + len(self.layout.materials)]
                row[:2] = np.minimum(amounts @ self.known.molar_volume / vessels[:, CAPACITY], 1.0)
                row[2 + experiments.goal[m]] = 1.0

    def mask(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: MaskArray) -> None:
        for row, m in zip(out, members, strict=True):
            row[FILTER] = experiments.busy[m] and self._wet(shelf, experiments, m)
            row[END] = 1

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return np.array([check_discrete(agent, action, 2)])
