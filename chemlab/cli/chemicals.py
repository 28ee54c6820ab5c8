"""Commands that write data files and scenarios: data, new, generate."""

from __future__ import annotations

import dataclasses
import itertools
import json
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
    from ..openchem.identity import Compound
    from ..openchem.templates import Found, Rate

data = typer.Typer(help="Write data files of your own chemistry (needs the extra `chem`).", no_args_is_help=True)
app.add_typer(data, name="data")

MaterialsOption = Annotated[list[Path] | None, typer.Option(help="Material file of your own; repeatable.")]
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


def _free(path: Path, force: bool, *read: Path) -> None:
    """Check that an output path is free, or may be overwritten and is not one of the input files."""
    if path.suffix != ".toml":
        raise ValueError(f"{path}: must end with .toml")
    check_apart([path], read)
    check_target(path, force)


def _named(options: Iterable[str] | None) -> dict[str, str]:
    found: dict[str, str] = {}
    for option in options or ():
        key, equals, what = option.partition("=")
        if not (key and equals and what):
            raise ValueError(f"--name: must be KEY=WHAT, given {option!r}")
        if found.setdefault(key, what) != what:
            raise ValueError(
                f"--name: {key!r} is given for {found[key]!r} and for {what!r}; give each a key of its own"
            )
    return found


def _command(*words: object) -> str:
    return shlex.join(["chemlab", *map(str, words)])


def _given(options: Mapping[str, Iterable[object] | None]) -> list[object]:
    """Return the command-line words of the given options, each repeated for every value."""
    return [word for option, values in options.items() for value in values or () for word in (option, value)]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _known(files: Sequence[Path] | None) -> dict[str, Material]:
    from ..config.materials import load_materials, shipped_materials

    return {**shipped_materials(), **load_materials(files or ())}


def _made_pairs(
    two: list[tuple[str, str]], known: dict[str, Material], command: str, ideal: bool
) -> tuple[str, list[dict[str, Any]]]:
    """Make pairs; return the text of their file, and its rows."""
    from ..openchem.activity import make_pairs
    from ..openchem.writing import pair_text

    if two and not err.is_terminal:  # which shows no progress
        err.print(f"fitting {_count(len(two), 'pair')} of liquids")
    with counting() as progress:
        task = progress.add_task("pairs", total=len(two))
        rows = make_pairs(two, known, lambda done: progress.update(task, completed=done), ideal)
    return pair_text(rows, command), rows


def _show_ideal(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the pairs treated as ideal mixtures."""
    from ..config.catalogue import IDEAL_PAIR, SOURCES

    guessed = [" with ".join(row["of"]) for row in rows if row["source"] == SOURCES[IDEAL_PAIR]]
    if guessed:
        out.print(f"treated as ideal mixtures, because UNIFAC does not describe them: {plain(', '.join(guessed))}")


@data.command()
def material(
    what: Annotated[list[str] | None, typer.Argument(help="CAS numbers, names or structures (SMILES).")] = None,
    output: Annotated[Path, typer.Option("--out", "-o", help="Material file to write.")] = Path("materials.toml"),
    name: NameOption = None,
    values: ValuesOption = None,
    pairs: Annotated[
        Path | None,
        typer.Option(help="Pair file to write for all named materials, bundled ones included."),
    ] = None,
    ideal: IdealOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a material file, every number with its source (needs the extra `chem`).

    Estimates are marked as such, and missing values are requested. Bundled materials are left out. Works offline.
    """
    from ..openchem import compounds
    from ..openchem.writing import material_text

    results = [path for path in (output, pairs) if path is not None]
    check_apart(results)
    for path in results:
        _free(path, force, *(values or ()))
    own = compounds.own_values(values or ())
    wanted = compounds.compounds(what or [], _named(name))
    if not wanted:
        raise ValueError("no compound is given; name one by CAS number, name or structure")
    shipped = {c.key: key for c in wanted if (key := compounds.known_as(c, _known(None)))}
    new = [compound for compound in wanted if compound.key not in shipped]
    for compound in new:
        if compound.key in _known(None):
            raise ValueError(
                f"{compound.key}: is the id of another bundled material; give another with --name KEY=WHAT"
            )
    strangers = sorted(set(own) - {compound.key for compound in new})
    if strangers:
        raise ValueError(
            f"--values: {strangers[0]}: is not written by this command; written: "
            f"{', '.join(compound.key for compound in new) or 'none, all given compounds are bundled'}"
        )
    words = [*(what or []), *_given({"--name": name, "--values": values})]
    tables: dict[str, Any] = {}
    texts: dict[Path, str] = {}
    if new:
        with counting() as progress:
            task = progress.add_task("materials", total=len(new))
            tables = compounds.material_tables(new, own, lambda _: progress.advance(task))
        texts[output] = material_text(tables, _command("data", "material", *words))
    keys = [*shipped.values(), *tables]
    known = _known(None) | compounds.checked_materials(tables)
    two = _missing_pairs(keys, known)
    rows: list[dict[str, Any]] = []
    if pairs is not None:
        words = [*keys, *_given({"--materials": [output] if new else []}), *(["--ideal"] if ideal else ())]
        texts[pairs], rows = _made_pairs(two, known, _command("data", "pairs", *words), ideal)
    write_texts(texts)
    if as_json:
        typer.echo(json.dumps({"materials": tables, "shipped": shipped, "pairs": len(two) if pairs else 0}))
        return
    for key, as_ in shipped.items():
        out.print(f"{plain(key)}: is bundled as {plain(as_)} ({plain(_meant(wanted, key))})")
    _show_materials(tables, wanted)
    _show_ideal(rows)
    if new:
        out.print(f"{plain(output)}: {_count(len(tables), 'material')}")
    if pairs is not None:
        out.print(f"{plain(pairs)}: {_count(len(two), 'pair')}")
    elif any(table["role"] in ("solvent", "solute") for table in tables.values()):
        line = _command("data", "pairs", *tables, "OTHERS", "--materials", output, "-o", "pairs.toml")
        out.print(f"liquid mixtures need activity coefficients: made by chemlab new, or by {plain(line)}")


def _meant(wanted: Iterable[Compound], key: str) -> str:
    """Return common name and CAS number of a compound, if known."""
    found = next(compound for compound in wanted if compound.key == key)
    return ", ".join(filter(None, (found.common_name, found.cas))) or found.smiles


def _show_materials(tables: dict[str, Any], wanted: Sequence[Compound]) -> None:
    """Print the chosen values of each material, and which of its numbers to check."""
    from ..openchem.compounds import doubts, estimates

    guessed = estimates(tables)
    rows = [
        (key, _meant(wanted, key), t["formula"], t["role"], f"{t['boiling_point_k']:.1f}",
         ", ".join(guessed[key]) or "none")
        for key, t in tables.items()
    ]  # fmt: skip
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


def _missing_pairs(keys: Sequence[str], known: dict[str, Material]) -> list[tuple[str, str]]:
    """Return every pair of molecules among some materials that no bundled pair file has."""
    from ..config.pairs import shipped_pairs
    from ..openchem.activity import is_molecule

    molecules = [key for key in keys if is_molecule(known[key])]
    return [two for two in itertools.combinations(molecules, 2) if frozenset(two) not in shipped_pairs()]


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

    Bundled pairs are left out, because a file of yours would replace them, even measured ones.
    """
    from ..config.catalogue import catalogue_material
    from ..config.pairs import shipped_pairs

    _free(output, force, *(materials or ()))
    if len(names) < 2:
        raise ValueError("a pair needs two materials; name one more")
    known = _known(materials)
    known |= {name: found[1] for name in names if name not in known and (found := catalogue_material(name))}
    every = list(itertools.combinations(names, 2))
    two = [pair for pair in every if frozenset(pair) not in shipped_pairs()]
    if not two:
        raise ValueError(
            f"{_count(len(every), 'pair')}, all bundled: scenarios need no file for them; name other materials"
        )
    words = [*names, *_given({"--materials": materials}), *(["--ideal"] if ideal else ())]
    text, rows = _made_pairs(two, known, _command("data", "pairs", *words), ideal)
    write_text(output, text)
    if as_json:
        typer.echo(json.dumps(rows))
        return
    error = max(row["error"] for row in rows)
    left = f"; {len(every) - len(two)} bundled ones left out" if len(every) > len(two) else ""
    _show_ideal(rows)
    out.print(f"{plain(output)}: {_count(len(rows), 'pair')}; largest error of ln gamma {error:.2f}{left}")


@data.command()
def reactions(
    smarts: Annotated[list[str], typer.Option(help="Template, reaction SMARTS; repeatable.", show_default=False)],
    reactants: Annotated[
        list[str],
        typer.Option(help="Material, CAS number, name or structure; repeatable.", show_default=False),
    ],
    more: Annotated[list[str] | None, typer.Argument(help="More reactants.")] = None,
    output: Annotated[Path, typer.Option("--out", "-o", help="Reaction file to write.")] = Path("reactions.toml"),
    side: Annotated[list[str] | None, typer.Option(help="Template of a side reaction; repeatable.")] = None,
    rate: RateOption = None,
    activation: Annotated[list[str] | None, typer.Option(help="Activation energy in J/mol, given like --rate.")] = None,
    equilibrium: Annotated[
        list[str] | None,
        typer.Option(help="Equilibrium constant at 298.15 K, given like --rate; 0: not reversible."),
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
    from ..openchem.identity import compound_of
    from ..openchem.writing import family_text, material_text

    read = [*(materials or ()), *(values or ())]
    _free(output, force, *read)
    beside = output.parent / f"{output.stem}_materials.toml"
    given_here = compounds.own_values(values or ())
    patterns = [*smarts, *(side or ())]
    rates, own = _rates(
        len(patterns), {"--rate": rate, "--activation": activation, "--equilibrium": equilibrium}, source
    )
    made = [templates.Template(t, r, n >= len(smarts)) for n, (t, r) in enumerate(zip(patterns, rates, strict=True))]
    known, named = _known(materials), _named(name)
    everybody = [*reactants, *(more or ())]
    found, species = templates.expand(made, everybody, known, named, generations)
    found = _with_own_rates(found, own)
    strangers = {s.key: s.smiles for s in species if not s.known}
    given: dict[str, Iterable[object] | None] = {"--smarts": smarts, "--side": side, "--reactants": everybody}
    given |= {"--rate": rate, "--activation": activation, "--equilibrium": equilibrium, "--catalyst": catalyst}
    given |= {"--source": [source] if source else (), "--generations": [generations]}
    given |= {"--materials": materials, "--name": name, "--values": values}
    command = _command("data", "reactions", *_given(given))
    tables: dict[str, Any] = {}
    wanted: list[Compound] = [compound_of(smiles, key, structure=True) for key, smiles in strangers.items()]
    ids = {s.inchi_key: s.key for s in species}
    catalysts = []
    for text in catalyst or ():
        if text not in known and text not in strangers:
            made_of = compound_of(named.get(text, text), text if text in named else "")
            text = ids.get(made_of.inchi_key) or compounds.known_as(made_of, known) or made_of.key
            if text not in known and text not in strangers:
                strangers[text] = made_of.smiles
                wanted.append(made_of)
        catalysts.append(text)
    if strangers:
        _free(beside, force, *read)
        tables = compounds.material_tables(wanted, given_here)
        known |= compounds.checked_materials(tables)
    elif given_here:
        raise ValueError(f"--values: {min(given_here)}: is not written by this command: all materials are known")
    family = templates.family_tables(output.stem, found, known, command, catalysts)
    results = {output: family_text(family)}
    if strangers:
        results[beside] = material_text(tables, command)
    write_texts(results)
    for step in found:
        energy = step.template.rate.activation_j_mol
        if energy is not None and 0.0 < energy < _SMALLEST_ACTIVATION:
            err.print(
                f"warning: --activation: {energy:g} J/mol of {plain(step.words)} is next to nothing; were "
                f"{energy:g} kJ/mol meant, give {1000.0 * energy:g}"
            )
    if as_json:
        typer.echo(json.dumps({"reactions": family, "materials": tables}))
        return
    _show_materials(tables, wanted)
    rows = [
        (
            f.words if not f.template.side else f"{f.words} (side reaction)",
            f"{templates.heat_of_reaction(f, known) / 1000.0:.1f}",
            _rate_words(f),
        )
        for f in found
    ]
    show_table("", ("reaction", "kJ/mol", "k (298 K)"), rows, right=(1,))
    shared = [f for f in found if sum(f.template is other.template for other in found) > 1]
    if shared:
        example = shlex.quote(f"{shared[-1].words}=NUMBER")
        out.print(
            f"{_count(len(shared), 'reaction')} share a template and its rate constant; give a reaction its own with "
            f"{plain(f'--rate {example}')}"
        )
    if strangers:
        out.print(f"{plain(beside)}: {_count(len(strangers), 'material')}")
    guesses = "; rate constants that were not given are guessed" if any("guess" in row[2] for row in rows) else ""
    out.print(f"{plain(output)}: {_count(len(found), 'reaction')}{guesses}")


_SMALLEST_ACTIVATION = 1000.0
"""J/mol, below which an activation energy was likely meant in kJ/mol."""


def _rate_words(found: Found) -> str:
    """Describe a rate constant, and whether it is a guess."""
    from ..openchem.templates import rate_constant

    constant = rate_constant(found.template)
    return f"{constant:.3g}{' (a guess)' if found.template.rate.constant is None else ''}"


_RATES = {"--rate": "constant", "--activation": "activation_j_mol", "--equilibrium": "equilibrium_constant"}


def _rates(
    count: int, options: Mapping[str, Sequence[str] | None], source: str
) -> tuple[list[Rate], dict[str, dict[str, float]]]:
    """Return the rates of the templates in order, and the fields given for single reactions, by their words.

    Raises:
        ValueError: there are more numbers than templates, or a value is not a number.
    """
    from ..openchem.templates import Rate

    columns: list[list[float | None]] = []
    own: dict[str, dict[str, float]] = {}
    for option, given in options.items():
        numbers: list[float | None] = []
        for text in given or ():
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
    made = []
    for step in found:
        numbers: dict[str, Any] = dict(own.get(step.words, {}))
        if "equilibrium_constant" in numbers:
            numbers["equilibrium_constant"] = numbers["equilibrium_constant"] or None
        rate = dataclasses.replace(step.template.rate, **numbers)
        made.append(
            dataclasses.replace(step, template=dataclasses.replace(step.template, rate=rate)) if numbers else step
        )
    return made


def _check_name(name: str) -> None:
    """Check the name of a scenario."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"name: must be lower-case letters, digits and _, beginning with a letter; given {name!r}")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the scenario: lower-case letters, digits and _.")],
    reactions: Annotated[str, typer.Option(help="Reaction file, or the name of a bundled family.")] = "",
    materials: MaterialsOption = None,
    pairs: Annotated[list[Path] | None, typer.Option(help="Pair file of your own; repeatable.")] = None,
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
    own = path.parent / f"{path.stem}_pairs.toml"
    asking = sys.stdin.isatty()
    reactions = reactions or (typer.prompt("reaction file") if asking else "")
    if not reactions:
        raise ValueError("--reactions: name a reaction file (chemlab data reactions makes one)")
    file = Path(reactions)
    files = list(materials or ())
    made = file.parent / f"{file.stem}_materials.toml"
    read = [*(materials or ()), *(pairs or ()), *([file, made] if file.suffix == ".toml" else ())]
    _free(path, force, *read)
    if made.exists() and made not in files:
        files.append(made)
    known = _known(files)
    family = load_reactions(reactions, known)
    candidates = [key for step in family.reaction for key in step.products if known[key].role in ("solvent", "solute")]
    if not candidates and not goal:
        raise ValueError(f"--goal: no product of {family.name!r} is a molecule")
    if not goal:
        goal = typer.prompt("goal", default=candidates[0]) if asking else candidates[0]
    if goal not in known:
        raise ValueError(f"--goal: unknown material {goal!r}; choose from {', '.join(dict.fromkeys(candidates))}")
    if not solvent:
        proposed = designs.solvent_for(goal, family, known)
        solvent = typer.prompt("solvent", default=proposed) if asking else proposed
    if solvent not in known:
        make = _command("data", "material", solvent, "-o", "FILE.toml")
        raise ValueError(
            f"--solvent: unknown material {solvent!r}; name its file with --materials; make it with: {make}"
        )
    at_hand = {**shipped_pairs(), **load_pairs(pairs or ())}
    missing = [two for two in designs.occurring(goal, solvent, family, known) if frozenset(two) not in at_hand]
    designs.check_design(goal, solvent, family, known, mol)
    given = {"--materials": materials, "--pairs": pairs, "--mol": [mol]}
    command = _command(
        "new", name, "--reactions", reactions, "--goal", goal, "--solvent", solvent, *_given(given),
        *(["--ideal"] if ideal else ()),
    )  # fmt: skip
    if missing:
        _free(own, force, *read)

    def places(own_pairs: Path, name_of: Callable[[Path], str]) -> dict[str, Any]:
        pair_files = [*(pairs or ()), *([own_pairs] if missing else ())]
        found: dict[str, Any] = {"reactions": name_of(file) if file.suffix == ".toml" else reactions}
        found |= {"material_files": [name_of(f) for f in files]} if files else {}
        return found | ({"pair_files": [name_of(f) for f in pair_files]} if pair_files else {})

    # Make and load everything before writing anything.
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "pairs.toml"
        text = ""
        if missing:
            text, rows = _made_pairs(missing, known, command, ideal)
            write_text(draft, text)
            at_hand |= load_pairs([draft])
        beside = places(own, lambda other: designs.beside(other, path.parent))
        tables = designs.design(name, goal, solvent, family, known, at_hand, mol, beside)
        spec = load_scenario({**tables, **places(draft, lambda other: str(other.resolve()))})
    texts = {path: designs.scenario_text(tables, command)}
    if missing:
        texts[own] = text
    write_texts(texts)
    _show_ideal(rows)
    benches = ", ".join(spec.benches)
    play = plain(_command("run", path))
    out.print(f"{plain(path)}: {plain(goal)} in {plain(solvent)}; benches {benches}; play it: {play}")


@app.command()
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
