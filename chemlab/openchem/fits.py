"""Fits of NRTL parameters to activity coefficients of pairs of liquids, many pairs at once.

All pairs take Levenberg-Marquardt steps side by side in NumPy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Grid(NamedTuple):
    """Points at which ln gamma is compared, and the settings of a fit.

    Attributes:
        temperatures_k: [T] temperatures.
        fractions: [X] mole fractions of the first component; 1e-10 represents infinite dilution.
        alphas: candidate values of alpha.
        steps: steps of one fit.
        passes: number of fits; each puts more weight on the largest errors of the previous one.
    """

    temperatures_k: Array
    fractions: Array
    alphas: tuple[float, ...]
    steps: int
    passes: int


def _both_sides(half: list[float]) -> Array:
    return np.array([*half, 0.5, *(1.0 - x for x in reversed(half))])


FINE = Grid(
    np.array([270.0, 285.0, 300.0, 320.0, 340.0, 365.0, 390.0, 420.0, 450.0, 480.0]),
    _both_sides([1e-10, 1e-4, 0.002, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4]),
    (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.47, 0.55, 0.65),
    30,
    6,
)
"""Grid for pair files; a pair takes some seconds.

Renon and Prausnitz propose alpha from 0.2 to 0.47; alcohol mixtures often need more, nearly immiscible mixtures less.
"""
QUICK = Grid(
    np.array([270.0, 300.0, 340.0, 400.0, 480.0]),
    _both_sides([1e-10, 1e-3, 0.01, 0.04, 0.12, 0.25]),
    (0.2, 0.3, 0.47, 0.65),
    10,
    3,
)
"""Grid for everyday chemicals; a pair takes 0.02 s."""

_TRIES = ((1.0, 20.0), (0.1, 20.0), (1.0, 0.0))
"""Candidate weights of high dilution, and of a spurious second liquid.

A second liquid is spurious if an activity falls with its mole fraction although the reference has one liquid. The later
candidates are for mixtures whose coefficients at high dilution NRTL cannot reproduce otherwise.
"""
_ENOUGH = 0.1
"""Score above which the later candidates are tried; and penalty, as an error of ln gamma, of each temperature with a
spurious second liquid.
"""
_DILUTE = 0.03
"""Mole fraction below which a mixture counts as highly dilute."""
_ENDS = 3.0
"""Weight of infinite dilution relative to one mixture."""
_RIDGE, _SMALL = 1e-3, 1e-5
"""Weight of the regularization; step of numerical derivatives."""


def stable(log_gamma: Array, fractions: Array = FINE.fractions) -> npt.NDArray[np.bool_]:
    """Return [T, X] True where a mixture is stable as one liquid: on the lower hull of the Gibbs energy of mixing."""
    x = fractions
    ideal = x * np.log(x) + (1.0 - x) * np.log(1.0 - x)
    energy = ideal + x * log_gamma[..., 0] + (1.0 - x) * log_gamma[..., 1]
    out = np.zeros(energy.shape, dtype=np.bool_)
    for row, g in zip(out, energy, strict=True):
        hull: list[int] = []
        for k in range(len(x)):
            while len(hull) > 1:
                i, j = hull[-2], hull[-1]
                if (g[j] - g[i]) * (x[k] - x[i]) < (g[k] - g[i]) * (x[j] - x[i]):
                    break
                hull.pop()
            hull.append(k)
        row[hull] = True
    return out


class _Best(NamedTuple):
    """The best parameters of N pairs so far, with the score, alpha and the largest error of each."""

    score: Array
    parameters: Array
    alpha: Array
    error: Array

    def improve(self, other: _Best, where: Any = slice(None)) -> None:
        """Replace the results of pairs ``where`` that have a lower score in ``other``."""
        better = other.score < self.score[where]
        for array, candidates in zip(self, other, strict=True):
            values = array[where]
            values[better] = candidates[better]
            array[where] = values


def _log_gamma(tau: Array, alpha: float, fractions: Array) -> Array:
    """Return ln gamma [N, T, X, 2] by NRTL for tau [N, T, 2]."""
    x, y = fractions, 1.0 - fractions
    one, two = tau[..., None, 0], tau[..., None, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        g_one, g_two = np.exp(-alpha * one), np.exp(-alpha * two)
        below_one, below_two = y + x * g_one, x + y * g_two
        first = y * y * (two * (g_two / below_two) ** 2 + one * g_one / below_one**2)
        second = x * x * (one * (g_one / below_one) ** 2 + two * g_two / below_two**2)
    return np.stack([first, second], axis=-1)


class _Problem:
    """Least-squares problem of N pairs; only mixtures of one liquid and infinite dilution have a weight.

    Args:
        log_gamma: [N, T, X, 2] reference values.
        one_liquid: [N, T, X] True where the reference has one liquid.
        grid: temperatures, fractions and length of the fit.
        tails: relative weight of highly dilute mixtures.
        splits: weight of spurious second liquids.
    """

    def __init__(
        self, log_gamma: Array, one_liquid: npt.NDArray[np.bool_], grid: Grid, tails: float, splits: float
    ) -> None:
        self.curves, self.one_liquid, self.grid, self.splits = log_gamma, one_liquid, grid, splits
        t, x = grid.temperatures_k, grid.fractions
        self.basis: Array = np.stack([np.ones_like(t), 300.0 / t, 3.0 * np.log(t / 300.0)], axis=-1)
        """[T, 3] of a, b / 300 K and c / 3."""
        self.rises: Array = 0.95 * np.diff(np.log(x))
        self.count = len(log_gamma)
        self.kept = np.repeat(one_liquid[..., None], 2, axis=-1)
        self.weight = self.kept.astype(np.float64)
        self.weight[:, :, np.minimum(x, 1.0 - x) < _DILUTE] *= tails
        parted = ~one_liquid.reshape(self.count, -1).all(axis=-1)
        self.weight[parted, :, 0, 0] = self.weight[parted, :, -1, 1] = _ENDS
        self.whole = one_liquid[:, :, 1:] & one_liquid[:, :, :-1]

    def model(self, parameters: Array, alpha: float) -> tuple[Array, Array]:
        """Return tau [N, T, 2] and ln gamma [N, T, X, 2] for parameters [N, 6]."""
        tau = np.einsum("tb,nbi->nti", self.basis, parameters.reshape(self.count, 3, 2))
        return tau, _log_gamma(tau, alpha, self.grid.fractions)

    def residuals(self, made: Array, parameters: Array, weight: Array) -> Array:
        """Return the residuals [N, R]: weighted errors of ln gamma, falling activities, and the regularization."""
        off = np.where(weight > 0.0, (made - self.curves) * weight, 0.0)
        falls = np.where(self.whole, np.minimum(np.diff(made[..., 0], axis=2) + self.rises, 0.0), 0.0)
        flat = [off.reshape(self.count, -1), self.splits * falls.reshape(self.count, -1), _RIDGE * parameters]
        return np.concatenate(flat, axis=1)

    def slopes(self, tau: Array, made: Array, weight: Array, alpha: float, size: int) -> Array:
        """Return the derivatives [N, R, 6] of the residuals."""
        falling = self.whole & (np.diff(made[..., 0], axis=2) + self.rises < 0.0)
        out, cut = np.zeros((self.count, size, 6)), made[0].size
        for i in range(2):
            moved = tau.copy()
            moved[..., i] += _SMALL
            slope = (_log_gamma(moved, alpha, self.grid.fractions) - made) / _SMALL
            falls = self.splits * np.where(falling, np.diff(slope[..., 0], axis=2), 0.0)
            for b in range(3):
                out[:, :cut, 2 * b + i] = (slope * weight * self.basis[:, b, None, None]).reshape(self.count, -1)
                out[:, cut:-6, 2 * b + i] = (falls * self.basis[:, b, None]).reshape(self.count, -1)
        out[:, -6:] = _RIDGE * np.eye(6)
        return out

    def descend(self, parameters: Array, weight: Array, alpha: float) -> tuple[Array, Array]:
        """Return parameters and ln gamma after the grid's number of Levenberg-Marquardt steps."""
        tau, made = self.model(parameters, alpha)
        residuals = self.residuals(made, parameters, weight)
        cost, damping = np.sum(residuals**2, axis=1), np.full(self.count, 1e-2)
        for _ in range(self.grid.steps):
            slopes = self.slopes(tau, made, weight, alpha, residuals.shape[1])
            square = slopes.transpose(0, 2, 1) @ slopes
            square += (damping[:, None] * np.einsum("nii->ni", square))[:, :, None] * np.eye(6)
            step = np.linalg.solve(square, -(slopes.transpose(0, 2, 1) @ residuals[..., None]))[..., 0]
            new_tau, new_made = self.model(parameters + step, alpha)
            new = self.residuals(new_made, parameters + step, weight)
            new_cost = np.sum(new**2, axis=1)
            better = np.isfinite(new_cost) & (new_cost < cost)
            damping = np.clip(np.where(better, 0.2 * damping, 8.0 * damping), 1e-9, 1e9)
            parameters = np.where(better[:, None], parameters + step, parameters)
            cost, residuals = np.where(better, new_cost, cost), np.where(better[:, None], new, residuals)
            tau, made = (
                np.where(better[:, None, None], new_tau, tau),
                np.where(better[:, None, None, None], new_made, made),
            )
        return parameters, made

    def best(self, alpha: float) -> _Best:
        """Return the best fit of each pair with one alpha.

        Each pass puts more weight on the largest errors of the previous one.
        """
        start = np.tile([1.0, 1.0, 1.0 / 3.0, 1.0 / 3.0, 0.0, 0.0], (self.count, 1))
        weight, parameters = self.weight.copy(), start
        best = _Best(np.full(self.count, np.inf), start.copy(), np.full(self.count, alpha), np.zeros(self.count))
        for _ in range(self.grid.passes):
            parameters, made = self.descend(parameters, weight, alpha)
            off = np.where(self.kept, np.abs(made - self.curves), 0.0)
            second = self.one_liquid & ~np.array([stable(one, self.grid.fractions) for one in made])
            spurious = np.sum(second.any(axis=-1) & self.one_liquid.all(axis=-1), axis=1)
            error = off.reshape(self.count, -1).max(axis=1)
            best.improve(_Best(error + _ENOUGH * spurious, parameters, best.alpha.copy(), error))
            worst = np.maximum((off * weight).reshape(self.count, -1).max(axis=1), 1e-12)
            weight = weight * np.sqrt(0.1 + off * weight / worst[:, None, None, None])
        return best


def fits(log_gamma: Array, grid: Grid) -> tuple[Array, Array, Array]:
    """Fit NRTL parameters that minimize the largest error of ln gamma where the mixture is one liquid.

    If NRTL predicts a spurious second liquid or large errors at high dilution, both are weighed against each other.

    Args:
        log_gamma: [N, T, X, 2] at the temperatures and fractions of the grid.
        grid: temperatures, fractions, and settings of the fit.

    Returns:
        a12, a21, b12, b21, c12, c21 [N, 6]; alpha [N]; largest error [N] of ln gamma in mixtures of one liquid.
    """
    one_liquid = np.array([stable(one, grid.fractions) for one in log_gamma])
    best = _Best(np.full(len(log_gamma), np.inf), *np.zeros((1, len(log_gamma), 6)), *np.zeros((2, len(log_gamma))))
    for tails, splits in _TRIES:
        bad = np.flatnonzero(best.score > _ENOUGH)
        for alpha in grid.alphas if len(bad) else ():
            best.improve(_Problem(log_gamma[bad], one_liquid[bad], grid, tails, splits).best(alpha), bad)
    return best.parameters * np.array([1.0, 1.0, 300.0, 300.0, 3.0, 3.0]), best.alpha, best.error
