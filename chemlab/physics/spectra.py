"""UV-Vis spectra (PHYSICS section 6)."""

from __future__ import annotations

from ..arrays import FloatArray, Handle
from ..chemistry import AMOUNTS, Chemistry
from ..jit import helper, opened
from .transfer import liquid_volume

__all__ = ["spectrum"]


@helper
def spectrum(row: FloatArray, chem: Handle, out: FloatArray) -> None:
    """Absorption of the vessel's contents at 200 wavelengths: sum of concentration x peaks, clipped to [0, 1].

    Concentrations are mol per litre of liquid; what is suspended absorbs like what is dissolved. Without liquid
    there is nothing to look through and the spectrum is 0.
    """
    chemistry = opened(Chemistry, chem)
    litres = liquid_volume(row, chem)
    out[:] = 0.0
    if litres <= 1e-9:
        return
    for i in range(chemistry.role.shape[0]):
        if row[AMOUNTS + i] > 0.0:
            concentration = row[AMOUNTS + i] / litres
            for w in range(out.shape[0]):
                out[w] += concentration * chemistry.basis[i, w]
    for w in range(out.shape[0]):
        out[w] = min(max(out[w], 0.0), 1.0)
