"""Layers: vertical distribution of the fluids in a vessel, and the layer camera (PHYSICS section 2).

Every fluid layer is a Gaussian whose mean follows from the densities; all have the same variance. The relative amounts
at height x are therefore a softmax over layers of (mu_i x / sigma^2 + beta_i). The betas are chosen so that the profile
conserves volume: each pixel's shares add up to one, and each layer's pixels to its share of the vessel.
"""

from __future__ import annotations

import math

from ..kernels.arrays import FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import helper, inner, kernel, opened, scratch
from ..kernels.rng import uniforms
from .backends import find_layers, layer_density, layer_shade, solid_mol, solid_volume
from .chemistry import AMOUNTS, CLOCK, PRESENT, Chemistry
from .shelf import CLOCK_SETTLED, T_MIX

_BLOCK = 128
"""Number of pixels processed together."""
_STEEPEST = 600.0
"""Slope of a boundary per vessel height above which it is sharp: 6 per pixel of 100."""
_TOLERANCE = 1e-11
"""Tolerance of a layer's share of the vessel."""
_MOST_ITERATIONS = 50
_LONGEST_STEP = 4.0
_SURE_STEP = 0.1
"""Change of every beta below which a Newton step is taken without line search."""
_NEGLIGIBLE = -60.0
"""Logarithm of a relative amount that counts as 0 ..."""
_FARTHEST_SHIFT = 20.0
"""... while the offsets have moved by less than this; then the amounts are recomputed."""


@inner
def _stack(volumes: FloatArray, count: int, total: float, out: FloatArray) -> None:
    """Compute the fully settled profile: each layer fills its own interval of heights."""
    pixels = out.shape[1]
    out[:count] = 0.0
    low = 0.0
    for c in range(count):
        high = low + volumes[c] / total * pixels
        if c == count - 1:
            high = float(pixels)
        first, last = int(low), min(math.ceil(high), pixels)
        for p in range(first, last):
            out[c, p] = max(min(high, p + 1.0) - max(low, float(p)), 0.0)
        low = high


@helper
def _solve(matrix: FloatArray, rhs: FloatArray, size: int) -> None:
    """Solve a small positive-definite system in place by Cholesky; ``rhs`` becomes the solution."""
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(value, 1e-300))
            else:
                matrix[i, j] = value / matrix[j, j]
    for i in range(size):
        for k in range(i):
            rhs[i] -= matrix[i, k] * rhs[k]
        rhs[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            rhs[i] -= matrix[k, i] * rhs[k]
        rhs[i] /= matrix[i, i]


@kernel
def profile(row: FloatArray, chem: Handle, layers: IntArray, out: FloatArray, work: FloatArray) -> int:
    """Compute the share of every layer in every pixel of a vessel.

    Args:
        row: vessel row; its CLOCK is the progress of separation.
        chem: the chemistry.
        layers: [C + 1] out: number of columns, then the code of each (SOLIDS or a material; air last).
        out: [C, pixels] out: shares; columns in use sum to one over each pixel, and each to its layer's
            share of the vessel times the number of pixels (1e-9). Pixels from the bottom up.
        work: scratch of at least [C + 9, max(C + 1, pixels)].

    Returns:
        Number of columns in use; 0 without a vessel.
    """
    if row[PRESENT] <= 0.0:
        layers[0] = 0
        return 0
    volumes = work[0]
    count = find_layers(row, chem, layers, volumes)
    pixels = out.shape[1]
    total = 0.0
    for c in range(count):
        total += volumes[c]
    fluids = count - 1
    since_mixed = row[CLOCK] - T_MIX
    if row[CLOCK] >= CLOCK_SETTLED - 1e-9 or fluids == 1 or total - volumes[0] <= 0.0:
        _stack(volumes, count, total, out)
        return count
    solids = volumes[0] / total * pixels
    if since_mixed <= 1e-9:
        fluid = total - volumes[0]
        for p in range(pixels):
            out[0, p] = max(min(solids - p, 1.0), 0.0)
        clear = min(math.ceil(solids), pixels)
        for c in range(1, count):
            litres = volumes[c]
            for p in range(clear):
                out[c, p] = (1.0 - out[0, p]) * litres / fluid
            out[c, clear:] = litres / fluid
        return count
    # Consecutive fluids i, i + 1: log ratio of shares = slope_i x + offset_i, x in vessel heights.
    slope, offset, target = work[1], work[2], work[3]
    kappa = fluids * since_mixed * math.sqrt(2.0 * math.pi) * math.exp(row[CLOCK])
    low = volumes[0] / total
    for i in range(fluids):
        target[i] = volumes[1 + i] / total * pixels
    for i in range(fluids - 1):
        lighter = layer_density(row, layers[1 + 1 + i], chem) - layer_density(row, layers[1 + 2 + i], chem)
        slope[i] = min(kappa * lighter, _STEEPEST)
        # The two layers alone in their heights: there the boundary has a closed form.
        height = (target[i] + target[i + 1]) / pixels
        below = target[i] / max(target[i] + target[i + 1], 1e-300)
        s, first = slope[i] * height, slope[i] * height * below
        if s < 1e-6:
            ratio = math.log(max(1.0 - below, 1e-300) / max(below, 1e-300))
        else:
            ratio = math.log(max(-math.expm1(-(s - first)), 1e-300) / max(-math.expm1(-first), 1e-300)) - first
        # log((1 - e^-(s-first)) / (e^first - 1)) is the offset that splits [0, height] at the right volume.
        offset[i] = ratio - slope[i] * low
        low += target[i] / pixels
    _conserve(fluids, solids, out, work)
    return count


@inner
def _weigh(fluids: int, out: FloatArray, work: FloatArray) -> None:
    """Compute the relative amounts of the fluids in every pixel at the current offsets, scaled to a maximum of 1 per
    pixel.
    """
    slope, offset, highest = work[1], work[2], work[-1]
    pixels = out.shape[1]
    for p in range(pixels):
        out[1, p] = highest[p] = 0.0
    for i in range(fluids - 1):
        steep, shift = slope[i], offset[i]
        for p in range(pixels):
            level = out[1 + i, p] + (steep * ((p + 0.5) / pixels) + shift)
            out[2 + i, p] = level
            highest[p] = max(highest[p], level)
    for i in range(fluids):
        for p in range(pixels):
            gap = out[1 + i, p] - highest[p]
            out[1 + i, p] = 1.0 if gap == 0.0 else (math.exp(gap) if gap > _NEGLIGIBLE else 0.0)


@inner
def _dot(a: FloatArray, b: FloatArray, size: int) -> float:
    """Return the sum of products, in four partial sums so that additions do not wait for each other."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    whole = size - size % 4
    for p in range(0, whole, 4):
        s0 += a[p] * b[p]
        s1 += a[p + 1] * b[p + 1]
        s2 += a[p + 2] * b[p + 2]
        s3 += a[p + 3] * b[p + 3]
    for p in range(whole, size):
        s0 += a[p] * b[p]
    return (s0 + s1) + (s2 + s3)


@inner
def _share_out(fluids: int, out: FloatArray, work: FloatArray) -> float:
    """Multiply the fluids' amounts by their factors, and scale each pixel's to a sum of 1; reset the factors to 1.

    Returns:
        Largest deviation of a fluid from its target in pixels; those of all fluids are in the gradient.
    """
    pixels = out.shape[1]
    target, factor, gradient, scale, weight = work[3], work[5], work[6], work[-1], work[-2]
    for p in range(pixels):
        scale[p] = out[1, p]
    for i in range(1, fluids):
        times = factor[i]
        for p in range(pixels):
            scale[p] += times * out[1 + i, p]
    for p in range(pixels):
        scale[p] = 1.0 / scale[p]
    worst = 0.0
    for i in range(fluids):
        times = factor[i]
        for p in range(pixels):
            out[1 + i, p] *= times * scale[p]
        factor[i] = 1.0
        gradient[i] = _dot(weight, out[1 + i], pixels) - target[i]
        worst = max(worst, abs(gradient[i]))
    return worst


@inner
def _find_direction(fluids: int, out: FloatArray, work: FloatArray) -> tuple[float, float]:
    """Replace the gradient by Newton's step of the betas 1.. (beta_0 is 0).

    Returns:
        Decrease of the minimized function along the step at its start; largest change of a beta.
    """
    pixels = out.shape[1]
    target, level, gradient, scale, weight = work[3], work[4], work[6], work[-1], work[-2]
    hessian = work[7:-2]
    for i in range(1, fluids):
        for p in range(pixels):
            scale[p] = weight[p] * out[1 + i, p]
        for j in range(1, i + 1):
            hessian[i - 1, j - 1] = -_dot(scale, out[1 + j], pixels)
        hessian[i - 1, i - 1] += gradient[i] + target[i] + 1e-13
    for i in range(1, fluids):
        gradient[i - 1] = gradient[i]
        level[i - 1] = gradient[i]
    _solve(hessian, gradient, fluids - 1)
    falling, largest = 0.0, 0.0
    for i in range(fluids - 1):
        falling += level[i] * gradient[i]
        largest = max(largest, abs(gradient[i]))
    return falling, largest


@inner
def _step_length(fluids: int, falling: float, largest: float, out: FloatArray, work: FloatArray) -> float:
    """Return the share of Newton's step to take.

    The betas minimize a convex function (over pixels, the log of the sum of heights; minus target x beta). A step that
    does not lower it enough is halved; otherwise Newton's method can oscillate.
    """
    target, factor, gradient, weight = work[3], work[5], work[6], work[-2]
    step = min(1.0, _LONGEST_STEP / largest) if largest > 0.0 else 1.0
    while step * largest > _SURE_STEP:
        for i in range(fluids - 1):
            factor[i + 1] = math.exp(-step * gradient[i])
        change = 0.0
        for p in range(out.shape[1]):
            height = out[1, p]
            for i in range(1, fluids):
                height += factor[i] * out[1 + i, p]
            change += weight[p] * math.log(height)
        for i in range(fluids - 1):
            change += target[i + 1] * step * gradient[i]
        if change <= -1e-4 * step * falling:
            break
        step *= 0.5
    return step


@helper
def _conserve(fluids: int, solids: float, out: FloatArray, work: FloatArray) -> None:
    """Shift the offsets by Newton's method until every fluid's pixels add up to its target; then fill ``out``.

    The relative amounts are computed once; a Newton step multiplies them by one factor per fluid, so an iteration needs
    no exponentials of pixels.
    """
    pixels = out.shape[1]
    offset, factor, gradient, weight = work[2], work[5], work[6], work[-2]
    for p in range(pixels):
        solid = max(min(solids - p, 1.0), 0.0)
        out[0, p] = solid
        weight[p] = 1.0 - solid
    done = False
    for _ in range(_MOST_ITERATIONS):
        if done:
            break
        _weigh(fluids, out, work)
        for i in range(fluids):
            factor[i] = 1.0
        shifted = 0.0
        for _again in range(_MOST_ITERATIONS):
            if shifted >= _FARTHEST_SHIFT:
                break
            done = _share_out(fluids, out, work) < _TOLERANCE * pixels
            if done:
                break
            falling, largest = _find_direction(fluids, out, work)
            step = _step_length(fluids, falling, largest, out, work)
            before = 0.0
            for i in range(fluids - 1):
                shift = -step * gradient[i]
                offset[i] += shift - before
                factor[i + 1] = math.exp(shift)
                before = shift
            shifted += largest * step
    for i in range(fluids):
        for p in range(pixels):
            out[1 + i, p] *= weight[p]


@kernel
def camera(
    row: FloatArray, shares: FloatArray, layers: IntArray, chem: Handle, stream: StreamArray, out: FloatArray
) -> None:
    """Take a picture of the vessel: for each pixel one layer is drawn from the profile and shown as its grey value.

    Args:
        row: vessel row with the solids.
        shares: [C, pixels] the vessel's profile.
        layers: [C + 1] the profile's columns.
        chem: the chemistry.
        stream: random stream, advanced by one number per pixel unless the vessel is empty.
        out: [pixels] grey values, bottom first; 0 without a vessel.
    """
    chemistry = opened(Chemistry, chem)
    count, pixels = layers[0], out.shape[0]
    if count <= 2:
        solid = False
        for p in range(pixels):
            solid |= shares[0, p] > 0.0  # unlike a sum, computed for several pixels at a time
        if count < 2 or not solid:  # no vessel, or an empty one
            for p in range(pixels):
                out[p] = chemistry.shade[chemistry.air] if count == 2 else 0.0
            return
    draws, reached = scratch(_BLOCK), scratch(_BLOCK)
    for start in range(0, pixels, _BLOCK):
        many = min(_BLOCK, pixels - start)
        grey = out[start : start + many]
        uniforms(stream, draws[:many])
        # Layer by layer instead of pixel by pixel, which avoids unpredictable branches and processes several pixels at
        # a time. A pixel shows the highest layer whose lower bound is at or below its draw.
        for p in range(many):
            reached[p] = grey[p] = 0.0
        for c in range(1, count):
            shade, below = layer_shade(row, layers[1 + c], chem), shares[c - 1, start : start + many]
            for p in range(many):
                reached[p] += below[p]
                grey[p] = shade if draws[p] >= reached[p] else grey[p]
        _show_solids(row, chem, draws[:many], shares[0, start : start + many], grey)


@inner
def _show_solids(row: FloatArray, chem: Handle, draws: FloatArray, shares: FloatArray, grey: FloatArray) -> None:
    """Show a solid, drawn by volume, in pixels whose draw is below the solids' share."""
    chemistry = opened(Chemistry, chem)
    total, reached, solids = -1.0, 0.0, False
    for p in range(shares.shape[0]):
        solids |= shares[p] > 0.0  # unlike a maximum, computed for several pixels at a time
    for i in range(chemistry.role.shape[0] if solids else 0):
        mol = solid_mol(row, i, chem) if row[AMOUNTS + i] > 0.0 else 0.0
        if mol > 0.0:
            if total < 0.0:
                total = solid_volume(row, chem)
            for p in range(draws.shape[0]):
                if draws[p] < shares[p] and draws[p] / shares[p] * total >= reached:
                    grey[p] = chemistry.shade[i]
            reached += mol * chemistry.molar_volume[i]
