"""Figure of a flask's history; needs the extra ``plot``."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .figure import SETTINGS, import_matplotlib, new_figure

if TYPE_CHECKING:
    from ..sandbox import Moment

_LEAST_SHARE = 0.002
"""Materials whose largest amount is below this share of all largest amounts are not drawn."""
_MOST_LINES = 8


def flask_figure(history: Sequence[Moment]) -> Any:
    """Return a figure of temperatures, amounts and compositions.

    Args:
        history: the flask after each operation, at least two.

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
        colors: dict[str, str] = defaultdict(lambda: f"C{len(colors)}")  # colours of materials may be alike
        for name in _drawn([m.amounts for m in history]):
            middle.plot(across, [m.amounts.get(name, 0.0) for m in history], label=name, color=colors[name])
        middle.set_ylabel("amount (mol)")
        _compositions(bottom, across, history, colors)
        bottom.set_xlabel(label)
        for axes in (middle, bottom):
            if axes.lines:
                axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.tight_layout()
    return figure


def _compositions(axes: Any, across: list[float], history: Sequence[Moment], colors: Mapping[str, str]) -> None:
    """Draw mole fractions in the distillate, or else amounts of undissolved solids, or else fractions in the flask."""
    distils = any(m.distillate for m in history)
    solid = not distils and any(m.solids for m in history)
    parts = [m.distillate if distils else m.solids if solid else m.amounts for m in history]
    totals = [1.0 if solid else sum(part.values()) or math.nan for part in parts]
    for name in _drawn(parts):
        values = [part.get(name, 0.0) / total for part, total in zip(parts, totals, strict=True)]
        axes.plot(across, values, label=name, color=colors[name])
    if solid:
        axes.set_ylabel("not dissolved (mol)")
        return
    axes.set_ylabel(f"mole fraction in the {'distillate' if distils else 'flask'}")
    axes.set_ylim(-0.02, 1.02)


def _across(history: Sequence[Moment]) -> tuple[list[float], str]:
    """Return values and label of the horizontal axis: time, else heat, else the number of operations."""
    seconds, joules = [m.seconds for m in history], [m.joules for m in history]
    if seconds[-1] > seconds[0]:
        unit, factor = ("h", 3600.0) if seconds[-1] > 7200.0 else ("min", 60.0)
        return [s / factor for s in seconds], f"time ({unit})"
    if max(joules) > min(joules):
        return [j / 1000.0 for j in joules], "heat (kJ)"
    return [float(i) for i in range(len(history))], "operation"


def _drawn(parts: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the materials to draw, the most abundant first."""
    most: Counter[str] = Counter()
    for part in parts:
        most |= Counter(part)  # the larger amount of each material
    least = _LEAST_SHARE * sum(most.values())
    return [name for name, mol in most.most_common(_MOST_LINES) if mol >= least]
