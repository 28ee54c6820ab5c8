"""UV-Vis spectra (PHYSICS section 6)."""

from __future__ import annotations

from ..kernels.arrays import FloatArray, Handle
from ..kernels.jit import helper, inner, opened
from .chemistry import AMOUNTS, Chemistry
from .transfer import liquid_volume


@inner
def _next_present(row: FloatArray, i: int, n: int) -> int:
    """Return the index of the next material from ``i`` on that is in the vessel; ``n`` if there is none."""
    while i < n and row[AMOUNTS + i] <= 0.0:
        i += 1
    return i


@helper
def spectrum(row: FloatArray, chem: Handle, out: FloatArray) -> None:
    """Compute the absorption at 200 wavelengths: the sum of concentration x peaks, clipped to [0, 1].

    Concentrations are mol per litre of liquid; suspended material absorbs like dissolved material. Without liquid the
    spectrum is 0.
    """
    chemistry = opened(Chemistry, chem)
    litres = liquid_volume(row, chem)
    out[:] = 0.0
    if litres <= 1e-9:
        return
    basis, n = chemistry.basis, chemistry.role.shape[0]
    i = _next_present(row, 0, n)
    while i < n:
        # Two at a time, because the time is dominated by memory access to the sums.
        other, following = i, _next_present(row, i + 1, n)
        first, second = row[AMOUNTS + i] / litres, 0.0
        if following < n:
            other, second = following, row[AMOUNTS + following] / litres
            following = _next_present(row, following + 1, n)
        for w in range(out.shape[0]):
            out[w] = out[w] + first * basis[i, w] + second * basis[other, w]
        i = following
    for w in range(out.shape[0]):
        out[w] = min(max(out[w], 0.0), 1.0)
