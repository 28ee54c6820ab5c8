"""Readings against closed forms from the data files; calibration, detection limit and noise; what a tier refuses."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import laboratory, manager, mapping

from chemlab.config.datafile import DataError
from chemlab.config.loading import dump_scenario, load_scenario
from chemlab.config.materials import shipped_materials
from chemlab.config.scenario import InstrumentSpec
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.roles.instruments import INSTRUMENTS
from chemlab.sandbox import Flask

MATERIALS = shipped_materials()
TIERS = ("paper", "real")

ACETIC = """
name = "acetic"

[[acid]]
species = ["acetic_acid", "acetate"]
pka = [4.756]
source = "CRC Handbook"
"""


def grams(name: str, mol: float) -> float:
    return mol * MATERIALS[name].molar_mass_g_mol


@pytest.mark.parametrize("contents", [{}, {"diethyl_ether": 1.0, "NaCl": 0.1}, {"benzoic_acid": 1.0}])
def test_every_reading_is_finite(contents: dict[str, float]) -> None:
    """Of the empty flask, too; and in words."""
    flask = Flask(contents)
    for kind in INSTRUMENTS:
        reading = flask.measure(kind)
        assert np.isfinite(reading.values).all(), kind
        assert reading.words, kind
        assert len(reading.labels) in (0, len(reading.values)), kind


@pytest.mark.parametrize("physics", TIERS)
def test_density_and_temperature_of_a_mixture(physics: str) -> None:
    """Mass over volume; in the paper's tier, of a solvent. Solids lie below."""
    contents = {"diethyl_ether": 2.0, "dodecane": 1.0} if physics == "real" else {"diethyl_ether": 2.0}
    litres = sum(grams(name, mol) / 1000.0 / MATERIALS[name].density_kg_l for name, mol in contents.items())
    kilograms = sum(grams(name, mol) for name, mol in contents.items()) / 1000.0
    flask = Flask({**contents, "NaCl": 0.5} if physics == "real" else contents, physics=physics, temperature_k=303.0)
    assert float(flask.measure("thermometer")) == pytest.approx(flask.temperature_k)
    assert float(flask.measure("density_meter")) == pytest.approx(kilograms / litres, rel=1e-6)


@pytest.mark.parametrize("physics", TIERS)
def test_water_by_karl_fischer(physics: str) -> None:
    flask = Flask({"diethyl_ether": 4.0, "water": 0.1}, physics=physics)
    water, ether = grams("water", 0.1), grams("diethyl_ether", 4.0)
    assert float(flask.measure("karl_fischer")) == pytest.approx(water / (water + ether), rel=1e-9)
    assert float(Flask({"hexane": 1.0}, physics=physics).measure("karl_fischer")) == 0.0


def test_ph_of_a_buffer(tmp_path: Path) -> None:
    """Henderson and Hasselbalch, with the activity of acetate by Davies at an ionic strength of 0.1 mol/kg."""
    path = tmp_path / "acetic.toml"
    path.write_text(ACETIC, encoding="utf-8")
    water = 1000.0 / MATERIALS["water"].molar_mass_g_mol
    buffer = {"water": water, "Na+": 0.1, "acetate": 0.1}
    for acid in (0.1, 0.01):
        flask = Flask({**buffer, "acetic_acid": acid}, capacity_l=2.0, reactions=str(path))
        root = math.sqrt(0.1)
        expected = 4.756 + math.log10(0.1 / acid) - 0.509 * (root / (1.0 + root) - 0.3 * 0.1)
        assert float(flask.measure("ph_meter")) == pytest.approx(expected, abs=0.01)
    assert float(Flask({"hexane": 1.0}).measure("ph_meter")) == pytest.approx(-2.0)


def test_impurities_lower_the_melting_point() -> None:
    """Schroeder and van Laar; for little of it van 't Hoff's R T^2 x / H."""
    material = MATERIALS["benzoic_acid"]
    melting, fusion = material.melting_point_k, material.real.fusion_enthalpy_j_mol
    assert float(Flask({"benzoic_acid": 1.0}).measure("melting_point")) == pytest.approx(melting)
    for impurity in (0.01, 0.1):
        reading = float(Flask({"benzoic_acid": 1.0 - impurity, "naphthalene": impurity}).measure("melting_point"))
        assert reading == pytest.approx(1.0 / (1.0 / melting - GAS_CONSTANT / fusion * math.log(1.0 - impurity)))
        depression = GAS_CONSTANT * melting**2 * impurity / fusion
        assert melting - reading == pytest.approx(depression, rel=2.0 * impurity)
    assert float(Flask({"benzoic_acid": 1.0, "NaCl": 0.5}).measure("melting_point")) == pytest.approx(melting)
    assert str(Flask({"hexane": 1.0}).measure("melting_point")) == "nothing that melts"


@pytest.mark.parametrize("physics", TIERS)
def test_hplc_sees_what_dissolves(physics: str) -> None:
    """Molecules one by one, whether they fly or not, and ions as half a salt each; no metal."""
    flask = Flask({"water": 10.0, "dodecane": 0.5, "NaOH": 0.25}, physics=physics)
    reading, dissolved = flask.measure("hplc"), flask.amounts["OH-"]  # the rest is not seen
    found = dict(zip(reading.labels, reading.values.tolist(), strict=True))
    assert dissolved > 0.1
    total = 10.0 + 0.5 + dissolved
    assert found["dodecane"] == pytest.approx(0.5 / total, rel=1e-6)
    assert found["ions"] == pytest.approx(dissolved / total, rel=1e-6)
    assert sum(found.values()) == pytest.approx(1.0)
    assert f"ions {dissolved / total:.1%}" in str(reading)
    dry = Flask({"hexane": 1.0, "Na": 1.0}, physics=physics).measure("hplc")
    assert dict(zip(dry.labels, dry.values, strict=True))["hexane"] == 1.0


def measured(name: str, spec: dict[str, Any], count: int = 1, seed: int = 0) -> Any:
    """The first values that an instrument of wurtz_dodecane's first vessel reads, from 0 to 1."""
    values = mapping("wurtz_dodecane") | {"instruments": {name: {"kind": "balance", **spec}}}
    values["limits"]["manager_actions"] = 1000
    env = laboratory(values, seed)
    found = []
    for _ in range(count):
        manager(env, "measure", 0, name)
        found.append(float(env.laboratories.state.reading[0, 0, 0]))
    return np.array(found) if count > 1 else found[0]


def test_calibration_detection_limit_and_noise() -> None:
    true = measured("right", {})
    assert 0.05 < true < 0.45
    assert measured("wrong", {"gain": 1.5, "bias": 0.05}) == pytest.approx(1.5 * true + 0.05, rel=1e-12)
    assert measured("blunt", {"detection_limit": true + 1e-6}) == 0.0
    assert measured("fine", {"detection_limit": true - 1e-6}) == true
    assert measured("high", {"bias": 0.9, "gain": 10.0}) == 1.0
    errors = measured("noisy", {"noise": 0.01}, 400, 1) - true
    assert np.std(errors) == pytest.approx(0.01, rel=0.15)  # four standard errors
    assert abs(np.mean(errors)) < 4.0 * 0.01 / 20.0


def test_a_tier_refuses_what_it_has_no_laws_for() -> None:
    for kind in ("ph_meter", "melting_point"):
        values = mapping("wurtz_dodecane") | {"instruments": {"one": {"kind": kind}}}
        with pytest.raises(DataError, match=rf"instruments\.one\.kind: '{kind}' needs .* choose physics = 'real'"):
            laboratory(values)


def test_defaults_are_not_in_dumps() -> None:
    for spec in dump_scenario(load_scenario("wurtz_dodecane"))["scenario"]["instruments"].values():
        assert {"kind", "price"} <= set(spec) <= {"kind", "price", "sample_fraction", "noise"}
    assert InstrumentSpec(kind="balance", gain=2.0).model_dump()["gain"] == 2.0
    for wrong in ({"gain": -1.0}, {"bias": 2.0}, {"detection_limit": -0.1}):
        with pytest.raises(DataError, match=next(iter(wrong))):
            load_scenario({**mapping("wurtz_dodecane"), "instruments": {"one": {"kind": "balance", **wrong}}})
