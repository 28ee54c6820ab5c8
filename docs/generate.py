"""Generated pages: environments, scenarios, keys of scenario files, commands and API.

Sphinx calls this before it reads the pages (see ``conf.py``). Tables of observations and actions come from the channels
and action tables that build the spaces, texts from docstrings, and scenarios from their files.
"""

from __future__ import annotations

import ast
import html
import importlib.util
import inspect
import json
import pkgutil
import re
import types
import typing
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import gymnasium
import pydantic
import typer
from baselines import standings
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

import chemlab
from chemlab.agents.evaluate.audit import measure_rows
from chemlab.agents.policies import has_memory
from chemlab.cli import app as command
from chemlab.cli.evaluation import RESULT_COLUMNS
from chemlab.cli.options import paragraphs
from chemlab.config.display import markdown_table
from chemlab.config.inherit import campaign_names, scenario_names, synthesis_names
from chemlab.config.loading import load_scenario
from chemlab.config.materials import Material
from chemlab.config.reactions import ReactionFamily, equation
from chemlab.config.scenario import MANAGER_AGENT, PHYSICS_TIERS, Scenario
from chemlab.lab import describe as facts
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.roles import operation_bench as operations
from chemlab.roles import reaction_bench as reaction
from chemlab.roles.bench import Bench

__all__ = ["NOTEBOOKS", "notebook", "pages", "setup_pages"]

HERE = Path(__file__).parent
NOTEBOOKS = ("tutorials/class.md", "tutorials/first-team.md", "chemist/distillation.md")
"""Pages that are also made as notebooks."""
OUT = "generated"
EXAMPLE = "wurtz_dodecane"
_NEVER_PUBLIC = ("chemlab.cli", "chemlab.record.", "chemlab.openchem")  # the package itself exports all of its names
_YET_PUBLIC = tuple(f"chemlab.openchem.{name}" for name in ("difficulty", "generate", "invented", "reaction_networks"))
_TIERS = tuple(PHYSICS_TIERS.values())
"""Their physical laws are documented on their own pages."""
Rows = Iterable[Sequence[Any]]


# -- Markdown ---------------------------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Rows, right: Sequence[int] = ()) -> str:
    """Return a Markdown table; ``right`` are the columns of numbers. Empty without rows."""
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    columns = {name: i in right for i, name in enumerate(head)}
    return "\n".join([*markdown_table(columns, cells), ""]) if cells else ""


def _facts(table: facts.FactTable) -> str:
    return (f"{table.note}\n\n" if table.note else "") + _table(table.head, table.rows, table.right)


def _markdown(docstring: str) -> str:
    """Convert a module's docstring to a page's text: it is Markdown except for references and heading levels."""
    text = re.sub(r":(class|func|meth|mod|data):`", r"{py:\1}`", docstring)
    text = re.sub(r"``([^`]+)``", r"`\1`", text)
    text = re.sub(r"::$", ":", text, flags=re.M)
    text = re.sub(r"^###", "##", text, flags=re.M)
    return re.sub(r"(?:^>>> .*\n?)+", _examples, text, flags=re.M)


def _examples(found: re.Match[str]) -> str:
    lines = [re.sub(r"\s*# doctest: .*", "", line.removeprefix(">>> ")) for line in found[0].splitlines()]
    return "\n".join(["```python", *lines, "```", ""])


def _docstring(module: str) -> str:
    """Return a module's docstring without importing the module, whose dependencies may be missing."""
    spec = importlib.util.find_spec(module)
    assert spec is not None, f"{module} was found before"
    assert spec.origin is not None, f"{module} has a file"
    return ast.get_docstring(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))) or ""


def _autodoc(*lines: str) -> str:
    return "\n".join(["```{eval-rst}", *lines, "```", ""])


# -- spaces -----------------------------------------------------------------------------------------------------------


def _bench_tables(bench: Bench, level: str) -> str:
    space = bench.observation_space.shape
    return "\n".join(
        [
            f"{level} Observation of `{bench.key}`: Box({space[0]})",
            "",
            _facts(facts.channel_table(bench)),
            f"{level} Actions of `{bench.key}`: {facts.space_words(bench.action_space)}",
            "",
            _facts(facts.action_table(bench.action_meanings, bool(bench.action_count))),
        ]
    )


# -- environments -----------------------------------------------------------------------------------------------------


def _spaces_of_all(labs: Laboratories) -> str:
    """Return every agent's spaces: a table of sizes, then the manager's parts, then each kind of bench."""
    spec = labs.scenario
    parts = [
        f"## Spaces in `{spec.name}`",
        "",
        "Sizes depend on the scenario; each scenario's page lists its own.",
        "",
        _facts(facts.agent_table(labs)),
        f"### Observation of `{MANAGER_AGENT}`: Box({labs.observation_sizes[0]})",
        "",
        _facts(facts.channel_table(labs.manager.workplace)),
        f"### Actions of `{MANAGER_AGENT}`: Discrete({len(labs.actions)})",
        "",
        _facts(facts.manager_action_table(labs)),
    ]
    kinds = {bench.key: bench for bench in labs.benches}
    return "\n".join([*parts, *(_bench_tables(bench, "###") for bench in kinds.values())])


def _bench_ids() -> str:
    """Return tables of every registered single bench."""
    parts = []
    for name, spec in gymnasium.registry.items():
        if spec.entry_point == "chemlab.envs.role_env:RoleEnv" and "scenario" in spec.kwargs:
            bench = ExperimentBatch(spec.kwargs["scenario"], spec.kwargs["bench"]).bench
            scored = f"Score: {bench.score_meaning}. Step limit: {bench.spec.step_limit}."
            doc = _markdown(inspect.getdoc(type(bench)) or "")
            parts += [f"## {name}", "", doc, "", scored, "", _bench_tables(bench, "###")]
    return "\n".join(parts)


def _environment(title: str, module: str, more: str, objects: Sequence[str]) -> str:
    link = "The interface, method by method: "
    links = ", ".join(f"{{py:obj}}`{module}.{name}`" for name in objects)
    return "\n".join(
        [
            f"# {title}",
            "",
            f"```{{py:currentmodule}} {module}",
            "```",
            "",
            _markdown(_docstring(module)),
            "",
            f"{link}{links}.",
            "",
            more,
        ]
    )


def _environments() -> dict[str, str]:
    labs = Laboratories(EXAMPLE)
    lab = "chemlab.envs"
    same = "## Spaces\n\nThe spaces are those of the [AEC environment](laboratory.md).\n"
    return {
        "laboratory": _environment("Laboratory (AEC)", f"{lab}.aec", _spaces_of_all(labs), ["env", "raw_env"]),
        "parallel": _environment("Laboratory (parallel)", f"{lab}.parallel", same, ["parallel_env"]),
        "role": _environment("One role", f"{lab}.role_env", _bench_ids(), ["RoleEnv", "RoleVectorEnv"]),
        "batched": _environment("Many laboratories at once", f"{lab}.batch", same, ["BatchedLaboratory"])
        + "\n## Class\n\n"
        + _autodoc(f".. autoclass:: {lab}.batch.BatchedLaboratory", "   :no-index:"),
    }


# -- scenarios --------------------------------------------------------------------------------------------------------


def _results() -> dict[str, list[list[str]]]:
    """Return raw scores of scripted and random agents by scenario, as rows with the policy first."""
    found: dict[str, list[list[str]]] = {}
    for page in (HERE / "results" / "scripted.md", HERE / "syntheses.md"):
        text = page.read_text(encoding="utf-8")
        block = text.partition("<!-- results: begin -->")[2].partition("<!-- results: end -->")[0]
        for line in block.splitlines():
            cells = [cell.strip() for cell in line.strip("| ").split("|")]
            if cells[0].startswith("`"):
                found.setdefault(cells[0].strip("`"), []).append(cells[1:])
    return found


def _chemistry(spec: Scenario) -> str:
    rows = [
        (
            facts.code(name),
            ", ".join(filter(None, (m.formula, m.cas))),
            m.role,
            f"{m.molar_mass_g_mol:.2f}",
            f"{m.density_kg_l:.3g}",
            f"{m.boiling_point_k:.1f}",
            "" if m.polarity is None else f"{m.polarity:g}",
        )
        for name, m in spec.materials.items()
    ]
    head = ("material", "formula, CAS", "role", "g/mol", "kg/L", "boils (K)", "polarity")
    reactions = [
        (facts.code(equation(step)), f"{step.pre_exponential:g}", f"{step.activation_energy_j_mol / 1000:g}")
        for step in spec.family.reaction
    ]
    parts = [
        "## Chemistry",
        "",
        "Each number's source is in the material's file.",
        "",
        _table(head, rows, right=range(3, 7)),
    ]
    parts += [_table(("reaction", "A", "Ea (kJ/mol)"), reactions, right=(1, 2))]
    if spec.family.salt:
        salts = ", ".join(f"`{s.solid} ⇌ {s.cation} + {s.anion}`" for s in spec.family.salt)
        parts += [f"Salts, at their equilibrium in every vessel: {salts}.", ""]
    if spec.family.violent:
        violent = ", ".join(facts.code(equation(step)) for step in spec.family.violent)
        parts += [f"Violent, a safety event: {violent}.", ""]
    return "\n".join(parts)


AUDITS = HERE / "results" / "audits"
PICTURES = HERE / "_static" / "scenarios"


def _picture(spec: Scenario) -> str:
    return f"_static/scenarios/{spec.name}.webp"


def _pictured(spec: Scenario) -> str:
    return f"A scripted episode of {spec.name}"


def _gallery(specs: Sequence[Scenario]) -> str:
    """Return a card for each scenario: its animation, its task, and what it hides."""
    cards = []
    for spec in specs:
        hides = "; ".join(facts.hidden_words(spec))
        picture = f'<img src="{_picture(spec)}" alt="{_pictured(spec)}" loading="lazy" width="640" height="360">'
        secret = f"<em>Hidden: {html.escape(hides)}.</em>" if hides else "<em>Nothing is hidden.</em>"
        cards += [
            f'<a class="scenario" href="generated/scenarios/{spec.name}.html">',
            f"{picture if (PICTURES / f'{spec.name}.webp').is_file() else ''}<strong>{spec.name}</strong>",
            f"<span>{html.escape(spec.title)}. {html.escape(_first_clause(spec.summary))}</span>{secret}</a>",
        ]
    return "\n".join(["```{raw} html", '<div class="gallery">', *cards, "</div>", "```", ""])


def _first_clause(summary: str) -> str:
    """Return the part of a summary before its first colon, as a sentence."""
    return summary.partition(":")[0].rstrip(".") + "."


def feature_rows(specs: Sequence[Scenario]) -> list[tuple[str, ...]]:
    """Return the features of scenarios: agents, backend, hidden parameters, orders, memory and horizon."""
    rows = []
    for spec in specs:
        arriving = len(spec.demand.order)
        orders = f"{spec.orders}{' over time' if arriving else ''}"
        rows.append(
            (
                f"[`{spec.name}`]({spec.name}.md)",
                ", ".join(
                    ["manager", *(f"{b.count} {key}" if b.count > 1 else key for key, b in spec.benches.items())]
                ),
                spec.physics,
                "; ".join(facts.hidden_words(spec)) or "nothing",
                orders,
                "yes" if has_memory(spec) else "no",
                f"{spec.limits.ticks} ticks, {spec.limits.manager_actions} decisions",
            )
        )
    return rows


def _audit(spec: Scenario) -> dict[str, Any] | None:
    """Return a scenario's committed audit, or None."""
    path = AUDITS / f"{spec.name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def _audit_section(spec: Scenario) -> list[str]:
    found = _audit(spec)
    if found is None:
        return []
    rows = [(name, said, by) for name, said, by in measure_rows(found)]
    criteria = ", ".join(
        f"{name} {'met' if met else 'not met'}" for name, met in found["criteria"].items() if met is not None
    )
    said = "An open-loop policy solves it. " if found["criteria"]["open_loop"] is False else ""
    return [
        "## Required abilities",
        "",
        f"{said}0 is random legal play, 1 a planner that knows each episode "
        f"(`chemlab audit {spec.name} --budget {found['budget']}`, {found['budget_episodes']} episodes, chemlab "
        f"{found['versions']['chemlab']}; see [Hidden parameters](../../worlds.md#audit)).",
        "",
        _table(("measure", "value [95 % interval]", "by"), rows),
        f"Acceptance criteria: {criteria}.",
        "",
    ]


def _audit_cells(spec: Scenario) -> tuple[str, str, str]:
    """Return open-loop score, reference score and value of information for the table of scenarios."""
    found = _audit(spec)
    if found is None:
        return "", "", ""
    return tuple(f"{found[key]['value']:.2f}" for key in ("open_loop", "reference", "value_of_information"))  # type: ignore[return-value]


def _replay(spec: Scenario) -> list[str]:
    """Return the replay page of a scenario's scripted episode, or its animation where the page has not been made."""
    if (HERE / "_static" / "replays" / f"{spec.name}.html").is_file():
        title = f"Replay of the scripted episode of {spec.name}, seed 0"
        page = f"../../_static/replays/{spec.name}.html"
        frame = f'<iframe class="replay" src="{page}" title="{title}" loading="lazy"></iframe>'
        text = f'<p class="replay"><a href="{page}">Open the replay on a page of its own</a></p>'
    elif (PICTURES / f"{spec.name}.webp").is_file():
        frame, text = f'<img class="replay" src="../../{_picture(spec)}" alt="{_pictured(spec)}">', ""
    else:
        return []
    return ["```{raw} html", frame, text, "```", ""]


def _scenario_page(spec: Scenario) -> str:
    labs = Laboratories(spec)
    results = _results().get(spec.name, [])
    hides = facts.hidden_words(spec)
    parts = [
        f"# {spec.name}",
        "",
        f"**{spec.title}.** {spec.summary}",
        "",
        f"Hidden from the agents: {'; '.join(hides)}." if hides else "No hidden parameters.",
        "",
        *_replay(spec),
        "```console",
        f"chemlab run {spec.argument}",
        f"chemlab serve {spec.argument}",
        "```",
        "",
        "```python",
        "from chemlab import env",
        "",
        f'laboratory = env("{spec.argument}", render_mode="ansi")',
        "laboratory.reset(seed=0)",
        "print(laboratory.render())",
        "```",
        "",
        *facts.goal_words(spec),
        "",
        _facts(facts.agent_table(labs)),
        "## Initial state and prices",
        "",
        f"A shelf of {spec.shelf.slots} slots; an episode begins with",
        "",
        _facts(facts.vessel_table(spec)),
        "and the stock:",
        "",
        _facts(facts.stock_table(spec)),
        "Prices are in units of the score: 1 is the theoretical maximum of the product, pure.",
        "",
        _facts(facts.instrument_table(labs)),
        *(["## Hidden parameters", "", _facts(facts.world_table(spec))] if spec.world.draws else []),
        *(["## Grades", "", _facts(facts.grade_table(spec))] if spec.grades else []),
        *(["## Reports", "", *facts.report_words(spec), ""] if facts.report_words(spec) else []),
        *(["## Degradation", "", *facts.wear_words(spec)] if facts.wear_words(spec) else []),
        "## Limits, costs, rewards",
        "",
        facts.limit_words(spec),
        "",
        facts.safety_words(spec),
        "",
        facts.reward_words(spec),
        "",
    ]
    parts += _audit_section(spec)
    if results:
        parts += ["## Scripted and random play", "", "Means of 100 episodes, seeds 0 to 99 (`chemlab evaluate`).", ""]
        parts += [_table(RESULT_COLUMNS[1:], results, right=range(1, 7))]
    parts += ["## Benches", ""]
    for bench in {bench.key: bench for bench in labs.benches}.values():
        count = bench.spec.count
        begins = bench.spec.start
        contents = facts.amount_words(begins.contents)
        contents += f", {begins.goal_mol:g} mol of the goal" if begins.goal_mol else ""
        if (also := begins.companion) is not None:
            chance = "" if also.probability == 1.0 else f" with probability {also.probability:g}"
            contents += f", and{chance} {also.mol:g} mol `{also.material}` (`{also.if_goal}` where that is the goal)"
        parts += [
            f"### {bench.key}: {bench.spec.kind}",
            "",
            f"{'One' if count == 1 else count} in the laboratory; at most {bench.spec.step_limit} steps. "
            f'`starts="paper"`: {contents}, in {begins.capacity_l:g} L.',
            "",
            _bench_tables(bench, "####"),
        ]
    file = Path(spec.origin)
    parts += [_chemistry(spec), "## File", "", f"`{file.name}`:", ""]
    parts += ["```toml", file.read_text(encoding="utf-8").rstrip(), "```", ""]
    return "\n".join(parts)


_PLAYED = ("scripted", "random")


def _scenarios() -> dict[str, str]:
    specs = [load_scenario(name) for name in scenario_names()]
    syntheses = [load_scenario(name) for name in synthesis_names()]
    campaigns = [load_scenario(name) for name in campaign_names()]
    found = {spec.name: _scenario_page(spec) for spec in (*specs, *campaigns, *syntheses)}
    scores = {name: {row[0]: row[3] for row in rows} for name, rows in _results().items()}
    rows = [
        (
            f"[`{s.name}`]({s.name}.md)",
            scores.get(s.name, {}).get("scripted", ""),
            scores.get(s.name, {}).get("random", ""),
            *_audit_cells(s),
        )
        for s in specs
    ]
    found["index"] = "\n".join(
        [
            "# Scenarios",
            "",
            "A scenario is a file: materials, reactions, stock, shelf, benches with their action tables, instruments,",
            "prices, limits and rewards. Play one with `chemlab run NAME`; write your own as described in",
            "[Write a scenario](../../how-to/scenario.md).",
            "",
            _table(("scenario", "agents", "backend", "hidden", "orders", "memory", "horizon"), feature_rows(specs)),
            "*Memory*: the scripted manager keeps what it has found out, so that `scripted:memoryless` is another",
            "policy. The other columns are [terms of the glossary](../../glossary.md#terms).",
            "",
            "## Scores",
            "",
            _table(
                ("scenario", "scripted", "random", "open-loop", "reference", "value of information"), rows, range(1, 6)
            ),
            "The first two are raw scores, means of 100 episodes ([table](../../results/scripted.md)). The last",
            "three are normalized scores of an [audit](../../worlds.md#audit): where the open-loop policy comes close",
            "to the scripted one, observations are not needed.",
            "[What a score means](../../glossary.md#what-a-score-means).",
            "",
            "## Campaigns",
            "",
            "Scenarios made for optimizers, in addition to the benchmark:",
            "[Optimize a campaign](../../chemist/campaign.md).",
            "",
            _table(("campaign", "description"), [(f"[`{s.name}`]({s.name}.md)", s.summary) for s in campaigns]),
            "## Syntheses",
            "",
            "Scenarios that reproduce publications, in addition to the benchmark; their validation:",
            "[Syntheses](../../syntheses.md).",
            "",
            _table(
                ("synthesis", "description", "scripted score", "random score"),
                [
                    (f"[`{s.name}`]({s.name}.md)", s.summary, *(scores.get(s.name, {}).get(p, "") for p in _PLAYED))
                    for s in syntheses
                ],
                (2, 3),
            ),
            "```{toctree}",
            ":hidden:",
            "",
            *(spec.name for spec in (*specs, *campaigns, *syntheses)),
            "```",
            "",
        ]
    )
    return found


# -- leaderboard ------------------------------------------------------------------------------------------------------


def _bar(value: float) -> str:
    """Return a bar from 0 to 1; a score below 0 has none."""
    width = f"{100 * min(max(value, 0.0), 1.0):.0f}%"
    return f'<span class="score" role="img" aria-label="{value:.2f}"><span style="width:{width}"></span></span>'


def _leaderboard() -> str:
    parts = [
        "# Leaderboard",
        "",
        "Normalized scores in the split `test`, with 95 % intervals: 0 is random legal play, 1 the oracle",
        "([what a score means](../glossary.md#what-a-score-means)). The",
        "[protocol](../protocol.md#baselines) says what the policies are, and how to add a row.",
        "",
    ]
    for name, rows in standings().items():
        cells = [(policy, _bar(value), text) for policy, value, text in rows]
        parts += [f"## {name}", "", _table(("policy", "0 to 1", "score"), cells, right=(2,))]
    return "\n".join(parts)


# -- keys of data files -----------------------------------------------------------------------------------------------

_FILES: dict[str, type[pydantic.BaseModel]] = {
    "Scenario": Scenario,
    "Reaction bench": reaction.ReactionOptions,
    "Extraction, distillation and crystallization bench": operations.OperationOptions,
    "Material": Material,
    "Reaction family": ReactionFamily,
}


def _models(hint: Any) -> list[type[pydantic.BaseModel]]:
    """Return the models in a type, each followed by those of its fields."""
    if isinstance(hint, type) and issubclass(hint, pydantic.BaseModel):
        fields = (field.annotation for field in hint.model_fields.values())
        return list(dict.fromkeys([hint, *(model for each in fields for model in _models(each))]))
    return [model for argument in typing.get_args(hint) for model in _models(argument)]


def _type(hint: Any) -> str:
    """Return a field's type in words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is type(None):
        return "nothing"
    if origin is typing.Annotated:
        return _type(arguments[0])
    if origin is typing.Literal:
        return "one of " + facts.codes(arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_type(argument) for argument in arguments if argument is not type(None))
    if origin is tuple:
        return f"list of {_type(arguments[0])}"
    if origin is dict:
        return f"by name: {_type(arguments[1])}"
    if isinstance(hint, type) and issubclass(hint, pydantic.BaseModel):
        return f"[{hint.__name__}](#{hint.__name__.lower()})"
    return {str: "text", int: "integer", float: "number", bool: "true or false"}.get(hint, str(hint))


_SIGNS = {
    "gt": ">",
    "ge": "≥",
    "lt": "<",
    "le": "≤",
    "min_length": "length ≥",
    "max_length": "length ≤",
    "pattern": "matches",
}


def _bounds(field: pydantic.fields.FieldInfo) -> str:
    """Return a field's bounds in words, including those of a list's or a table's values."""
    texts = _limits(field.metadata)
    hint = field.annotation
    while len(typing.get_args(hint)) and typing.get_origin(hint) in (tuple, dict, typing.Annotated):
        inner = typing.get_args(hint)[1 if typing.get_origin(hint) is dict else 0]
        if typing.get_origin(inner) is typing.Annotated:
            each = [item for part in inner.__metadata__ for item in getattr(part, "metadata", [part])]
            texts += [f"each {text}" for text in _limits(each)]
        hint = inner
    return ", ".join(texts)


def _limits(metadata: Iterable[Any]) -> list[str]:
    return [
        f"{sign} {facts.code(value) if name == 'pattern' else value}"
        for item in metadata
        for name, sign in _SIGNS.items()
        if (value := getattr(item, name, None)) is not None
    ]


def _kinds() -> str:
    """Return the data files of the bench kinds."""
    parts = [
        "## Defaults of the bench kinds",
        "",
        "Defaults of a scenario's `[benches.KEY]`, key by key.",
        "",
    ]
    for path in sorted((Path(chemlab.__file__).parent / "data" / "benches").glob("*.toml")):
        parts += [f"### {path.stem}", "", "```toml", path.read_text(encoding="utf-8").rstrip(), "```", ""]
    return "\n".join(parts)


def _default(field: pydantic.fields.FieldInfo) -> str:
    if field.is_required():
        return "**required**"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, pydantic.BaseModel) or value in (None, (), {}):
        return ""
    return facts.code(value)


def _keys_page() -> str:
    parts = [
        "# Keys of data files",
        "",
        "Made from the models that check the files. An unknown key, a value out of bounds or a name that does not",
        "exist is an error that says file, key, value and bound. Units are part of the names. A file has at most",
        "1,000,000 bytes and 12 levels, a table or list 10,000 entries, a text 4000 characters, a key 100.",
        "",
    ]
    for title, file in _FILES.items():
        parts += [f"## {title}", ""]
        for model in _models(file):
            docs = ModuleAnalyzer.for_module(model.__module__).find_attr_docs()
            owners = [base.__name__ for base in model.__mro__]
            rows = []
            for name, field in model.model_fields.items():
                texts = [docs[owner, name] for owner in owners if (owner, name) in docs]
                meaning = _markdown(" ".join(texts[0]).strip()) if texts else ""
                rows.append((facts.code(name), _type(field.annotation), _default(field), _bounds(field), meaning))
            about = _markdown(inspect.getdoc(model) or "")
            parts += [f"### {model.__name__}", "", about, ""]
            parts += [_table(("key", "value", "default", "bounds", "meaning"), rows)]
    return "\n".join([*parts, _kinds()])


# -- the command ------------------------------------------------------------------------------------------------------


def _command_page() -> str:
    parts = ["# The command", "", "`chemlab --help`, as a page.", ""]
    for name, found in sorted(_commands("chemlab", typer.main.get_command(command))):
        arguments = [p for p in found.params if p.param_type_name == "argument"]
        options = [p for p in found.params if p.param_type_name == "option" and p.name != "help"]
        usage = [name]
        for p in arguments:
            word = p.name.upper() + ("..." if p.nargs == -1 else "")
            usage.append(word if p.required else f"[{word}]")
        rows = [(facts.code(p.name.upper()), p.help or "", "") for p in arguments]
        for p in options:
            shown = isinstance(p.default, (str, int, float, Path)) and p.default is not False
            rows.append((facts.codes(p.opts), p.help or "", facts.code(p.default) if shown else ""))
        parts += [f"## {name}", "", facts.code(" ".join(usage)), "", paragraphs(found.help), ""]
        parts += [_table(("argument", "meaning", "default"), rows)]
    return "\n".join(parts)


def _commands(name: str, found: Any) -> Iterable[tuple[str, Any]]:
    """Yield (words, command) of every command of a group."""
    for word, below in getattr(found, "commands", {}).items():
        if hasattr(below, "commands"):
            yield from _commands(f"{name} {word}", below)
        else:
            yield f"{name} {word}", below


# -- interface --------------------------------------------------------------------------------------------------------


def _modules() -> list[str]:
    """Return every public module that defines or re-exports something."""
    found = []
    for package in ("chemlab", "chemlab.agents"):
        # Search only the package's own folder: in a checkout its path contains other folders of the checkout as well.
        spec = importlib.util.find_spec(package)
        assert spec is not None, f"{package} is there"
        assert spec.origin is not None, f"{package} has a file"
        found += [package, *(m.name for m in pkgutil.walk_packages([str(Path(spec.origin).parent)], f"{package}."))]
    found.remove("chemlab")
    public = []
    for name in dict.fromkeys(found):
        if (name.startswith(_NEVER_PUBLIC) and name not in _YET_PUBLIC) or "._" in name:
            continue
        spec = importlib.util.find_spec(name)
        text = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin is not None else ""
        if re.search(r"^(__all__|[A-Z]\w*\b.* = |(def|class) [A-Za-z])", text, re.MULTILINE):
            public.append(name)
    return sorted(public)


def _interface() -> dict[str, str]:
    found = {}
    modules = _modules()
    for name in modules:
        found[name] = "\n".join(
            [
                # In the sidebar of every page, nearly 200 modules would take two fifths of the time of a build.
                "---\norphan: true\n---",
                f"# {name}",
                "",
                "[All modules](index.md)",
                "",
                f"```{{py:currentmodule}} {name}",
                "```",
                "",
                _markdown(_docstring(name)),
                "",
                _autodoc(f".. automodule:: {name}" + "\n   :no-members:" * (name in _TIERS)),
            ]
        )
    packages = {
        "Data": [m for m in modules if m.startswith("chemlab.config")],
        "Kernels": [m for m in modules if m.startswith("chemlab.kernels")],
        "Physics": [m for m in modules if m.startswith("chemlab.physics")],
        "Roles": [m for m in modules if m.startswith("chemlab.roles") and m.count(".") == 2],
        "Laboratory": [m for m in modules if m.startswith(("chemlab.lab.", "chemlab.envs", "chemlab.laboratory"))],
        "Records": [m for m in modules if m.startswith("chemlab.record")],
        "Pictures": [m for m in modules if m.startswith("chemlab.render")],
        "A flask alone": [
            m for m in modules if m.startswith(("chemlab.sandbox", "chemlab.flask", "chemlab.conformance"))
        ],
        "Random chemistries": [m for m in modules if m.startswith("chemlab.openchem")],
        "Agents and campaigns": [m for m in modules if m.startswith(("chemlab.agents.", "chemlab.campaign"))],
    }
    lines = [
        "# Interface",
        "",
        "Every public module, from its docstrings. Modules import only from modules above them in this list.",
        "",
    ]
    for title, members in packages.items():
        rows = [(f"[`{name}`]({name}.md)", _first_sentence(name)) for name in members]
        lines += [f"## {title}", "", _table(("module", "description"), rows), ""]
    found["index"] = "\n".join(lines)
    return found


def _first_sentence(module: str) -> str:
    text = " ".join(_docstring(module).split("\n\n")[0].split())
    return _markdown(text)


# -- Sphinx -----------------------------------------------------------------------------------------------------------


def pages() -> dict[str, str]:
    """Return every generated page as {path below ``docs/generated``: Markdown}."""
    found = {f"environments/{name}.md": text for name, text in _environments().items()}
    found |= {f"scenarios/{name}.md": text for name, text in _scenarios().items()}
    found |= {
        "gallery.md": _gallery([load_scenario(name) for name in scenario_names()]),
        "leaderboard.md": _leaderboard(),
    }
    found |= {f"api/{name}.md": text for name, text in _interface().items()}
    return {**found, "keys.md": _keys_page(), "command.md": _command_page()}


def notebook(page: str) -> str:
    """Return a page as a Jupyter notebook: its Python blocks and commands are cells to run, its files are written."""
    cells = []
    for part in re.split(r"^(```(?:python|bash|toml)\n.*?^```\n)", page, flags=re.S | re.M):
        found = re.fullmatch(r"```(\w+)\n(?:# file: (\S+)\n)?(.*)```\n", part, re.S)
        cell = {"cell_type": "code" if found else "markdown", "metadata": {}, "source": part.strip()}
        if found:
            text = f"%%writefile {found[2]}\n{found[3]}" if found[2] else found[3]
            if found[1] == "bash":  # in the system's shell: on Windows, there may be no bash
                text = re.sub(r"^(?=[^\s#])", "!", re.sub(r"\\\n +", "", text), flags=re.M)
            cell |= {"source": text.rstrip(), "outputs": [], "execution_count": None}
        if cell["source"]:
            cells.append(cell)
    return json.dumps({"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}, indent=1) + "\n"


def _write_pages(app: Sphinx) -> None:
    folder = HERE / OUT
    made = pages()
    made |= {f"notebooks/{Path(p).stem}.ipynb": notebook((HERE / p).read_text(encoding="utf-8")) for p in NOTEBOOKS}
    for path in sorted(folder.rglob("*.md")) if folder.exists() else []:
        if str(path.relative_to(folder)) not in made:
            path.unlink()
    for name, text in made.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unchanged pages are not rewritten, so that Sphinx need not read them again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _fit_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Remove module docstrings, which have their own pages, and convert Markdown tables in other docstrings."""
    if what == "module":
        lines.clear()
        return
    fitted: list[str] = []
    for is_table, group in groupby(lines, key=lambda line: line.startswith("|")):
        if is_table:
            head, _, *rows = [line.strip("| ").split("|") for line in group]
            fitted += ["", ".. list-table::", "   :header-rows: 1", ""]
            for row in [head, *rows]:
                fitted += [
                    f"   {'-' if i else '* -'} {cell.strip()}".replace("   -", "     -", 1)
                    for i, cell in enumerate(row)
                ]
            fitted.append("")
        else:
            # "N." alone would begin a list.
            fitted += [re.sub(r"^(\s+\w)\.$", r"\1\\.", line) for line in group]
    lines[:] = fitted


def _fit_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Simplify array annotations to ``ndarray[float32]``; omit the fields of a model, which the page of keys lists."""
    if isinstance(obj, type) and issubclass(obj, pydantic.BaseModel):
        return "(**values)", None

    array = r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?(?:\w+\.)*(\w+)\]\]"

    def short(text: str | None) -> str | None:
        if text is None:
            return None
        return re.sub(array, r"ndarray[\1]", re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text))

    return short(signature), short(returned)


def setup_pages(app: Sphinx) -> dict[str, Any]:
    """Register the hooks of ``conf.py`` with Sphinx."""
    app.connect("builder-inited", _write_pages)
    app.connect("autodoc-process-docstring", _fit_docstring)
    app.connect("autodoc-process-signature", _fit_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
