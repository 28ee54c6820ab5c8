"""Layers for the manager whose weights are shared among slots, and among orders.

Slots are interchangeable, and so are orders, so that experience with one applies to the others. A hidden layer has
units of the laboratory, equally many units for each slot, and equally many for each order. A weight depends on the
kinds of the two units that it connects, and on whether they belong to the same slot and to the same order. The policy
is therefore equivariant: if two slots are exchanged, so are their actions. Exported policies have the weights of each
layer as an ordinary matrix.

Needs PyTorch: ``pip install ".[train]"``.
"""

from __future__ import annotations

import itertools
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
"""Kind of a unit, its slot and its order; -1 for none."""

_SLOT = {START: SECOND, MEASURE: FIRST, DISCARD: FIRST, SUBMIT: FIRST}
"""Column of the table of actions that holds the slot."""


def _tanh(x: torch.Tensor) -> torch.Tensor:
    """Return the hyperbolic tangent from the logistic function, which PyTorch computes several times faster."""
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
        gradient: torch.Tensor = torch.ops.aten.tanh_backward(gradients[0], out)
        return gradient


class Tanh(nn.Module):
    """Hyperbolic tangent."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the hyperbolic tangent of each element."""
        out: torch.Tensor = _Tanh.apply(x) if torch.is_grad_enabled() else _tanh(x)  # type: ignore[no-untyped-call]
        return out


class TiedLinear(nn.Module):
    """A fully connected layer with shared weights.

    Args:
        ins: units of the input.
        outs: units of the output.
        gain: initial standard deviation of the outputs, for inputs of standard deviation 1.
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
        keys = ((rows[:, None] * (kinds.max() + 1) + kinds) * 4 + slots) * 4 + orders
        distinct, index = np.unique(keys, return_inverse=True)
        index = index.reshape(keys.shape)
        uses = np.stack([np.bincount(row, minlength=len(distinct))[row] for row in index])
        # Inputs that share a weight are averaged; with their sum, a step of the optimizer would change too much.
        share = 1.0 / uses
        std = np.zeros(len(distinct))
        std[index] = gain * share.sum(axis=1, keepdims=True) ** -0.5
        for name, array in (("index", index), ("share", share.astype(np.float32)), ("rows", rows)):
            self.register_buffer(name, torch.from_numpy(array))
        self.values = nn.Parameter(torch.randn(len(distinct)) * torch.from_numpy(std).float())
        self.biases = nn.Parameter(torch.zeros(int(rows.max()) + 1))
        self._whole: tuple[torch.Tensor, torch.Tensor] | None = None

    @property
    def weight(self) -> torch.Tensor:
        """Weights [out, in]."""
        # Faster than values[index], mostly because of its gradient.
        return self.values.index_select(0, self.index.flatten()).view(self.share.shape) * self.share

    @property
    def bias(self) -> torch.Tensor:
        """Biases [out]."""
        return self.biases.index_select(0, self.rows)

    def train(self, mode: bool = True) -> TiedLinear:
        """See :meth:`torch.nn.Module.train`; for evaluation, the matrix is computed once."""
        self._whole = None if mode else (self.weight.detach(), self.bias.detach())
        return super().train(mode)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the outputs [B, out] for inputs [B, in]."""
        weight, bias = self._whole or (self.weight, self.bias)
        return nn.functional.linear(x, weight, bias)


def numbered(kinds: Sequence[Hashable]) -> IntArray:
    """Return the number of each kind, in order of first appearance."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(kind, len(numbers)) for kind in kinds])


def _relation(ins: Sequence[int], outs: Sequence[int]) -> IntArray:
    """Return [out, in]: 0 if the input has no slot (or order), 1 if only the input has one, 2 if equal, 3 if not."""
    a, b = np.array(ins)[None, :], np.array(outs)[:, None]
    return np.where(a < 0, 0, np.where(b < 0, 1, np.where(a == b, 2, 3)))


def observed_units(labs: Laboratories) -> list[Unit]:
    """Return the units of the manager's observation."""
    scenario, units = labs.scenario, list[Unit]()
    orders = {
        channel: (order, kind)
        for order, (name, _) in enumerate(order_channels(scenario))
        for kind, channel in enumerate((name, *terms_channels(name)))
    }
    for channel in labs.manager.channels:
        if channel.name == "told":
            for name in scenario.world.told_to("manager"):
                draw = scenario.world.draws[name]
                units += [_parameter_unit(name, target) for target in (draw.of if draw.variables > 1 else ("",))]
            continue
        kind, slot, order = channel.name, -1, -1
        if channel.name in orders:
            order, position = orders[channel.name]
            kind = f"order {position}"
        elif channel.name.startswith("slot_"):
            number, _, kind = channel.name.removeprefix("slot_").partition("_")
            slot = int(number)
        units += [((kind, k), slot, order) for k in range(channel.size)]
    return units


def notes_units(labs: Laboratories) -> list[Unit]:
    """Return the units of the manager's notes (:mod:`chemlab.agents.notes`)."""
    slots, of_slot, kinds, of_kind = notes_shape(labs.manager.workplace)
    units: list[Unit] = [(("noted", k), slot, -1) for slot in range(slots) for k in range(of_slot)]
    return [*units, *((("noted", kind, k), -1, -1) for kind in range(kinds) for k in range(of_kind))]


def _parameter_unit(name: str, target: str) -> Unit:
    """Return the unit of an observed number of the draw ``name`` for a target, which may be a slot or an order."""
    what, _, number = target.rpartition("_")
    if what in ("slot", "order"):
        return (name,), int(number) if what == "slot" else -1, int(number) if what == "order" else -1
    return (name, target), -1, -1


def action_units(labs: Laboratories) -> list[Unit]:
    """Return the units of the manager's actions."""
    units: list[Unit] = []
    for row in labs.actions.table.tolist():
        columns = (_SLOT.get(row[KIND]), SECOND if row[KIND] == SUBMIT else None)
        slot, order = (-1 if column is None else row[column] for column in columns)
        units.append((tuple(-1 if n in columns else part for n, part in enumerate(row)), slot, order))
    return units


def tied_layers(
    labs: Laboratories, observed: Sequence[Unit], outs: Sequence[Unit], hidden: Sequence[int]
) -> nn.Sequential:
    """Return layers with shared weights and tanh between them.

    Args:
        labs: the laboratories.
        observed: units of the input.
        outs: units of the output.
        hidden: size of each hidden layer: it has half as many units of the laboratory, an eighth for each slot and a
            16th for each order.
    """
    layers, scenario = [list(observed)], labs.scenario
    for number, size in enumerate(hidden):
        units: list[Unit] = [((number, k), -1, -1) for k in range(-(-size // 2))]
        units += [((number, "slot", k), s, -1) for s in range(scenario.shelf.slots) for k in range(-(-size // 8))]
        units += [((number, "order", k), -1, o) for o in range(scenario.orders) for k in range(-(-size // 16))]
        layers.append(units)
    modules: list[nn.Module] = []
    for i, (ins, units) in enumerate(itertools.pairwise([*layers, list(outs)])):
        modules += [TiedLinear(ins, units, 0.01 if i == len(hidden) else 2.0**0.5), Tanh()]
    return nn.Sequential(*modules[:-1])
