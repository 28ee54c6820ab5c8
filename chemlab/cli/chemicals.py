"""Commands that write data files and scenarios: data, new."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..config.files import check_apart, check_target, write_text, write_texts
from .options import ForceOption, JsonOption, app
from .screen import counting, err, out, plain, show_table

if TYPE_CHECKING:
    from ..config.materials import Material
    from ..config.reactions import ReactionFamily
    from ..openchem.identity import Compound
    from ..openchem.templates import Found, Rate, Species

data = typer.Typer(help="Write data files of your own or of a random chemistry.", no_args_is_help=True)
app.add_typer(data, name="data")

MaterialsOption = Annotated[list[Path] | None, typer.Option(help="Your own material file; repeatable.")]
ValuesOption = Annotated[
    list[Path] | None,
    typer.Option(help="File with your own values, as tables of a material file, each with its source."),
]
NameOption = Annotated[
    list[str] | None, typer.Option(help="KEY=WHAT: id KEY for the compound WHAT (CAS number, name, SMILES).")
]
IdealOption = Annotated[
    bool,
    typer.Option("--ideal", help="Treat pairs that UNIFAC does not describe as ideal mixtures; their source says so."),
]
RateOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Rate constant at 298.15 K in (L/mol)^(order-1)/s, for all reactions of a template: one for each "
        "--smarts, then for each --side; or 'A + B -> C=NUMBER' for one reaction, named as in the printed table."
    ),
]


_SMALLEST_ACTIVATION = 1000.0
"""J/mol below which an activation energy was probably meant in kJ/mol."""
_RATES = {"--rate": "constant", "--activation": "activation_j_mol", "--equilibrium": "equilibrium_constant"}
"""Options of rates, and the fields of ``Rate`` that they set."""


def _check_output(path: Path, force: bool, *read: Path) -> None:
    """Check that an output path does not exist, or may be overwritten and is not one of the input files.

    Raises:
        ValueError: it must not be written, or does not end with .toml.
    """
    if path.suffix != ".toml":
        raise ValueError(f"{path}: must end with .toml")
    check_apart([path], read)
    check_target(path, force)


def _parse_names(options: Iterable[str] | None) -> dict[str, str]:
    """Return the values of --name, KEY=WHAT, as a dictionary."""
    names: dict[str, str] = {}
    for option in options or ():
        key, equals, what = option.partition("=")
        if not (key and equals and what):
            raise ValueError(f"--name: must be KEY=WHAT, given {option!r}")
        if names.setdefault(key, what) != what:
            raise ValueError(f"--name: {key!r} is given for {names[key]!r} and for {what!r}; give each another key")
    return names


def _command(*words: object) -> str:
    return shlex.join(["chemlab", *map(str, words)])


def _words(options: Mapping[str, Iterable[object] | None]) -> list[object]:
    """Return options as command-line words; an option is repeated for every value."""
    return [word for option, values in options.items() for value in values or () for word in (option, value)]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _known(files: Sequence[Path] | None) -> dict[str, Material]:
    from ..config.materials import load_materials, shipped_materials

    return {**shipped_materials(), **load_materials(files or ())}


def _make_pairs(
    pairs: list[tuple[str, str]], known: dict[str, Material], command: str, ideal: bool
) -> tuple[str, list[dict[str, Any]]]:
    """Fit activity coefficients, and return the text of the pair file and its rows."""
    from ..openchem.activity import make_pairs
    from ..openchem.writing import pair_text

    if pairs and not err.is_terminal:  # without a terminal, no progress is shown
        err.print(f"fitting {_count(len(pairs), 'pair')} of liquids")
    with counting() as progress:
        task = progress.add_task("pairs", total=len(pairs))
        rows = make_pairs(pairs, known, lambda done: progress.update(task, completed=done), ideal)
    return pair_text(rows, command), rows


def _make_tables(new: Sequence[Compound], own: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of new materials, with a progress line."""
    from ..openchem.compounds import material_tables

    with counting() as progress:
        task = progress.add_task("materials", total=len(new))
        return material_tables(new, own, lambda _: progress.advance(task))


def _unbundled(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return every pair of some materials that no bundled pair file has."""
    from ..config.pairs import shipped_pairs

    return [two for two in itertools.combinations(names, 2) if frozenset(two) not in shipped_pairs()]


def _show_ideal(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the pairs that are treated as ideal mixtures."""
    from ..config.catalogue import IDEAL_PAIR, SOURCES

    if ideal := [" with ".join(row["of"]) for row in rows if row["source"] == SOURCES[IDEAL_PAIR]]:
        out.print(f"treated as ideal mixtures, because UNIFAC does not describe them: {plain(', '.join(ideal))}")


@data.command()
def material(
    what: Annotated[list[str] | None, typer.Argument(help="CAS numbers, names or structures (SMILES).")] = None,
    output: Annotated[Path, typer.Option("--out", "-o", help="Material file to write.")] = Path("materials.toml"),
    name: NameOption = None,
    values: ValuesOption = None,
    pairs: Annotated[
        Path | None, typer.Option(help="Pair file to write for all named materials, bundled ones included.")
    ] = None,
    ideal: IdealOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a material file, every number with its source (needs the extra `chem`).

    Estimates are marked as such, and missing values are requested. Bundled materials are left out. Works offline.
    """
    from ..config.materials import shipped_materials
    from ..openchem import compounds
    from ..openchem.activity import is_molecule
    from ..openchem.identity import structures
    from ..openchem.writing import material_text

    results = [path for path in (output, pairs) if path is not None]
    check_apart(results)
    for path in results:
        _check_output(path, force, *(values or ()))
    own = compounds.own_values(values or ())
    requested = compounds.compounds(what or [], _parse_names(name))
    if not requested:
        raise ValueError("no compound is given; name one by CAS number, name or structure")
    bundled = {c.key: key for c in requested if (key := structures().get(c.smiles))}
    new = [compound for compound in requested if compound.key not in bundled]
    for compound in new:
        if compound.key in shipped_materials():
            raise ValueError(
                f"{compound.key}: is the id of another bundled material; give another with --name KEY=WHAT"
            )
    if unused := sorted(set(own) - {compound.key for compound in new}):
        raise ValueError(
            f"--values: {unused[0]}: is not written by this command; written: "
            f"{', '.join(compound.key for compound in new) or 'none, all given compounds are bundled'}"
        )
    tables: dict[str, Any] = {}
    texts: dict[Path, str] = {}
    if new:
        tables = _make_tables(new, own)
        words = [*(what or []), *_words({"--name": name, "--values": values})]
        texts[output] = material_text(tables, _command("data", "material", *words))
    keys = [*bundled.values(), *tables]
    known = shipped_materials() | compounds.checked_materials(tables)
    missing = _unbundled(key for key in keys if is_molecule(known[key]))
    rows: list[dict[str, Any]] = []
    if pairs is not None:
        words = [*keys, *_words({"--materials": [output] if new else []}), *(["--ideal"] if ideal else ())]
        texts[pairs], rows = _make_pairs(missing, known, _command("data", "pairs", *words), ideal)
    write_texts(texts)
    if as_json:
        typer.echo(json.dumps({"materials": tables, "shipped": bundled, "pairs": len(missing) if pairs else 0}))
        return
    for key, bundled_key in bundled.items():
        out.print(f"{plain(key)}: not written: bundled as {plain(bundled_key)} ({plain(_identify(requested, key))})")
    _show_materials(tables, requested)
    _show_ideal(rows)
    if new:
        out.print(f"{plain(output)}: {_count(len(tables), 'material')}")
    if pairs is not None:
        out.print(f"{plain(pairs)}: {_count(len(missing), 'pair')}")
    elif any(table["role"] in ("solvent", "solute") for table in tables.values()):
        line = _command("data", "pairs", *tables, "OTHERS", "--materials", output, "-o", "pairs.toml")
        out.print(f"liquid mixtures need activity coefficients: made by chemlab new, or by {plain(line)}")


def _identify(compounds: Iterable[Compound], key: str) -> str:
    """Return common name and CAS number of a compound; if both are unknown, its structure."""
    compound = next(compound for compound in compounds if compound.key == key)
    return ", ".join(filter(None, (compound.common_name, compound.cas))) or compound.smiles


def _show_materials(tables: dict[str, Any], compounds: Sequence[Compound]) -> None:
    """Print the main values of each material, and the numbers that need a check."""
    from ..openchem.compounds import doubts, estimates

    estimated = estimates(tables)
    rows = []
    for key, t in tables.items():
        boils, listed = f"{t['boiling_point_k']:.1f}", ", ".join(estimated[key]) or "none"
        rows.append((key, _identify(compounds, key), t["formula"], t["role"], boils, listed))
    if rows:
        head = ("material", "compound, CAS number", "formula", "role", "boils (K)", "estimates")
        show_table("", head, rows, right=(4,))
    for line in doubts(tables):
        out.print(f"check {plain(line)}")
    for key, table in tables.items():
        if "melting_point_k" not in table and table["role"] in ("solvent", "solute"):
            out.print(
                f"{plain(key)}: no melting point was found, so it is treated as a liquid; if it is a solid, give "
                "melting_point_k and fusion_enthalpy_j_mol with --values"
            )


@data.command()
def pairs(
    names: Annotated[list[str], typer.Argument(help="Materials, at least two.")],
    output: Annotated[Path, typer.Option("--out", "-o", help="Pair file to write.")] = Path("pairs.toml"),
    materials: MaterialsOption = None,
    ideal: IdealOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write activity coefficients of every pair of materials, fitted to UNIFAC (needs the extra `chem`).

    Bundled pairs are left out, because your file would replace them, even measured ones.
    """
    from ..config.catalogue import catalogue_material

    _check_output(output, force, *(materials or ()))
    if len(names) < 2:
        raise ValueError("a pair needs two materials; name one more")
    known = _known(materials)
    known |= {name: found[1] for name in names if name not in known and (found := catalogue_material(name))}
    total, missing = math.comb(len(names), 2), _unbundled(names)
    if not missing:
        raise ValueError(f"{_count(total, 'pair')}, all bundled: scenarios need no file for them; name other materials")
    words = [*names, *_words({"--materials": materials}), *(["--ideal"] if ideal else ())]
    text, rows = _make_pairs(missing, known, _command("data", "pairs", *words), ideal)
    write_text(output, text)
    if as_json:
        typer.echo(json.dumps(rows))
        return
    error = max(row["error"] for row in rows)
    omitted = f"; {total - len(missing)} bundled ones left out" if total > len(missing) else ""
    _show_ideal(rows)
    out.print(f"{plain(output)}: {_count(len(rows), 'pair')}; largest error of ln gamma {error:.2f}{omitted}")


@data.command()
def reactions(
    smarts: Annotated[list[str], typer.Option(help="Template, reaction SMARTS; repeatable.", show_default=False)],
    reactants: Annotated[
        list[str], typer.Option(help="Material, CAS number, name or structure; repeatable.", show_default=False)
    ],
    more: Annotated[list[str] | None, typer.Argument(help="More reactants.")] = None,
    output: Annotated[Path, typer.Option("--out", "-o", help="Reaction file to write.")] = Path("reactions.toml"),
    side: Annotated[list[str] | None, typer.Option(help="Template of a side reaction; repeatable.")] = None,
    rate: RateOption = None,
    activation: Annotated[list[str] | None, typer.Option(help="Activation energy in J/mol, given like --rate.")] = None,
    equilibrium: Annotated[
        list[str] | None, typer.Option(help="Equilibrium constant at 298.15 K, given like --rate; 0: not reversible.")
    ] = None,
    source: Annotated[str, typer.Option(help="Source of the given constants.")] = "",
    catalyst: Annotated[
        list[str] | None, typer.Option(help="Material without which the main reaction does not run.")
    ] = None,
    generations: Annotated[int, typer.Option(min=1, max=10, help="Number of times that products react further.")] = 2,
    materials: MaterialsOption = None,
    name: NameOption = None,
    values: ValuesOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the balanced reactions that templates make of some materials (needs the extra `chem`).

    All reactions of one template share its rate constant, unless a reaction is given its own. Missing rate constants
    are guessed and marked as guesses. Unknown materials are written to a second file, NAME_materials.toml.
    """
    from ..openchem import compounds, templates
    from ..openchem.writing import family_text, material_text

    read = [*(materials or ()), *(values or ())]
    _check_output(output, force, *read)
    material_file = output.parent / f"{output.stem}_materials.toml"
    own_values = compounds.own_values(values or ())
    patterns = [*smarts, *(side or ())]
    constants = {"--rate": rate, "--activation": activation, "--equilibrium": equilibrium}
    rates, own_rates = _rates(len(patterns), constants, source)
    made = [templates.Template(t, r, n >= len(smarts)) for n, (t, r) in enumerate(zip(patterns, rates, strict=True))]
    known, names = _known(materials), _parse_names(name)
    reactants = [*reactants, *(more or ())]
    found, species = templates.expand(made, reactants, known, names, generations)
    found = _with_own_rates(found, own_rates)
    given: dict[str, Iterable[object] | None] = {"--smarts": smarts, "--side": side, "--reactants": reactants}
    given |= {**constants, "--catalyst": catalyst, "--source": [source] if source else ()}
    given |= {"--generations": [generations], "--materials": materials, "--name": name, "--values": values}
    command = _command("data", "reactions", *_words(given))
    catalysts, new = _new_compounds(catalyst or (), species, known, names)
    tables: dict[str, Any] = {}
    if new:
        _check_output(material_file, force, *read)
        tables = _make_tables(new, own_values)
        known |= compounds.checked_materials(tables)
    elif own_values:
        raise ValueError(f"--values: {min(own_values)}: is not written by this command: all materials are known")
    family = templates.family_tables(output.stem, found, known, command, catalysts)
    results = {output: family_text(family)}
    if new:
        results[material_file] = material_text(tables, command)
    write_texts(results)
    for step in found:
        energy = step.template.rate.activation_j_mol
        if energy is not None and 0.0 < energy < _SMALLEST_ACTIVATION:
            err.print(
                f"warning: --activation: {energy:g} J/mol of {plain(step.words)} is very small; if {energy:g} kJ/mol "
                f"was meant, give {1000.0 * energy:g}"
            )
    if as_json:
        typer.echo(json.dumps({"reactions": family, "materials": tables}))
        return
    _show_materials(tables, new)
    _show_reactions(found, known)
    if new:
        out.print(f"{plain(material_file)}: {_count(len(new), 'material')}")
    guessed = any(step.template.rate.constant is None for step in found)
    guesses = "; rate constants that were not given are guessed" if guessed else ""
    out.print(f"{plain(output)}: {_count(len(found), 'reaction')}{guesses}")


def _new_compounds(
    texts: Iterable[str], species: Sequence[Species], known: Mapping[str, Material], names: Mapping[str, str]
) -> tuple[list[str], list[Compound]]:
    """Return the ids of the catalysts ``texts``, and all compounds that are not known as materials."""
    from ..openchem.identity import canonical, compound_of

    new = {s.key: compound_of(s.smiles, s.key, structure=True) for s in species if not s.known}
    ids = {s.inchi_key: s.key for s in species}
    catalysts = []
    for key in texts:
        if key not in known and key not in new:
            compound = compound_of(names.get(key, key), key if key in names else "")
            same = (k for k, m in known.items() if m.smiles and canonical(m.smiles, k) == compound.smiles)
            key = ids.get(compound.inchi_key) or next(same, compound.key)
            if key not in known:
                new.setdefault(key, compound)
        catalysts.append(key)
    return catalysts, list(new.values())


def _show_reactions(found: Sequence[Found], known: dict[str, Material]) -> None:
    """Print reactions with their heats and rate constants, and how to give a reaction its own rate constant."""
    from ..openchem.templates import heat_of_reaction, rate_constant

    rows = [
        (
            f"{step.words}{' (side reaction)' if step.template.side else ''}",
            f"{heat_of_reaction(step, known) / 1000.0:.1f}",
            f"{rate_constant(step.template):.3g}{' (a guess)' if step.template.rate.constant is None else ''}",
        )
        for step in found
    ]
    show_table("", ("reaction", "kJ/mol", "k (298 K)"), rows, right=(1,))
    shared = [step for step in found if sum(step.template is other.template for other in found) > 1]
    if shared:
        example = shlex.quote(f"{shared[-1].words}=NUMBER")
        out.print(
            f"{_count(len(shared), 'reaction')} share a template and its rate constant; give a reaction its own with "
            f"{plain(f'--rate {example}')}"
        )


def _rates(
    count: int, options: Mapping[str, Sequence[str] | None], source: str
) -> tuple[list[Rate], dict[str, dict[str, float]]]:
    """Return the rates of ``count`` templates, and the fields of rates that were given for single reactions.

    Raises:
        ValueError: there are more numbers than templates, or a value is not a number.
    """
    from ..openchem.templates import Rate

    columns: list[list[float | None]] = []
    own: dict[str, dict[str, float]] = {}
    for option, texts in options.items():
        numbers: list[float | None] = []
        for text in texts or ():
            words, equals, value = text.rpartition("=")
            try:
                number = float(value)
            except ValueError as error:
                raise ValueError(f"{option}: must be NUMBER or REACTION=NUMBER, given {text!r}") from error
            if equals:
                own.setdefault(" ".join(words.split()), {})[_RATES[option]] = number
            else:
                numbers.append(number)
        if len(numbers) > count:
            raise ValueError(f"{option}: {len(numbers)} numbers for {count} templates")
        columns.append([*numbers, *[None] * (count - len(numbers))])
    return [Rate(k, e, q or None, source) for k, e, q in zip(*columns, strict=True)], own


def _with_own_rates(found: list[Found], own: Mapping[str, Mapping[str, float]]) -> list[Found]:
    """Return the reactions, with a separate template for each reaction that has its own rate.

    Raises:
        ValueError: a named reaction does not exist.
    """
    words = [step.words for step in found]
    for name in own:
        if name not in words:
            raise ValueError(f"unknown reaction {name!r}; choose from {'; '.join(words)}")
    reactions = []
    for step in found:
        if numbers := own.get(step.words):
            # An equilibrium constant of 0 stands for an irreversible reaction.
            fields: dict[str, Any] = {
                key: None if key == "equilibrium_constant" and not x else x for key, x in numbers.items()
            }
            rate = dataclasses.replace(step.template.rate, **fields)
            step = dataclasses.replace(step, template=dataclasses.replace(step.template, rate=rate))
        reactions.append(step)
    return reactions


def _check_name(name: str) -> None:
    """Check the name of a scenario.

    Raises:
        ValueError: it has other characters than lower-case letters, digits and _.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"name: must be lower-case letters, digits and _, beginning with a letter; given {name!r}")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the scenario: lower-case letters, digits and _.")],
    reactions: Annotated[str, typer.Option(help="Reaction file, or the name of a bundled family.")] = "",
    materials: MaterialsOption = None,
    pairs: Annotated[list[Path] | None, typer.Option(help="Your own pair file; repeatable.")] = None,
    goal: Annotated[str, typer.Option(help="Goal; default: the first product.")] = "",
    solvent: Annotated[str, typer.Option(help="Solvent; default: one that boils far from the goal.")] = "",
    mol: Annotated[float, typer.Option(min=0.01, max=5.0, help="Theoretical maximum of the goal, in mol.")] = 0.25,
    ideal: IdealOption = False,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Output file. Default: NAME.toml.")] = None,
    force: ForceOption = False,
) -> None:
    """Write a playable scenario of your own reaction with the physics backend `real`.

    Prompts for missing values in an interactive terminal. Missing activity coefficients are made (needs the extra
    `chem`) and written to a second file, NAME_pairs.toml.
    """
    from ..config.loading import load_scenario
    from ..config.pairs import load_pairs, shipped_pairs
    from ..config.reactions import load_reactions
    from ..openchem import designs

    _check_name(name)
    path = output or Path(f"{name}.toml")
    pair_file = path.parent / f"{path.stem}_pairs.toml"
    reactions = reactions or _ask("reaction file")
    if not reactions:
        raise ValueError("--reactions: name a reaction file (chemlab data reactions makes one)")
    file = Path(reactions)
    files = list(materials or ())
    made = file.parent / f"{file.stem}_materials.toml"
    read = [*(materials or ()), *(pairs or ()), *([file, made] if file.suffix == ".toml" else ())]
    _check_output(path, force, *read)
    if made.exists() and made not in files:
        files.append(made)
    known = _known(files)
    family = load_reactions(reactions, known)
    goal, solvent = _goal_and_solvent(goal, solvent, family, known)
    available = {**shipped_pairs(), **load_pairs(pairs or ())}
    missing = [two for two in designs.occurring(goal, solvent, family, known) if frozenset(two) not in available]
    designs.check_design(goal, solvent, family, known, mol)
    given: dict[str, Iterable[object] | None] = {
        "--reactions": [reactions],
        "--goal": [goal],
        "--solvent": [solvent],
        "--materials": materials,
    }
    given |= {"--pairs": pairs, "--mol": [mol]}
    command = _command("new", name, *_words(given), *(["--ideal"] if ideal else ()))
    if missing:
        _check_output(pair_file, force, *read)

    def file_keys(new_pairs: Path, name_of: Callable[[Path], str]) -> dict[str, Any]:
        pair_files = [*(pairs or ()), *([new_pairs] if missing else ())]
        keys: dict[str, Any] = {"reactions": name_of(file) if file.suffix == ".toml" else reactions}
        keys |= {"material_files": [name_of(f) for f in files]} if files else {}
        return keys | ({"pair_files": [name_of(f) for f in pair_files]} if pair_files else {})

    # Make and load everything before writing anything.
    rows: list[dict[str, Any]] = []
    texts = {path: ""}  # the first file is renamed last
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "pairs.toml"
        if missing:
            texts[pair_file], rows = _make_pairs(missing, known, command, ideal)
            write_text(draft, texts[pair_file])
            available |= load_pairs([draft])
        relative = file_keys(pair_file, lambda other: designs.beside(other, path.parent))
        tables = designs.design(name, goal, solvent, family, known, available, mol, relative)
        spec = load_scenario({**tables, **file_keys(draft, lambda other: str(other.resolve()))})
    texts[path] = designs.scenario_text(tables, command)
    write_texts(texts)
    _show_ideal(rows)
    benches = ", ".join(spec.benches)
    play = plain(_command("run", path))
    out.print(f"{plain(path)}: {plain(goal)} in {plain(solvent)}; benches {benches}; play it: {play}")


def _ask(prompt: str, default: str = "") -> str:
    """Prompt for a value in an interactive terminal; elsewhere return the default."""
    return str(typer.prompt(prompt, default=default or None)) if sys.stdin.isatty() else default


def _goal_and_solvent(
    goal: str, solvent: str, family: ReactionFamily, known: Mapping[str, Material]
) -> tuple[str, str]:
    """Return goal and solvent of a new scenario, with prompts or defaults for missing ones.

    Raises:
        ValueError: a name is unknown, or there is no default.
    """
    from ..openchem.designs import solvent_for

    candidates = [key for step in family.reaction for key in step.products if known[key].role in ("solvent", "solute")]
    if not candidates and not goal:
        raise ValueError(f"--goal: no product of {family.name!r} is a molecule")
    goal = goal or _ask("goal", candidates[0])
    if goal not in known:
        raise ValueError(f"--goal: unknown material {goal!r}; choose from {', '.join(dict.fromkeys(candidates))}")
    solvent = solvent or _ask("solvent", solvent_for(goal, family, known))
    if solvent not in known:
        make = _command("data", "material", solvent, "-o", "FILE.toml")
        raise ValueError(
            f"--solvent: unknown material {solvent!r}; name its file with --materials; make it with: {make}"
        )
    return goal, solvent


@data.command()
def generate(
    name: Annotated[str, typer.Argument(help="Name of the scenario: lower-case letters, digits and _.")],
    seed: Annotated[int, typer.Option(help="Seed of the chemistry.")] = 0,
    materials: Annotated[int | None, typer.Option(help="Number of materials, without the solvent.")] = None,
    reactions: Annotated[int | None, typer.Option(help="Number of reactions, side reactions included.")] = None,
    steps: Annotated[int | None, typer.Option(help="Number of reactions of the route to the last goal.")] = None,
    goals: Annotated[int, typer.Option(help="Number of goals: the last products of the route.")] = 1,
    difficulty: Annotated[str, typer.Option(help="Difficulty: easy, medium or hard.")] = "medium",
    physics: Annotated[str, typer.Option(help="Physics backend: paper or real.")] = "paper",
    output: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path(),
    force: ForceOption = False,
) -> None:
    """Write a random chemistry: invented materials and balanced reactions with a route to every goal.

    The same options give the same files on every machine. The difficulty sets the numbers of materials, reactions and
    steps that are not given.
    """
    from ..openchem.generate import generated

    _check_name(name)
    made = generated(seed, materials, reactions, difficulty, physics, steps, goals, name)
    made.scenario()
    path = made.write(output, force)
    out.print(plain(made.tables["summary"]))
    words = f"play it: {_command('run', path)}; measure its difficulty: {_command('audit', 'difficulty', path)}"
    out.print(f"{plain(path)} and {len(made.files()) - 1} files beside it; {plain(words)}")
