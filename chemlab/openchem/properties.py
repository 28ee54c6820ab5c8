"""Properties of a compound: looked up, estimated by a named method, or missing; always with a source."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config.datafile import DataError
from ..config.extras import needs
from ..config.materials import Dimerization, VaporPressure
from ..physics.constants import ATMOSPHERE_PA, GAS_CONSTANT, ROOM_K
from .identity import Compound, molar_mass, parsed
from .names import is_metal

with needs("properties need chemicals and thermo", "chem"):
    import chemicals
    import thermo
    from rdkit.Chem import MolFromSmarts

DOUBTFUL = "doubtful: "
"""Prefix of the source of a number that other sources contradict but that is used."""

_CRC = "CRC Handbook, 95th ed. (2014)"
_PERRY = "Perry's Chemical Engineers' Handbook, 8th ed. (2007)"
_VDI = "VDI Heat Atlas, 2nd ed. (2010)"
_CITATIONS = {
    "ANTOINE_EXTENDED_POLING": "extended Antoine, Poling, Prausnitz and O'Connell (2001)",
    "ANTOINE_POLING": "Antoine, Poling, Prausnitz and O'Connell (2001)",
    "ANTOINE_WEBBOOK": "Antoine, NIST Chemistry WebBook",
    "ATCT_G": "Active Thermochemical Tables",
    "ATCT_L": "Active Thermochemical Tables",
    "COMMON_CHEMISTRY": "CAS Common Chemistry",
    "CRC": _CRC,
    "CRC_HVAP_298": f"{_CRC}, enthalpy of vaporization",
    "CRC_HVAP_TB": f"{_CRC}, enthalpy of vaporization",
    "CRC_INORG": f"{_CRC}, inorganic compounds",
    "CRC_INORG_L": f"{_CRC}, liquid inorganic compounds",
    "CRC_INORG_L_CONST": f"{_CRC}, liquid inorganic compounds",
    "CRC_INORG_S": f"{_CRC}, solid inorganic compounds",
    "CRC_ORG": f"{_CRC}, organic compounds",
    "CRCSTD": f"{_CRC}, standard thermodynamic properties",
    "DIPPR_PERRY_8E": f"DIPPR, {_PERRY}",
    "HEOS": "reference equation of state",
    "HEOS_FIT": "reference equation of state",
    "HTCOSTALDFIT": "COSTALD with fitted parameters, API Technical Data Book",
    "IUPAC": "IUPAC critical properties, J. Chem. Eng. Data 40-62 (1995-2017)",
    "JANAF": "NIST-JANAF thermochemical tables",
    "LANDOLT": "Landolt-Boernstein, New Series IV/20, Vapor Pressure of Chemicals (1999-2001)",
    "MATTHEWS": "Matthews, Chem. Rev. 72 (1972) 71",
    "MMSNM0FIT": "COSTALD-like fit of Mchaweh et al., Fluid Phase Equilib. 224 (2004) 157",
    "OPEN_NTBKM": "Open Notebook Melting Points (Bradley et al. 2014)",
    "PD": "Passut and Danner, Ind. Eng. Chem. Process Des. Dev. 12 (1973) 365",
    "PERRY151": f"{_PERRY}, heat capacities of solids",
    "PINAMARTINES": "Pina-Martinez et al., J. Chem. Eng. Data 63 (2018) 3980",
    "POLING_CONST": "Poling, Prausnitz and O'Connell (2001), heat capacities at 298.15 K",
    "POLING_POLY": "Poling, Prausnitz and O'Connell (2001)",
    "PSRK": "Horstmann et al., Fluid Phase Equilib. 227 (2005) 157",
    "RACKETTFIT": "Rackett with fitted parameter, API Technical Data Book",
    "TRCIG": "TRC Thermodynamics of Organic Compounds in the Gas State",
    "UNARY": "SGTE data for pure elements",
    "VDI_PPDS": _VDI,
    "VDI_TABULAR": _VDI,
    "WAGNER_MCGARRY": "Wagner, McGarry, Ind. Eng. Chem. Process Des. Dev. 22 (1983) 313",
    "WAGNER_POLING": "Wagner, Poling, Prausnitz and O'Connell (2001)",
    "WEBBOOK": "NIST Chemistry WebBook",
    "WEBBOOK_SHOMATE": "NIST Chemistry WebBook, Shomate equation",
    "YAWS": "Yaws (2014)",
    "ZABRANSKY_QUASIPOLYNOMIAL_C": "Zabransky et al. (1996)",
    "ZABRANSKY_QUASIPOLYNOMIAL_SAT": "Zabransky et al. (1996)",
    "ZABRANSKY_SPLINE_C": "Zabransky et al. (1996)",
    "ZABRANSKY_SPLINE_SAT": "Zabransky et al. (1996)",
}
_JOBACK = "Joback and Reid, Chem. Eng. Commun. 57 (1987) 233"
_JOBACK_ERROR = {"Tb": "12.9 K", "Tc": "4.8 K", "Hf": "8.4 kJ/mol", "Hfus": "2.0 kJ/mol"}
"""Mean absolute errors stated by the authors (from memory, not looked up)."""

_ZABRANSKY = (
    "ZABRANSKY_SPLINE_C", "ZABRANSKY_QUASIPOLYNOMIAL_C", "ZABRANSKY_SPLINE_SAT", "ZABRANSKY_QUASIPOLYNOMIAL_SAT",
)  # fmt: skip
_LIQUID_HEAT = ("CRCSTD", "POLING_CONST", *_ZABRANSKY, "HEOS_FIT", "WEBBOOK_SHOMATE", "VDI_TABULAR")
_SOLID_HEAT = ("CRCSTD", "PERRY151", "WEBBOOK_SHOMATE", "JANAF", "UNARY")
_GAS_HEAT = ("HEOS_FIT", "TRCIG", "CRCSTD", "POLING_POLY", "POLING_CONST", "WEBBOOK_SHOMATE", "JANAF")
_HEAT = {
    "l": ("HeatCapacityLiquid", _LIQUID_HEAT),
    "s": ("HeatCapacitySolid", _SOLID_HEAT),
    "g": ("HeatCapacityGas", _GAS_HEAT),
}
_SOLID_VOLUME = ("CRC_INORG_S",)
_LIQUID_VOLUME = (
    "DIPPR_PERRY_8E", "HEOS_FIT", "VDI_PPDS", "CRC_INORG_L", "CRC_INORG_L_CONST", "HTCOSTALDFIT", "RACKETTFIT",
    "MMSNM0FIT", "VDI_TABULAR", "COMMON_CHEMISTRY",
)  # fmt: skip
_VAPORIZATION = ("DIPPR_PERRY_8E", "CRC_HVAP_TB", "HEOS_FIT", "VDI_PPDS", "VDI_TABULAR")
_VAPOR_PRESSURE = (
    "DIPPR_PERRY_8E", "WAGNER_MCGARRY", "WAGNER_POLING", "VDI_PPDS", "HEOS_FIT", "ANTOINE_EXTENDED_POLING",
    "ANTOINE_POLING", "LANDOLT", "ANTOINE_WEBBOOK",
)  # fmt: skip
_CONSTANTS: dict[str, tuple[str, ...]] = {
    "Tb": ("CRC_ORG", "CRC_INORG", "HEOS", "YAWS", "COMMON_CHEMISTRY", "WEBBOOK"),
    "Tm": ("CRC_ORG", "CRC_INORG", "OPEN_NTBKM", "COMMON_CHEMISTRY", "WEBBOOK"),
    "Tc": ("IUPAC", "HEOS", "MATTHEWS", "CRC", "PSRK", "PD", "PINAMARTINES", "YAWS", "WEBBOOK"),
    "Pc": ("IUPAC", "HEOS", "MATTHEWS", "CRC", "PSRK", "PD", "PINAMARTINES", "YAWS", "WEBBOOK"),
    "Hfl": ("CRC", "ATCT_L", "WEBBOOK", "JANAF"),
    "Hfs": ("CRC", "WEBBOOK"),
    "Hfg": ("CRC", "ATCT_G", "WEBBOOK", "JANAF", "YAWS", "TRC"),
    "Hfus": ("CRC", "WEBBOOK"),
}
_AGREE = {"Tb": 6.0, "Tm": 6.0, "Tc": 12.0, "Pc": 4e5, "Hfl": 8e3, "Hfs": 8e3, "Hfg": 8e3, "Hfus": 2e3}
"""Maximum distance of a compilation from the median of all (K, Pa, J/mol); beyond it the next one is used."""
_SEVERAL = 4
"""Least number of compilations for the rejection of an outlier.

Example: benzyl chloride boils at 447 K in one compilation and at 452 K in three.
"""
_AGREE_SHARE = 0.08
"""Maximum distance from the median relative to it, for temperature-dependent properties."""
_UNITS = {"Tb": ("K", 1.0), "Tm": ("K", 1.0), "Tc": ("K", 1.0), "Pc": ("kPa", 1e3)}
_BELOW_K = 50.0
"""Distance in K below the estimate from which a boiling point of a single compilation counts as measured in vacuum."""
_REMEMBERED = f"{_CRC} (as remembered, not looked up)"
_USUAL_FORM = {"Sn": (7.287, f"white tin, {_REMEMBERED}"), "C": (2.2, f"graphite, {_REMEMBERED}")}
"""Density in kg/L of elements for which thermo's compilation has another form (grey tin) or none."""
_FACTOR = {"l": 1.4, "s": 1.5}
"""Maximum ratio of a heat capacity and its estimates, up and down.

Estimates of solids are coarser: such a number is marked as doubtful and used.
"""
_WITNESS = 0.25
"""Maximum relative distance of a vapour pressure from an atmosphere that confirms a boiling point."""
_MET = 0.04
"""Maximum relative distance of a vapour pressure from an atmosphere at the boiling point; a material accepts 0.1."""
_WATSON = 0.38
_NEARLY_K = 3.0
"""A material whose melting point is less than this above room temperature is treated as a liquid."""
_VOLUMES = {"H": 1.0, **dict.fromkeys(("Li", "Be", "B", "C", "N", "O", "F"), 2.0)} | {
    **dict.fromkeys(("Na", "Mg", "Al", "Si", "P", "S", "Cl"), 4.0),
    **dict.fromkeys(("K", "Ca", "Ga", "Ge", "As", "Se", "Br"), 5.0),
    **dict.fromkeys(("Rb", "Sr", "In", "Sn", "Sb", "Te", "I"), 7.5),
}
"""Girolami's atomic volumes in units of 5 mL/mol."""
_CARBOXYL = "[CX3](=[OX1])[OX2H1]"
_DIMER_ENTHALPY, _DIMER_ENTROPY, _FORMIC_ENTROPY = -58_500.0, -136.0, -149.0
"""J/mol and J/mol/K of dimers in the vapour of acids with two to five carbon atoms, and of formic acid."""
_MEASURED_ACIDS = 5
_DIMER_SOURCE = (
    "vapour densities, Miyamoto et al., J. Chem. Eng. Data 44 (1999) 48, from its abstract; it names no unit of K, and "
    "1/atm is inferred from heats of vaporization"
)
_ASSOCIATING = ("[OX2H1]", "[NX3;H1,H2]", "[NX3;H0][CX3]=[OX1]", "[#16X3]=[OX1]", "[#16X4](=[OX1])=[OX1]")
"""Groups that each raise the density by a tenth: hydroxyl and carboxyl, amines, amides, sulfoxides, sulfones."""


@dataclass(frozen=True)
class Value:
    """A number and its source."""

    number: float
    source: str

    @property
    def estimated(self) -> bool:
        """True if the number is an estimate."""
        return self.source.startswith("estimate")


def fitted_vapor_pressure(temperature_k: Any, pascal: Any) -> tuple[VaporPressure, float]:
    """Fit DIPPR 101 to a curve.

    Args:
        temperature_k: [n] temperatures in K, ascending.
        pascal: [n] vapour pressures in Pa.

    Returns:
        The formula and its largest relative error on the curve.

    Raises:
        DataError: the best fit is not a valid formula, for instance because it does not rise everywhere.
    """
    t, log = np.asarray(temperature_k, dtype=np.float64), np.log(np.asarray(pascal, dtype=np.float64))
    best: tuple[float, tuple[float, ...]] | None = None
    for power in (1.0, 2.0, 6.0):
        columns = np.stack([np.ones_like(t), 1.0 / t, np.log(t), t**power], axis=1)
        scale = np.abs(columns).max(axis=0)
        solution = np.linalg.lstsq(columns / scale, log, rcond=None)[0] / scale
        coefficients = tuple(float(f"{number:.9g}") for number in solution)
        error = float(np.abs(np.expm1(columns @ np.array(coefficients) - log)).max())
        if best is None or error < best[0]:
            best = error, (*coefficients, power)
    assert best is not None
    try:
        formula = VaporPressure(
            form="dippr101", coefficients=best[1], low_k=round(float(t[0]), 2), high_k=round(float(t[-1]), 2)
        )
    except ValueError as error:
        raise DataError(f"vapor_pressure: DIPPR 101 does not fit: {error}") from error
    return formula, best[0]


def _agreeing(found: Mapping[str, float], tolerance: float, referee: float | None) -> str:
    """Return the compilation to use: the first one near the median, with a lower tolerance if many agree closely.

    Of two distant compilations, the one nearer to an estimate (``referee``) is used. If the median lies between groups,
    it is the first of the largest group.
    """
    values = list(found.values())
    if len(values) == 2 and abs(values[0] - values[1]) > tolerance and referee is not None:
        return min(found, key=lambda method: abs(found[method] - referee))
    middle = float(np.median(values))
    if len(values) >= _SEVERAL:
        scatter = float(np.median([abs(value - middle) for value in values]))
        tolerance = min(tolerance, max(0.25 * tolerance, 5.0 * scatter))
    near = next((method for method, value in found.items() if abs(value - middle) <= tolerance), None)
    if near is not None and (len(values) < 3 or _supporters(found, near, tolerance) > 1):
        return near
    return max(found, key=lambda method: _supporters(found, method, tolerance))


def _corrected(boiling: float) -> float:
    """Return Joback's boiling point corrected for its bias for large molecules.

    The correction is by Stein and Brown, J. Chem. Inf. Comput. Sci. 34 (1994) 581, from memory. For 5,653 compounds
    whose compilations agree, the mean error is 21 K, and 28 K without it.
    """
    if boiling <= 700.0:
        return boiling - 94.84 + 0.5577 * boiling - 0.0007705 * boiling**2
    return boiling + 282.7 - 0.5209 * boiling


def _supporters(found: Mapping[str, float], method: str, tolerance: float) -> int:
    """Return the number of compilations that agree with one of them, itself included."""
    return sum(abs(value - found[method]) <= tolerance for value in found.values())


def _against(found: Mapping[str, float], method: str, tolerance: float, shown: Callable[[float], str]) -> str:
    """Return the prefix of a source that at least as many compilations contradict as support; otherwise ""."""
    near = _supporters(found, method, tolerance)
    if len(found) - near < near:
        return ""
    far = ", ".join(f"{shown(v)} ({m})" for m, v in found.items() if abs(v - found[method]) > tolerance)
    return f"{DOUBTFUL}compilations disagree: {far}; "


def _not_taken(value: Value, unit: str, why: str) -> str:
    """Return a remark on a rejected number, for the source of the estimate that replaces it."""
    cited = value.source.replace("[", "(").replace("]", ")")
    return f"not taken: {value.number:.5g} {unit}, {cited}, {why}"


class Properties:
    """Properties of a compound, each computed on first access; None if a property is not found.

    Args:
        compound: the compound.
        given: the user's own values by field, which take precedence.
    """

    def __init__(self, compound: Compound, given: Mapping[str, Value] | None = None) -> None:
        self.compound, self.given = compound, dict(given or {})
        self.mass = molar_mass(compound.composition)
        self.metal = is_metal(compound.composition)

    # Looked-up values ------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _joback(self) -> Any:
        """thermo's Joback object; None if the molecule does not consist of Joback's groups."""
        joback = thermo.Joback(self.compound.smiles)
        return joback if joback.success else None

    def _listed(self, name: str) -> dict[str, float]:
        """Return a constant's values by compilation."""
        if self.compound.cas is None:
            return {}
        lookup, methods = getattr(chemicals, name), getattr(chemicals, f"{name}_methods")(self.compound.cas)
        return {m: float(lookup(self.compound.cas, method=m)) for m in _CONSTANTS[name] if m in methods}

    def _constant(self, name: str, referee: float | None = None) -> Value | None:
        """Return a constant's value of the first compilation that agrees with the others (:func:`_agreeing`)."""
        found = self._listed(name)
        if not found:
            return None
        chosen = _agreeing(found, _AGREE[name], referee)
        others = [value for method, value in found.items() if method != chosen]
        unit, factor = _UNITS.get(name, ("kJ/mol", 1e3))
        source = _CITATIONS.get(chosen, chosen)
        if others:
            spread = max(abs(value - found[chosen]) for value in others) / factor
            number = "another compilation" if len(others) == 1 else f"{len(others)} other compilations"
            source += f"; {number} within {spread:.2g} {unit}"
        doubt = _against(found, chosen, 2.0 * _AGREE[name], lambda value: f"{value / factor:.5g} {unit}")
        return Value(found[chosen], f"{doubt}{source} [{chosen}]")

    def _estimate(self, name: str, method: str, number: float | None) -> Value | None:
        if number is None or not math.isfinite(number):
            return None
        error = _JOBACK_ERROR.get(name) if method == _JOBACK else None
        return Value(float(number), f"estimate: {method}{f'; its mean error is {error}' if error else ''}")

    def _tabulated(self, kind: str, temperature: float, methods: Iterable[str]) -> dict[str, float]:
        """Return a temperature-dependent property by every method that is valid at this temperature."""
        data, values = self._thermo(kind), {}
        for method in methods:
            if data is None or method not in data.all_methods:
                continue
            low, high = data.T_limits.get(method, (0.0, math.inf))
            if not low - 0.01 <= temperature <= high + 0.01:
                continue
            value = self._calculated(data, temperature, method)
            if isinstance(value, float) and math.isfinite(value) and value > 0.0:
                values[method] = value
        return values

    @staticmethod
    def _calculated(data: Any, temperature: float, method: str) -> Any:
        """Return a method's value; None if its table cannot be read (elements have two rows at a transition)."""
        try:
            return data.calculate(temperature, method)
        except ValueError:
            return None

    def _correlation(
        self, kind: str, temperature: float, methods: Iterable[str], referee: float | None = None
    ) -> Value | None:
        """Return a property by the first method that agrees with the others (:func:`_agreeing`)."""
        found = self._tabulated(kind, temperature, methods)
        if not found:
            return None
        share = _AGREE_SHARE * float(np.median(list(found.values())))
        method = _agreeing(found, share, referee)
        number = found[method]
        doubt = _against(found, method, 2.0 * share, lambda value: f"{100.0 * (value / number - 1.0):+.0f} %")
        return Value(number, f"{doubt}{_CITATIONS.get(method, method)} [{method}]")

    def _constant_of(self, field: str) -> str | None:
        """Return the name of a field's constant; None for a property that depends on temperature."""
        constants = {"boiling_point": "Tb", "melting_point": "Tm", "critical_temperature": "Tc"}
        return (constants | {"fusion_enthalpy": "Hfus", "formation_enthalpy": f"Hf{self.state}"}).get(field)

    def doubt(self, field: str) -> str:
        """Return the prefix of the source of a user's value that is far from the compilations; otherwise "".

        Args:
            field: field of a material file.
        """
        name = re.sub("_(k|kg_l|j_mol|j_mol_k)$", "", field)
        values = list(self.compilations(name).values()) if field in self.given else []
        if not values:
            return ""
        middle = float(np.median(values))
        tolerance = _AGREE.get(self._constant_of(name) or "", _AGREE_SHARE * middle)
        near = abs(self.given[field].number - middle) <= tolerance
        return "" if near else f"{DOUBTFUL}compilations say {middle:.5g}; "

    def compilations(self, field: str) -> dict[str, float]:
        """Return the values of a property by compilation, in the units of a material file.

        The vapour pressure is in Pa, at 0.85 times the boiling point.

        Args:
            field: the name of one of the properties below.
        """
        if constant := self._constant_of(field):
            return self._listed(constant)
        boils = self.boiling_point.number if self.boiling_point else ROOM_K
        state, kelvin = self._handled
        if field == "vaporization_enthalpy":
            return self._tabulated("EnthalpyVaporization", boils, _VAPORIZATION)
        if field == "vapor_pressure":
            return self._tabulated("VaporPressure", 0.85 * boils, _VAPOR_PRESSURE)
        if field == "heat_capacity":
            return self._tabulated(_HEAT[state][0], kelvin, _HEAT[state][1])
        kind, methods = {"l": ("VolumeLiquid", _LIQUID_VOLUME), "s": ("VolumeSolid", _SOLID_VOLUME)}.get(
            state, ("VolumeGas", ())
        )
        return {m: self.mass / volume / 1e6 for m, volume in self._tabulated(kind, kelvin, methods).items()}

    @functools.cache  # noqa: B019 - a compound's object lives as long as the command
    def _thermo(self, kind: str) -> Any:
        if self.compound.cas is None:
            return None
        wanted: dict[str, Any] = {"MW": self.mass} if kind.startswith(("Heat", "Volume")) else {}
        return getattr(thermo, kind)(CASRN=self.compound.cas, **wanted)

    @functools.cached_property
    def boiling_point(self) -> Value | None:
        """Boiling point in K at 101.325 kPa.

        A value of a single compilation far below the estimate counts as measured in vacuum and is rejected.
        """
        guess = self._estimate("Tb", _JOBACK, self._joback.Tb(self._joback.counts)) if self._joback else None
        known = self.given.get("boiling_point_k") or self._constant("Tb", guess.number if guess else None)
        if known is None or guess is None or "boiling_point_k" in self.given:
            return known or guess
        below = min(guess.number, _corrected(guess.number)) - known.number
        if below <= _BELOW_K or self._boils_at(known.number):
            return known
        if len(self._listed("Tb")) == 1:
            words = f"{below:.0f} K below, as if under vacuum"
            return Value(guess.number, f"{guess.source}; {_not_taken(known, 'K', words)}")
        if known.source.startswith(DOUBTFUL):
            return known
        return Value(known.number, f"{DOUBTFUL}{below:.0f} K below the estimate, as if under vacuum; {known.source}")

    def _boils_at(self, temperature: float) -> bool:
        """Return True if a measured vapour pressure is about an atmosphere at this temperature."""
        pressures = self._tabulated("VaporPressure", temperature, _VAPOR_PRESSURE).values()
        return any(abs(pascal / ATMOSPHERE_PA - 1.0) < _WITNESS for pascal in pressures)

    @functools.cached_property
    def melting_point(self) -> Value | None:
        """Melting point in K; never estimated, because an error of 20 K decides whether a compound is solid."""
        return self.given.get("melting_point_k") or self._constant("Tm")

    def _boils_by_estimate(self) -> bool:
        """Return True if the boiling point is an estimate; the critical point is then estimated consistently."""
        return self.boiling_point is not None and self.boiling_point.estimated and self._joback is not None

    @functools.cached_property
    def critical_temperature(self) -> Value | None:
        """Critical temperature in K."""
        boils = self.boiling_point
        given = self.given.get("critical_temperature_k")
        if given and boils is not None and given.number <= boils.number:
            raise DataError(
                f"{self.compound.key}: critical_temperature_k = {given.number:g} must be above the boiling point, "
                f"{boils.number:g} K [{boils.source}]; give another value, or boiling_point_k, too"
            )
        known = given or (None if self._boils_by_estimate() else self._constant("Tc"))
        if known is not None and (given or boils is None or known.number > 1.1 * boils.number):
            return known
        if boils is None:
            return None
        if self._joback:
            found = self._estimate("Tc", _JOBACK, self._joback.Tc(self._joback.counts, boils.number))
        else:
            wilson = chemicals.Tc(self.compound.cas, method="WILSON_JASPERSON") if self.compound.cas else None
            found = self._estimate("Tc", "Wilson and Jasperson (1996)", wilson)
        # For very large molecules, Joback's polynomial gives a critical point below the boiling point, or 0 K.
        return found if found is not None and found.number > boils.number else None

    @functools.cached_property
    def critical_pressure(self) -> Value | None:
        """Critical pressure in Pa."""
        known = None if self._boils_by_estimate() else self._constant("Pc")
        if known is None and self._joback:
            atoms = sum(self.compound.composition.values())
            return self._estimate("Pc", _JOBACK, self._joback.Pc(self._joback.counts, atoms))
        if known is None and self.compound.cas:
            wilson = chemicals.Pc(self.compound.cas, method="WILSON_JASPERSON")
            return self._estimate("Pc", "Wilson and Jasperson (1996)", wilson)
        return known

    @property
    def state(self) -> str:
        """``l``, ``s`` or ``g`` at 298.15 K; liquid if no melting point is known."""
        boils, melts = self.boiling_point, self.melting_point
        if boils is not None and boils.number <= ROOM_K:
            return "g"
        return "s" if melts is not None and melts.number > ROOM_K else "l"

    @property
    def _handled(self) -> tuple[str, float]:
        """State and temperature in K to which density and heat capacity refer.

        A material that melts slightly above room temperature (tert-butanol) is treated as a liquid and has the values
        of the melt.
        """
        melts = self.melting_point
        if self.state == "s" and not self.metal and melts is not None and melts.number < ROOM_K + _NEARLY_K:
            return "l", melts.number + 0.05  # correlations of the melt begin at the melting point
        return self.state, ROOM_K

    # Derived values --------------------------------------------------------------------------------------------------

    def _critical(self) -> tuple[float, float, float] | None:
        """Return Tb, Tc, Pc if all are known."""
        parts = self.boiling_point, self.critical_temperature, self.critical_pressure
        return None if None in parts else tuple(p.number for p in parts if p)  # type: ignore[return-value]

    @functools.cached_property
    def vaporization_enthalpy(self) -> Value | None:
        """Heat of vaporization in J/mol at the boiling point."""
        if given := self.given.get("vaporization_enthalpy_j_mol"):
            return given
        boils = self.boiling_point
        if boils is None:
            return None
        if known := self._correlation("EnthalpyVaporization", boils.number, _VAPORIZATION):
            return known
        if self.metal:
            return Value(88.0 * boils.number, "estimate: Trouton's rule, 88 J/mol/K; a solid never boils here")
        critical = self._critical()
        if critical is None:
            return None
        return self._estimate("Hvap", "Chen (1965), J. Chem. Eng. Data 10, 207", chemicals.Chen(*critical))

    def _vaporization_at_room(self) -> Value | None:
        """Return the heat of vaporization in J/mol at 298.15 K, from tables or extrapolated (Watson 1943)."""
        if known := self._correlation("EnthalpyVaporization", ROOM_K, ("CRC_HVAP_298",)):
            return known
        heat, boils, critical = self.vaporization_enthalpy, self.boiling_point, self.critical_temperature
        if heat is None or boils is None or critical is None:
            return None
        share = (critical.number - ROOM_K) / (critical.number - boils.number)
        return Value(heat.number * share**_WATSON, "heat of vaporization at the boiling point carried on (Watson 1943)")

    @functools.cached_property
    def vapor_pressure(self) -> tuple[VaporPressure, str] | None:
        """Vapour pressure of the liquid, and its source."""
        boils, data = self.boiling_point, self._thermo("VaporPressure")
        if boils is None:
            return None
        top = self.critical_temperature.number if self.critical_temperature else 2.0 * boils.number
        for method in _VAPOR_PRESSURE:
            if data is None or method not in data.all_methods:
                continue
            low, high = data.T_limits[method]
            low, high = max(low, 0.45 * boils.number, 150.0), min(high, 0.97 * top)
            if low > boils.number - 25.0 or high < boils.number - 5.0:
                continue
            t = np.linspace(low, high, 60)
            fit = self._curve(t, [self._calculated(data, float(x), method) for x in t], boils.number)
            if fit is not None:
                return fit[0], f"fit of DIPPR 101 within {fit[1]:.2g} % to {_CITATIONS[method]} [{method}]"
        critical = self._critical()
        if critical is None:
            return None
        boiling, tc, pc = critical
        omega = chemicals.LK_omega(boiling, tc, pc)
        t = np.linspace(0.5 * tc, 0.95 * tc, 60)
        fit = self._curve(t, [chemicals.Lee_Kesler(float(x), tc, pc, omega) for x in t], boiling)
        source = "estimate: Lee and Kesler, AIChE J. 21 (1975) 510, through the boiling point"
        return None if fit is None else (fit[0], f"{source}; fit of DIPPR 101 within {fit[1]:.2g} %")

    @functools.cached_property
    def dimerization(self) -> tuple[Dimerization, str] | None:
        """Dimerization in the vapour of an acid with one carboxyl group and no other oxygen, and its source.

        None for other compounds.
        """
        atoms = self.compound.composition
        if not atoms.keys() <= {"C", "H", "O"} or atoms.get("O") != 2:
            return None
        molecule = parsed(self.compound.smiles, self.compound.key)
        if not molecule.HasSubstructMatch(MolFromSmarts(_CARBOXYL)):
            return None
        carbons = atoms["C"]
        measured = carbons <= _MEASURED_ACIDS and atoms["H"] == 2 * carbons
        entropy = _FORMIC_ENTROPY if carbons == 1 else _DIMER_ENTROPY
        dimers = Dimerization(enthalpy_j_mol=_DIMER_ENTHALPY, entropy_j_mol_k=entropy)
        return dimers, _DIMER_SOURCE if measured else f"estimate: as of acetic to valeric acid, {_DIMER_SOURCE}"

    @staticmethod
    def _curve(t: Any, pascal: Sequence[Any], boiling: float) -> tuple[VaporPressure, float] | None:
        """Return the fit of DIPPR 101 and its error in %; None unless it gives an atmosphere at the boiling point."""
        if any(not isinstance(p, float) or not math.isfinite(p) or p <= 0.0 for p in pascal):
            return None
        try:
            formula, error = fitted_vapor_pressure(t, pascal)
        except DataError:
            return None
        met = abs(float(formula.pascal(boiling)) / ATMOSPHERE_PA - 1.0) < _MET
        return (formula, 100.0 * error) if met and error < 0.03 else None

    @functools.cached_property
    def density(self) -> Value | None:
        """Density in kg/L at 298.15 K; of a gas at 101.325 kPa."""
        if given := self.given.get("density_kg_l"):
            return given
        state, kelvin = self._handled
        if state == "g":
            density = self.mass * ATMOSPHERE_PA / (GAS_CONSTANT * ROOM_K) / 1e6
            return Value(density, "ideal gas law at 298.15 K and 101.325 kPa")
        if state == "s":
            return self._solid_density()
        known = self._correlation("VolumeLiquid", kelvin, _LIQUID_VOLUME)
        if known is not None:
            return Value(self.mass / known.number / 1e6, known.source)
        return self._estimated_density()

    def _estimated_density(self) -> Value | None:
        """Return an estimate of a liquid's density.

        It is by corresponding states for hydrocarbons. For other compounds, it is the geometric mean of two kinds of
        estimates, whose errors are independent.
        """
        tc, pc, critical = self.critical_temperature, self.critical_pressure, self._critical()
        other = self._girolami(1.0, "")
        if not (tc and pc and critical) or tc.estimated or pc.estimated:
            return other
        volumes = self._corresponding_states(*critical)
        words = "an equation" if len(volumes) == 1 else f"median of {len(volumes)} equations"
        density = self.mass / float(np.median(list(volumes.values()))) / 1e6
        source = f"{words} of corresponding states ({', '.join(volumes)})"
        if other is None or self.compound.composition.keys() <= {"C", "H"}:
            return Value(density, f"estimate: {source}")
        mean = math.sqrt(density * other.number)
        return Value(mean, f"estimate: mean of {other.source.removeprefix('estimate: ')}, and of the {source}")

    def _corresponding_states(self, boiling: float, tc: float, pc: float) -> dict[str, float]:
        """Return the liquid's molar volume in m3/mol at 298.15 K by equations of corresponding states."""
        cas = self.compound.cas
        omega = (chemicals.omega(cas) if cas else None) or chemicals.LK_omega(boiling, tc, pc)
        found = {"Yamada and Gunn 1973": chemicals.Yamada_Gunn(ROOM_K, tc, pc, omega)}
        vc = chemicals.Vc(cas) if cas else None
        if vc:
            found["COSTALD 1979"] = chemicals.COSTALD(ROOM_K, tc, vc, omega)
            found["Mchaweh et al. 2004"] = chemicals.SNM0(ROOM_K, tc, vc, omega)
            found["Townsend and Hales 1976"] = chemicals.Townsend_Hales(ROOM_K, tc, vc, omega)
            zc = pc * vc / (GAS_CONSTANT * tc)
            found["Yen and Woods 1966"] = chemicals.Yen_Woods_saturation(ROOM_K, tc, vc, zc)
        return {method: float(volume) for method, volume in found.items()}

    def _girolami(self, factor: float, more: str) -> Value | None:
        """Return the density of a liquid of main-group elements from atomic volumes, times a factor."""
        atoms = self.compound.composition
        if not atoms.keys() <= _VOLUMES.keys():
            return None
        molecule = parsed(self.compound.smiles, self.compound.key)
        raised = sum(len(molecule.GetSubstructMatches(MolFromSmarts(group))) for group in _ASSOCIATING)
        rings = [set(ring) for ring in molecule.GetRingInfo().BondRings()]
        fused = sum(any(ring & other for other in rings if other is not ring) for ring in rings)
        raised_by = 0.1 * (raised + len(rings) - fused) + 0.075 * fused
        volume = 5.0 * sum(n * _VOLUMES[element] for element, n in atoms.items())
        density = self.mass / volume * (1.0 + min(raised_by, 0.3)) * factor
        return Value(density, f"estimate: Girolami, J. Chem. Educ. 71 (1994) 962{more}")

    def _solid_density(self) -> Value | None:
        if self.compound.formula in _USUAL_FORM:
            return Value(*_USUAL_FORM[self.compound.formula])
        known = self._correlation("VolumeSolid", ROOM_K, _SOLID_VOLUME)
        if known is not None:
            return Value(self.mass / known.number / 1e6, known.source)
        melts = self.melting_point
        if melts is None or self.metal:  # atoms in a lattice have other volumes than in molecules
            return None
        goodman = "Goodman et al., J. Chem. Eng. Data 49 (2004) 1512"
        measured = self._correlation("VolumeLiquid", melts.number, _LIQUID_VOLUME)
        if measured is not None:
            volume = chemicals.Goodman(ROOM_K, melts.number, measured.number)
            return Value(self.mass / volume / 1e6, f"estimate: {goodman}, from the melt's by {measured.source}")
        return self._girolami(1.28 - 0.16 * ROOM_K / melts.number, f" for the melt, {goodman}, for the solid")

    @functools.cached_property
    def heat_capacity(self) -> Value | None:
        """Heat capacity in J/mol/K at 298.15 K."""
        if given := self.given.get("heat_capacity_j_mol_k"):
            return given
        state, kelvin = self._handled
        kind, methods = _HEAT[state]
        guess = self._heat_estimate()
        known = self._correlation(kind, kelvin, methods, guess.number if guess else None)
        if known is None or guess is None or len(self._tabulated(kind, kelvin, methods)) > 1:
            return known or guess
        off = min((abs(math.log(known.number / number)) for number in self._heat_referees()), default=0.0)
        if off <= math.log(_FACTOR.get(state, math.inf)):
            return known
        times = f"{math.exp(off):.2g} times off all estimates"
        if state == "s":
            return Value(known.number, f"{DOUBTFUL}{times}; {known.source}")
        return Value(guess.number, f"{guess.source}; {_not_taken(known, 'J/mol/K', times)}")

    def _heat_referees(self) -> list[float]:
        """Return estimates of an organic liquid's or solid's heat capacity in J/mol/K; an empty list for others."""
        guess, critical = self._heat_estimate(), self._critical()
        if guess is None or self._joback is None or not {"C", "H"} <= self.compound.composition.keys():
            return []
        if self._handled[0] != "l":
            return [guess.number]
        gas = self._joback.Cpig(ROOM_K)
        if not gas or critical is None or critical[1] < 1.05 * ROOM_K:
            return []
        omega = chemicals.LK_omega(*critical)
        return [guess.number, float(chemicals.Rowlinson_Poling(ROOM_K, critical[1], omega, gas))]

    def _heat_estimate(self) -> Value | None:
        similarity, (state, _) = sum(self.compound.composition.values()) / self.mass, self._handled
        if state == "g":
            return self._estimate("Cp", _JOBACK, self._joback.Cpig(ROOM_K)) if self._joback else None
        if state == "s":
            method = "Lastovka et al., Fluid Phase Equilib. 268 (2008) 51"
            return self._estimate("Cp", method, chemicals.Lastovka_solid(ROOM_K, similarity, self.mass))
        method = "Dadgostar and Shaw, Fluid Phase Equilib. 313 (2012) 211"
        return self._estimate("Cp", method, chemicals.Dadgostar_Shaw(ROOM_K, similarity, self.mass))

    @functools.cached_property
    def formation_enthalpy(self) -> tuple[Value, str] | None:
        """Formation enthalpy in J/mol at 298.15 K, and the state it refers to."""
        state = self.state
        if given := self.given.get("formation_enthalpy_j_mol"):
            return given, state
        if self.metal:
            return Value(0.0, "an element in its standard state"), state
        joback = self._estimate("Hf", _JOBACK, self._joback.Hf(self._joback.counts)) if self._joback else None
        heat = self._vaporization_at_room() if state != "g" else None
        referee = joback.number - (heat.number if heat else 0.0) if joback else None
        for name in {"l": ("Hfl",), "s": ("Hfs", "Hfl"), "g": ("Hfg",)}[state]:
            if known := self._constant(name, referee):
                return known, name[-1]
        gas = self._constant("Hfg", joback.number if joback else None) or joback
        if gas is None or state == "g":
            return None if gas is None else (gas, "g")
        if heat is None:
            return None
        source = f"estimate: that of the gas ({gas.source.removeprefix('estimate: ')}) less {heat.source}"
        return Value(gas.number - heat.number, source), "l"

    @functools.cached_property
    def fusion_enthalpy(self) -> Value | None:
        """Enthalpy of fusion in J/mol at the melting point of solids at room temperature; liquids do not freeze."""
        if given := self.given.get("fusion_enthalpy_j_mol"):
            return given
        if self.state != "s" or self.metal:
            return None
        known = self._constant("Hfus")
        if known is None and self._joback:
            return self._estimate("Hfus", _JOBACK, self._joback.Hfus(self._joback.counts))
        return known
