"""NRTL parameters of many pairs of liquids at once, fitted to UNIFAC as :func:`chemlab.openchem.activity.fit` does.

All pairs take Levenberg-Marquardt steps side by side in NumPy, at fewer temperatures and compositions than there: a
pair takes 0.02 s instead of 2 s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..config.catalogue import IDEAL_PAIR, CataloguePair
from ..config.materials import Material
from .activity import Array, forms_for, stable

TEMPERATURES_K: Array = np.array([270.0, 300.0, 340.0, 400.0, 480.0])
_HALF = [1e-10, 1e-3, 0.01, 0.04, 0.12, 0.25]
FRACTIONS: Array = np.array([*_HALF, 0.5, *(1.0 - x for x in reversed(_HALF))])
_ALPHAS = (0.2, 0.3, 0.47, 0.65)
_WIDEST, _LEAST = 6.0, -8.0
"""Largest change of ln gamma at infinite dilution from 270 to 480 K, and least ln gamma. Beyond either, a form's group
parameters are extrapolated too far in temperature, and the next form is used."""
_TRIES = ((1.0, 20.0), (0.1, 20.0), (1.0, 0.0))
"""Weight of high dilution, and of an activity that falls with its mole fraction where there is one liquid."""
_ENOUGH = 0.1
"""Score from which on the later tries are made, too; and the score of a temperature with a second liquid."""
_STEPS, _PASSES, _ENDS, _DILUTE, _RIDGE, _SMALL = 10, 3, 3.0, 0.03, 1e-3, 1e-5
_BASIS: Array = np.stack(
    [np.ones_like(TEMPERATURES_K), 300.0 / TEMPERATURES_K, 3.0 * np.log(TEMPERATURES_K / 300.0)], axis=-1
)
"""[T, 3] of a, b / 300 K and c / 3."""
_RISES: Array = 0.95 * np.diff(np.log(FRACTIONS))
_CHUNK = 100


class _Best(NamedTuple):
    """The best parameters of N pairs so far."""

    score: Array
    parameters: Array
    alpha: Array
    error: Array

    def improve(self, other: _Best, where: Any = slice(None)) -> None:
        """Take what is better of another result, which is of the pairs ``where``."""
        for mine, theirs in zip(self[1:], other[1:], strict=True):
            kept = mine[where]
            kept[other.score < self.score[where]] = theirs[other.score < self.score[where]]
            mine[where] = kept
        self.score[where] = np.minimum(self.score[where], other.score)


def _log_gamma(tau: Array, alpha: float) -> Array:
    """[N, T, X, 2] ln gamma by NRTL at FRACTIONS, of tau [N, T, 2]."""
    x, y = FRACTIONS, 1.0 - FRACTIONS
    one, two = tau[..., None, 0], tau[..., None, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        g_one, g_two = np.exp(-alpha * one), np.exp(-alpha * two)
        below_one, below_two = y + x * g_one, x + y * g_two
        first = y * y * (two * (g_two / below_two) ** 2 + one * g_one / below_one**2)
        second = x * x * (one * (g_one / below_one) ** 2 + two * g_two / below_two**2)
    return np.stack([first, second], axis=-1)


class _Problem:
    """Curves of N pairs and what counts of them: mixtures of one liquid, and both ends."""

    def __init__(self, log_gamma: Array, one_liquid: npt.NDArray[np.bool_], tails: float, splits: float) -> None:
        self.curves, self.one_liquid, self.splits = log_gamma, one_liquid, splits
        self.count = len(log_gamma)
        self.kept = np.repeat(one_liquid[..., None], 2, axis=-1)
        self.weight = self.kept.astype(np.float64)
        self.weight[:, :, np.minimum(FRACTIONS, 1.0 - FRACTIONS) < _DILUTE] *= tails
        parted = ~one_liquid.reshape(self.count, -1).all(axis=-1)
        self.weight[parted, :, 0, 0] = self.weight[parted, :, -1, 1] = _ENDS
        self.whole = one_liquid[:, :, 1:] & one_liquid[:, :, :-1]

    def model(self, parameters: Array, alpha: float) -> tuple[Array, Array]:
        """tau [N, T, 2] and ln gamma [N, T, X, 2]."""
        tau = np.einsum("tb,nbi->nti", _BASIS, parameters.reshape(self.count, 3, 2))
        return tau, _log_gamma(tau, alpha)

    def residuals(self, made: Array, parameters: Array, weight: Array) -> Array:
        """[N, residuals]"""
        off = np.where(weight > 0.0, (made - self.curves) * weight, 0.0)
        falls = np.where(self.whole, np.minimum(np.diff(made[..., 0], axis=2) + _RISES, 0.0), 0.0)
        flat = [off.reshape(self.count, -1), self.splits * falls.reshape(self.count, -1), _RIDGE * parameters]
        return np.concatenate(flat, axis=1)

    def slopes(self, tau: Array, made: Array, weight: Array, alpha: float, size: int) -> Array:
        """[N, residuals, 6] derivatives of the residuals."""
        falling = self.whole & (np.diff(made[..., 0], axis=2) + _RISES < 0.0)
        out, cut = np.zeros((self.count, size, 6)), made[0].size
        for i in range(2):
            moved = tau.copy()
            moved[..., i] += _SMALL
            slope = (_log_gamma(moved, alpha) - made) / _SMALL
            falls = self.splits * np.where(falling, np.diff(slope[..., 0], axis=2), 0.0)
            for b in range(3):
                out[:, :cut, 2 * b + i] = (slope * weight * _BASIS[:, b, None, None]).reshape(self.count, -1)
                out[:, cut:-6, 2 * b + i] = (falls * _BASIS[:, b, None]).reshape(self.count, -1)
        out[:, -6:] = _RIDGE * np.eye(6)
        return out

    def descend(self, parameters: Array, weight: Array, alpha: float) -> tuple[Array, Array]:
        """Parameters and ln gamma after some steps."""
        tau, made = self.model(parameters, alpha)
        found = self.residuals(made, parameters, weight)
        cost, damping = np.sum(found**2, axis=1), np.full(self.count, 1e-2)
        for _ in range(_STEPS):
            slopes = self.slopes(tau, made, weight, alpha, found.shape[1])
            square = slopes.transpose(0, 2, 1) @ slopes
            square += (damping[:, None] * np.einsum("nii->ni", square))[:, :, None] * np.eye(6)
            step = np.linalg.solve(square, -(slopes.transpose(0, 2, 1) @ found[..., None]))[..., 0]
            new_tau, new_made = self.model(parameters + step, alpha)
            new = self.residuals(new_made, parameters + step, weight)
            new_cost = np.sum(new**2, axis=1)
            better = np.isfinite(new_cost) & (new_cost < cost)
            damping = np.clip(np.where(better, 0.2 * damping, 8.0 * damping), 1e-9, 1e9)
            parameters, cost = (
                np.where(better[:, None], parameters + step, parameters),
                np.where(better, new_cost, cost),
            )
            tau, found = np.where(better[:, None, None], new_tau, tau), np.where(better[:, None], new, found)
            made = np.where(better[:, None, None, None], new_made, made)
        return parameters, made

    def best(self, alpha: float) -> _Best:
        """The best fit of each pair with one alpha; each pass has more weight on what the last one met worst."""
        start = np.tile([1.0, 1.0, 1.0 / 3.0, 1.0 / 3.0, 0.0, 0.0], (self.count, 1))
        weight, parameters = self.weight.copy(), start
        best = _Best(np.full(self.count, np.inf), start.copy(), np.full(self.count, alpha), np.zeros(self.count))
        for _ in range(_PASSES):
            parameters, made = self.descend(parameters, weight, alpha)
            off = np.where(self.kept, np.abs(made - self.curves), 0.0)
            second = self.one_liquid & ~np.array([stable(one, FRACTIONS) for one in made])
            made_up = np.sum(second.any(axis=-1) & self.one_liquid.all(axis=-1), axis=1)
            error = off.reshape(self.count, -1).max(axis=1)
            best.improve(_Best(error + _ENOUGH * made_up, parameters, best.alpha.copy(), error))
            worst = np.maximum((off * weight).reshape(self.count, -1).max(axis=1), 1e-12)
            weight = weight * np.sqrt(0.1 + off * weight / worst[:, None, None, None])
        return best


def fits(log_gamma: Array) -> tuple[Array, Array, Array]:
    """Fit NRTL parameters to many pairs.

    Args:
        log_gamma: [N, T, X, 2] at TEMPERATURES_K and FRACTIONS.

    Returns:
        a12, a21, b12, b21, c12, c21 [N, 6]; alpha [N]; the largest error of ln gamma where two mix [N].
    """
    one_liquid = np.array([stable(one, FRACTIONS) for one in log_gamma])
    best = _Best(np.full(len(log_gamma), np.inf), *np.zeros((1, len(log_gamma), 6)), *np.zeros((2, len(log_gamma))))
    for tails, splits in _TRIES:
        bad = np.flatnonzero(best.score > _ENOUGH)
        for alpha in _ALPHAS if len(bad) else ():
            best.improve(_Problem(log_gamma[bad], one_liquid[bad], tails, splits).best(alpha), bad)
    return best.parameters * np.array([1.0, 1.0, 300.0, 300.0, 3.0, 3.0]), best.alpha, best.error


def quick_pairs(
    pairs: Sequence[tuple[str, str]],
    materials: Mapping[str, Material],
    progress: Callable[[int], None] = lambda _: None,
) -> list[CataloguePair]:
    """Return the NRTL parameters of some pairs by UNIFAC.

    Args:
        pairs: of two materials each.
        materials: what they are, by id.
        progress: is called with the number of pairs that are done.

    Returns:
        A row for each pair; pairs that UNIFAC has no groups or interactions for are ideal, which their form says.
    """
    curves: dict[Any, tuple[str, Array]] = {}
    keys = [_curve(two, materials, curves) for two in pairs]
    wanted = [key for key in curves if key is not None]
    made: dict[Any, tuple[Array, float, float]] = {}
    for at in range(0, len(wanted), _CHUNK):
        part = wanted[at : at + _CHUNK]
        found = fits(np.array([curves[key][1] for key in part]))
        made |= {key: (p, float(a), float(e)) for key, p, a, e in zip(part, *found, strict=True)}
        progress(at + len(part))
    rows = []
    for two, key in zip(pairs, keys, strict=True):
        if key is None:
            rows.append(CataloguePair(*two, IDEAL_PAIR, 0.3, 0.0, (0.0,) * 6))
            continue
        parameters, alpha, error = made[key]
        rounded = tuple(float(f"{value:.5g}") for value in parameters.tolist())
        rows.append(CataloguePair(*two, curves[key][0], alpha, float(f"{error:.2g}"), rounded))
    return rows


def _curve(two: tuple[str, str], materials: Mapping[str, Material], curves: dict[Any, tuple[str, Array]]) -> Any:
    """Put ln gamma of a pair by the best form of UNIFAC that is sound into ``curves``.

    Returns:
        Its key there, None where no form is sound.
    """
    for form in forms_for(two, materials):
        groups = [found for name in two if (found := form.groups(name, materials[name])) is not None]
        if len(groups) < 2 or form.lacks(groups):
            continue
        key = (form.name, *(tuple(sorted(found.items())) for found in groups))
        if key in curves:
            return key
        with np.errstate(divide="ignore"):
            log_gamma = form.log_gamma(groups, TEMPERATURES_K, FRACTIONS)
        ends = np.stack([log_gamma[:, 0, 0], log_gamma[:, -1, 1]])
        if log_gamma.min() >= _LEAST and np.ptp(ends, axis=1).max() <= _WIDEST:
            curves[key] = form.name, log_gamma
            return key
    return None
