"""The figure of what happened to a flask; needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .figure import SETTINGS, import_matplotlib, new_figure

if TYPE_CHECKING:
    from ..sandbox import Moment

_LEAST_SHARE = 0.002
"""Of all mol: materials that never reach it are not drawn."""
_MOST_LINES = 8


def flask_figure(history: Sequence[Moment], colors: Mapping[str, str]) -> Any:
    """A figure of temperatures, amounts and compositions.

    Args:
        history: the flask after each operation; two of them at least.
        colors: by material.

    Raises:
        ImportError: matplotlib is not installed.
    """
    with import_matplotlib().rc_context(SETTINGS):
        figure = new_figure(7.0, 8.0)
        across, label = _across(history)
        top, middle, bottom = figure.subplots(3, 1, sharex=True)
        top.plot(across, [m.temperature_k for m in history], color="black", label="contents")
        heads = [(x, m.head_temperature_k) for x, m in zip(across, history, strict=True) if m.head_temperature_k]
        if heads:
            top.plot(*zip(*heads, strict=True), "o-", ms=3, color="#cc3311", label="still head")
            top.legend()
        top.set_ylabel("temperature (K)")
        for name in _drawn([m.amounts for m in history]):
            middle.plot(across, [m.amounts.get(name, 0.0) for m in history], label=name, color=colors.get(name))
        middle.set_ylabel("amount (mol)")
        _compositions(bottom, across, history, colors)
        bottom.set_xlabel(label)
        for axes in (middle, bottom):
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.tight_layout()
    return figure


def _compositions(axes: Any, across: list[float], history: Sequence[Moment], colors: Mapping[str, str]) -> None:
    """Draw what distils, or else what is not dissolved, or else the shares of what is in the flask."""
    if not any(m.distillate for m in history) and any(m.solids for m in history):
        for name in _drawn([m.solids for m in history]):
            axes.plot(across, [m.solids.get(name, 0.0) for m in history], label=name, color=colors.get(name))
        axes.set_ylabel("not dissolved (mol)")
        return
    distils = any(m.distillate for m in history)
    parts = [m.distillate if distils else m.amounts for m in history]
    for name in _drawn(parts):
        axes.plot(across, [_share(part, name) for part in parts], label=name, color=colors.get(name))
    axes.set_ylabel(f"mole fraction in the {'distillate' if distils else 'flask'}")
    axes.set_ylim(-0.02, 1.02)


def _across(history: Sequence[Moment]) -> tuple[list[float], str]:
    """The quantity that changes most steadily: time, else heat, else the number of operations."""
    seconds, joules = [m.seconds for m in history], [m.joules for m in history]
    if seconds[-1] > seconds[0]:
        unit, factor = ("h", 3600.0) if seconds[-1] > 7200.0 else ("min", 60.0)
        return [s / factor for s in seconds], f"time ({unit})"
    if max(joules) > min(joules):
        return [j / 1000.0 for j in joules], "heat (kJ)"
    return [float(i) for i in range(len(history))], "operation"


def _share(amounts: Mapping[str, float], name: str) -> float:
    total = sum(amounts.values())
    return amounts.get(name, 0.0) / total if total > 0.0 else float("nan")


def _drawn(parts: Sequence[Mapping[str, float]]) -> list[str]:
    """Materials that are ever more than a trace, the most abundant first."""
    most: dict[str, float] = {}
    for part in parts:
        for name, mol in part.items():
            most[name] = max(most.get(name, 0.0), mol)
    least = _LEAST_SHARE * float(np.sum(list(most.values())))
    return sorted((name for name in most if most[name] >= least), key=lambda name: -most[name])[:_MOST_LINES]
