"""Tables: declared once, and everything else follows."""

import copy
import pickle
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from helpers import refused

from chemlab.kernels.arrays import BoolArray, Field, FloatArray, Handle, IntArray, addresses, declared, merged
from chemlab.kernels.jit import kernel, opened
from chemlab.kernels.tables import Table


class Pots(NamedTuple):
    """N of something."""

    level: Annotated[FloatArray, Field("N K", first=0.5)]
    age: Annotated[IntArray, Field("N", first=-1)]
    kept: Annotated[IntArray, Field("N", first=None)]
    lid: Annotated[BoolArray, Field("B N", first=None, kept=False)]
    scale: Annotated[float, Field("", first=None)]


class More(NamedTuple):
    """What a pot may have besides."""

    spoons: Annotated[IntArray, Field("N 2", first=7)]


@kernel
def _stir(pots: Handle, by: float) -> float:
    mine = opened(Pots, pots)
    total = 0.0
    for n in range(mine.level.shape[0]):
        for k in range(mine.level.shape[1]):
            mine.level[n, k] += by * mine.scale
            total += mine.level[n, k]
        mine.age[n] += 1
    return total


@pytest.fixture
def pots() -> Table[Pots]:
    return Table(Table.empty(Pots, N=3, K=2, B=4).arrays._replace(scale=2.0))


def test_kernels_write_to_the_tables_own_arrays_which_begin_as_declared(pots: Table[Pots]) -> None:
    assert pots.arrays.level.tolist() == [[0.5, 0.5]] * 3
    assert pots.age.tolist() == [-1, -1, -1]
    assert (pots.lid.shape, pots.lid.dtype) == ((4, 3), np.bool_)
    assert _stir(pots.handle, 0.25) == pytest.approx(6.0)
    assert (pots.arrays.level == 1.0).all()
    assert pots.age.tolist() == [0, 0, 0]


def test_reset_is_of_members_and_of_what_is_reset_alone(pots: Table[Pots]) -> None:
    _stir(pots.handle, 1.0)
    pots.kept[:] = [4, 5, 6]
    pots.lid[:] = True
    pots.reset(np.array([0, 2]))
    assert pots.arrays.level.tolist() == [[0.5, 0.5], [2.5, 2.5], [0.5, 0.5]]
    assert pots.age.tolist() == [-1, 0, -1]
    assert pots.kept.tolist() == [4, 5, 6]
    assert pots.lid.all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda table: pickle.loads(pickle.dumps(table))])
def test_copies_are_of_their_own(pots: Table[Pots], copied: Any) -> None:
    both: Table[Any] = Table(merged(Pots, More)(*pots.arrays, np.full((3, 2), 7)))
    for table in (pots, both):
        other = copied(table)
        assert type(other.arrays) is type(table.arrays)
        _stir(other.handle, 1.0)
        assert (table.arrays.level == 0.5).all()
        assert (other.arrays.level == 2.5).all()


def test_what_is_merged_is_opened_as_its_first_part() -> None:
    both: Any = Table.empty(merged(Pots, More), **{"N": 1, "K": 1, "B": 1, "2": 2})
    assert [field.name for field in declared(type(both.arrays))][-1] == "spoons"
    assert both.spoons.tolist() == [[7, 7]]
    _stir(both.handle, 1.0)
    assert both.age.tolist() == [0]


def test_snapshots_have_the_members_first_and_leave_out_what_is_not_kept(pots: Table[Pots]) -> None:
    assert [array.shape for array in pots.changing()] == [(3, 2), (3,), (3,), ()]
    assert [array.shape for array in pots.member(1)] == [(1, 2), (1,), (1,)]
    looked_up = pots.member(1)
    pots.age[1] = 9  # one number a member is looked at, too, and not kept as it was
    assert [9] in [array.tolist() for array in looked_up]


def test_what_kernels_cannot_take_is_refused() -> None:
    class Wrong(NamedTuple):
        level: FloatArray

    with pytest.raises(TypeError, match=r"Wrong\.level: must be Annotated"):
        Table.empty(Wrong)

    refused("contiguous", addresses, [np.zeros((4, 4))[:, ::2]])
    refused("4 axes", addresses, [np.zeros((1, 1, 1, 1, 1))])
