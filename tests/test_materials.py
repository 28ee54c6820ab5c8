"""Material files: what the loader refuses and what its messages say."""

from pathlib import Path

import pydantic
import pytest
from refusals import changed, refused, written

from chemlab.config.datafile import DataError, read_toml
from chemlab.config.materials import atoms_of, load_materials, shipped_materials

GOO = """
[goo]
name = "grey goo"
formula = "X2"
composition = { X = 2 }
charge = 0
cas = "50-00-0"
molar_mass_g_mol = 100.0
density_kg_l = 0.9
heat_capacity_j_mol_k = 200.0
melting_point_k = 250.0
boiling_point_k = 400.0
vaporization_enthalpy_j_mol = 35000.0
polarity = 0.2
role = "solute"
color = "#112233"
shade = 0.5
absorption = [{ height_l_mol = 0.1, center_nm = 300.0, width_nm = 10.0 }]

[goo.source]
molar_mass_g_mol = "made up"
density_kg_l = "made up"
heat_capacity_j_mol_k = "made up"
melting_point_k = "made up"
boiling_point_k = "made up"
vaporization_enthalpy_j_mol = "made up"
polarity = "made up too"
"""


def test_every_value_of_a_file_arrives(tmp_path: Path) -> None:
    file = written(tmp_path, GOO)
    goo = load_materials([file])["goo"]
    said = read_toml(file)["goo"]
    read = goo.model_dump()
    assert {key: read[key] for key in said if key != "absorption"} == {
        key: value for key, value in said.items() if key != "absorption"
    }
    assert [peak.model_dump() for peak in goo.absorption] == said["absorption"]
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        goo.density_kg_l = 2.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("charge = 0\n", 'charge = 0\nodour = "foul"\n', ["odour", "unknown key", "'foul'"]),
        ("density_kg_l = 0.9", "density_kg_l = -0.9", ["density_kg_l", "or equal to 0.00001", "-0.9"]),
        ("density_kg_l = 0.9", "density_kg_l = 99.0", ["density_kg_l", "less than or equal to 25", "99.0"]),
        ("density_kg_l = 0.9\n", "", ["density_kg_l", "required"]),
        ("density_kg_l = 0.9", 'density_kg_l = "light"', ["density_kg_l", "number", "'light'"]),
        ("density_kg_l = 0.9", "density_kg_l = nan", ["density_kg_l", "nan"]),
        ("_k = 200.0", "_k = 0.0", ["heat_capacity_j_mol_k", "greater than or equal to 1"]),
        ("{ X = 2 }", "{ X = -2 }", ["composition.X", "or equal to 0.001", "-2"]),
        ("{ X = 2 }", "{}", ["composition", "at least 1 item"]),
        ("{ X = 2 }", "{ X = nan }", ["composition"]),
        ("{ X = 2 }", "{ X = 1e9 }", ["composition.X", "or equal to 10000", "1000000000.0"]),
        ("{ X = 2 }", f"{{ {', '.join(f'X{i} = 1' for i in range(51))} }}", ["composition", "at most 50 items"]),
        ("point_k = 400.0", "point_k = 249.0", ["boiling_point_k", "249.0", "melting_point_k", "250.0"]),
        ("point_k = 400.0", "point_k = 250.0", ["boiling_point_k = 250.0", "above"]),
        ('polarity = "made up too"\n', "", ["source", "cite", "polarity"]),
        ('polarity = "made up too"\n', 'polarity = ""\n', ["source", "cite", "polarity"]),
        ('melting_point_k = "made up"\n', "", ["source", "cite", "melting_point_k"]),
        ("charge = 0", "charge = 1", ["role 'solute'", "charge 1"]),
        ("charge = 0", "charge = 11", ["charge", "less than or equal to 10", "11"]),
        ("charge = 0", "charge = 1" + "0" * 400, ["charge", "an integer", "1329 bits"]),
        ('role = "solute"', 'role = "ion"', ["role 'ion'", "charge 0"]),
        ('role = "solute"', 'role = "plasma"', ["role", "'solvent', 'solute', 'ion', 'solid' or 'gas'", "'plasma'"]),
        ('cas = "50-00-0"', 'cas = "fifty"', ["cas", "pattern", "'fifty'"]),
        ('color = "#112233"', 'color = "grey"', ["color", "pattern", "'grey'"]),
        ("shade = 0.5", "shade = 1.5", ["shade", "less than or equal to 1", "1.5"]),
        ("shade = 0.5", "shade = 0.5\n" + '"bad\\nkey" = 1', ["a key must be 1 to 100 printable characters"]),
        ("center_nm = 300.0", "center_nm = 30.0", ["absorption.0.center_nm", "100", "30.0"]),
        ("width_nm = 10.0 }", "width_nm = 0.0 }", ["absorption.0.width_nm", "or equal to 0.1", "0.0"]),
        ("width_nm = 10.0 }", "width_nm = 10.0, phase = 1 }", ["absorption.0.phase", "unknown key"]),
        ('formula = "X2"', f'formula = "{"X" * 201}"', ["formula", "at most 200 characters", "(203 characters)"]),
        ('formula = "X2"', r'formula = "X\u0007"', ["formula", "without control characters"]),
    ],
)
def test_a_wrong_entry_is_named_with_file_key_and_bound(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    file = written(tmp_path, changed(GOO, old, new))
    refused(lambda: load_materials([file]), f"{file}: goo", *parts)


def test_every_wrong_key_has_a_line_until_there_are_too_many(tmp_path: Path) -> None:
    text = changed(GOO, "shade = 0.5", "shade = 7.0").replace("polarity = 0.2", "polarity = -3.0")
    file = written(tmp_path, text)
    with pytest.raises(DataError) as caught:
        load_materials([file])
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert all(line.startswith(f"{file}: goo: ") for line in lines)
    text = changed(GOO, "shade = 0.5\n", "shade = 0.5\n" + "".join(f"x{i} = 1\n" for i in range(1000)))
    with pytest.raises(DataError, match="and 980 more") as caught:
        load_materials([written(tmp_path, text)])
    assert len(str(caught.value).splitlines()) == 21


def test_a_gas_may_sublime_and_a_material_do_without_a_melting_point(tmp_path: Path) -> None:
    # Carbon dioxide and acetylene sublime: that a boiling point is above is for liquids and solids.
    text = changed(GOO, 'role = "solute"', 'role = "gas"').replace("boiling_point_k = 400.0", "boiling_point_k = 200.0")
    assert load_materials([written(tmp_path, text)])["goo"].boiling_point_k == 200.0
    text = changed(GOO, "melting_point_k = 250.0\n", "").replace('melting_point_k = "made up"\n', "")
    assert load_materials([written(tmp_path, text)])["goo"].melting_point_k is None


def test_a_folder_stands_for_its_files(tmp_path: Path) -> None:
    for name, text in (("b.toml", GOO), ("a.toml", GOO.replace("goo", "slime")), ("notes.txt", "no material")):
        (tmp_path / name).write_text(text)
    assert list(load_materials([tmp_path])) == ["slime", "goo"]
    (tmp_path / "a.toml").write_text(GOO)
    refused(lambda: load_materials([tmp_path]), tmp_path / "a.toml", tmp_path / "b.toml", "goo", "already defined")
    for i in range(99):
        (tmp_path / f"{i}.toml").write_text("")
    with pytest.raises(DataError, match=r"has 101 \.toml files; at most 100"):
        load_materials([tmp_path])


@pytest.mark.parametrize("text", ["[goo\nname = 1", "= 3", 'name = "open'])
def test_malformed_toml_names_the_file_and_the_line(tmp_path: Path, text: str) -> None:
    file = written(tmp_path, text)
    with pytest.raises(DataError, match=r"not valid TOML.*line \d|not valid TOML.*end of document") as caught:
        load_materials([file])
    assert str(file) in str(caught.value)


def test_atoms_of_counts_elements_and_charge() -> None:
    table = shipped_materials()
    assert atoms_of({"NaCl": 2.0}, table) == {"charge": 0.0, "Na": 2.0, "Cl": 2.0}
    assert atoms_of({"Na+": 3.0, "Cl-": 1.0}, table) == {"charge": 2.0, "Na": 3.0, "Cl": 1.0}
    # C6H13Cl + C12H26, one mole and half a mole.
    assert atoms_of({"1-chlorohexane": 1.0, "dodecane": 0.5}, table) == {"charge": 0.0, "C": 12.0, "H": 26.0, "Cl": 1.0}
    assert atoms_of({}, table) == {"charge": 0.0}
