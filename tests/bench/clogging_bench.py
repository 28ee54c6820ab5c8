"""A bench with an array of its own, for test_custom_bench: its filter clogs, for the rest of an episode."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy.typing as npt
from filtration_bench import FILTER, FiltrationBench

from chemlab.kernels.arrays import Field, FloatArray, IntArray
from chemlab.physics.shelf import Shelf
from chemlab.roles.bench import Experiments


class ClogState(NamedTuple):
    """The state of the filters of N laboratories."""

    clogged: Annotated[FloatArray, Field("N")]
    """[N] filtrations since the episode began"""
    scratch: Annotated[FloatArray, Field("N", kept=False)]


class CloggingBench(FiltrationBench):
    """Counts its filtrations, also beyond the end of an experiment."""

    own_state = (ClogState,)

    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        super().act(shelf, experiments, members, actions)
        experiments.clogged[members] += actions == FILTER
