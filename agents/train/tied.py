"""Layers for the manager whose weights are shared by all slots, and by all orders.

Slots are interchangeable, and so are orders: what is learned of one holds for the others. A hidden layer has units of
the laboratory, and as many units for each slot as for any other, and for each order. A weight depends on the kinds of
the two units that it connects, and on whether they belong to the same slot and to the same order. Where two slots
change places, so do their actions. The weights of a layer form an ordinary matrix, which is what is exported.

Needs PyTorch: ``pip install ".[train]"``.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from chemlab.config.extras import needs
from chemlab.kernels.arrays import IntArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.manager_actions import DISCARD, FIRST, KIND, MEASURE, SECOND, START, SUBMIT
from chemlab.roles.manager_view import order_channels, terms_channels

from ..notes import notes_shape

with needs("training needs PyTorch", "train"):
    import torch
    from torch import nn


Unit = tuple[Hashable, int, int]
"""Kind of a unit, and the slot and the order that it belongs to; -1: none."""

_SLOT = {START: SECOND, MEASURE: FIRST, DISCARD: FIRST, SUBMIT: FIRST}
"""Column of the table of actions that holds the slot."""


def _tanh(x: torch.Tensor) -> torch.Tensor:
    """Return the hyperbolic tangent, by the logistic function, which PyTorch computes several times faster."""
    return (x + x).sigmoid_().mul_(2.0).sub_(1.0)


class _Tanh(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor) -> torch.Tensor:
        out = _tanh(x)
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> torch.Tensor:
        (out,) = ctx.saved_tensors
        found: torch.Tensor = torch.ops.aten.tanh_backward(gradients[0], out)
        return found


class Tanh(nn.Module):
    """Hyperbolic tangent."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Values of the same shape."""
        found: torch.Tensor = _Tanh.apply(x) if torch.is_grad_enabled() else _tanh(x)  # type: ignore[no-untyped-call]
        return found


class TiedLinear(nn.Module):
    """A fully connected layer with shared weights.

    Args:
        ins: units of the input.
        outs: units of the output.
        gain: standard deviation of the outputs for inputs of size 1, at first.
    """

    index: torch.Tensor
    share: torch.Tensor
    rows: torch.Tensor

    def __init__(self, ins: Sequence[Unit], outs: Sequence[Unit], gain: float) -> None:
        super().__init__()
        self.in_features, self.out_features = len(ins), len(outs)
        kinds, rows = (numbered([unit[0] for unit in units]) for units in (ins, outs))
        slots = _relation([slot for _, slot, _ in ins], [slot for _, slot, _ in outs])
        orders = _relation([order for _, _, order in ins], [order for _, _, order in outs])
        which = ((rows[:, None] * (kinds.max() + 1) + kinds) * 4 + slots) * 4 + orders
        found, index = np.unique(which, return_inverse=True)
        index = index.reshape(which.shape)
        uses = np.stack([np.bincount(row, minlength=len(found))[row] for row in index])
        # Inputs that share a weight count by their mean: with sums a step changes too much at once.
        share = 1.0 / uses
        spread = np.zeros(len(found))
        spread[index] = gain * share.sum(axis=1, keepdims=True) ** -0.5
        for name, array in (("index", index), ("share", share.astype(np.float32)), ("rows", rows)):
            self.register_buffer(name, torch.from_numpy(array))
        self.values = nn.Parameter(torch.randn(len(found)) * torch.from_numpy(spread).float())
        self.biases = nn.Parameter(torch.zeros(int(rows.max()) + 1))
        self._whole: tuple[torch.Tensor, torch.Tensor] | None = None

    @property
    def weight(self) -> torch.Tensor:
        """Weights [out, in]."""
        # Faster than values[index], above all in the gradient.
        return self.values.index_select(0, self.index.flatten()).view(self.share.shape) * self.share

    @property
    def bias(self) -> torch.Tensor:
        """Biases [out]."""
        return self.biases.index_select(0, self.rows)

    def train(self, mode: bool = True) -> TiedLinear:
        """See :meth:`torch.nn.Module.train`; for evaluation, the whole matrix is made once."""
        self._whole = None if mode else (self.weight.detach(), self.bias.detach())
        return super().train(mode)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Outputs [B, out] of inputs [B, in]."""
        weight, bias = self._whole or (self.weight, self.bias)
        return nn.functional.linear(x, weight, bias)


def numbered(kinds: Sequence[Hashable]) -> IntArray:
    """Return the number of each kind, in order of first appearance."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(kind, len(numbers)) for kind in kinds])


def _relation(ins: Sequence[int], outs: Sequence[int]) -> IntArray:
    """Return [out, in]: 0 where the input belongs to none, 1 where the output does, 2 both to the same, 3 to others."""
    a, b = np.array(ins)[None, :], np.array(outs)[:, None]
    return np.where(a < 0, 0, np.where(b < 0, 1, np.where(a == b, 2, 3)))


def observed_units(labs: Laboratories) -> list[Unit]:
    """Units of the manager's observation."""
    scenario, units = labs.scenario, list[Unit]()
    orders = {
        own: (number, kind)
        for number, (name, _) in enumerate(order_channels(scenario))
        for kind, own in enumerate((name, *terms_channels(name)))
    }
    for channel in labs.roles[0].channels:
        if channel.name == "told":
            for name in scenario.world.told_to("manager"):
                draw = scenario.world.draws[name]
                units += [_told(name, target) for target in (draw.of if draw.variables > 1 else ("",))]
            continue
        kind, slot, order = channel.name, -1, -1
        if channel.name in orders:
            order, place = orders[channel.name]
            kind = f"order {place}"
        elif channel.name.startswith("slot_"):
            number, _, kind = channel.name.removeprefix("slot_").partition("_")
            slot = int(number)
        units += [((kind, k), slot, order) for k in range(channel.size)]
    return units


def notes_units(labs: Laboratories) -> list[Unit]:
    """Units of the manager's notes (:mod:`chemlab.agents.notes`)."""
    slots, of_slot, kinds, of_kind = notes_shape(labs.manager.workplace)
    found: list[Unit] = [(("noted", k), slot, -1) for slot in range(slots) for k in range(of_slot)]
    return [*found, *((("noted", kind, k), -1, -1) for kind in range(kinds) for k in range(of_kind))]


def _told(name: str, target: str) -> Unit:
    """The unit of a hidden parameter."""
    what, _, number = target.rpartition("_")
    if what in ("slot", "order"):
        return (name,), int(number) if what == "slot" else -1, int(number) if what == "order" else -1
    return (name, target), -1, -1


def action_units(labs: Laboratories) -> list[Unit]:
    """Units of the manager's actions."""
    units: list[Unit] = []
    for row in labs.actions.table.tolist():
        columns = (_SLOT.get(row[KIND]), SECOND if row[KIND] == SUBMIT else None)
        slot, order = (-1 if column is None else row[column] for column in columns)
        units.append((tuple(-1 if n in columns else part for n, part in enumerate(row)), slot, order))
    return units


def tied_layers(
    labs: Laboratories, observed: Sequence[Unit], outs: Sequence[Unit], hidden: Sequence[int]
) -> nn.Sequential:
    """Layers with tanh between them.

    Args:
        labs: the laboratories.
        observed: units of the input.
        outs: units of the output.
        hidden: twice the units of the laboratory in each hidden layer; a slot has an eighth of it, an order a 16th.
    """
    layers, scenario = [list(observed)], labs.scenario
    for number, size in enumerate(hidden):
        units: list[Unit] = [((number, k), -1, -1) for k in range(-(-size // 2))]
        units += [((number, "slot", k), s, -1) for s in range(scenario.shelf.slots) for k in range(-(-size // 8))]
        units += [((number, "order", k), -1, o) for o in range(scenario.orders) for k in range(-(-size // 16))]
        layers.append(units)
    layers.append(list(outs))
    modules: list[nn.Module] = []
    for i in range(len(layers) - 1):
        modules += [TiedLinear(layers[i], layers[i + 1], 0.01 if i == len(hidden) else 2.0**0.5), Tanh()]
    return nn.Sequential(*modules[:-1])
