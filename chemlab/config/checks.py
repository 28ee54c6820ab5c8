"""Checks of a scenario against the materials and reactions that it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .catalogue import unknown_material
from .datafile import DataError
from .datamodel import validated
from .draws import BOTTLE, DEVICE_QUANTITIES, ORDER_QUANTITIES, VESSEL_QUANTITIES, Draw, changed_limits, draw_limits
from .materials import Materials, litres_of
from .reactions import ReactionFamily
from .scenario import OrderTerms, Scenario, StartSpec, VesselSpec

_NEUTRAL = 1e-9
"""Relative charge of contents up to which it counts as rounding."""


def mentioned_materials(spec: Scenario) -> list[tuple[str, str]]:
    """Return (key, material) of every material that a scenario file names, in order, except those with a price only."""
    found = [("stock", name) for name in spec.stock]
    for i, vessel in enumerate(spec.shelf.vessel):
        found += [(f"shelf.vessel.{i}.contents", name) for name in vessel.contents]
    for key, bench in spec.benches.items():
        found += [(f"benches.{key}.start.contents", name) for name in bench.start.contents]
        if bench.start.companion is not None:
            companion = bench.start.companion
            found += [(f"benches.{key}.start.companion", name) for name in (companion.material, companion.if_goal)]
    found += [("goals", name) for name in spec.goals]
    for key, draw in spec.world.draws.items():
        found += [(f"world.draws.{key}", name) for name in draw.materials]
    return found


def _vessels(spec: Scenario) -> dict[str, tuple[str, VesselSpec | StartSpec]]:
    """Return the declared vessels by their name in draws (``slot_0``, ``rxn``), each with its key in the file."""
    shelf: dict[str, tuple[str, VesselSpec | StartSpec]] = {
        f"slot_{i}": (f"shelf.vessel.{i}", vessel) for i, vessel in enumerate(spec.shelf.vessel)
    }
    return shelf | {key: (f"benches.{key}.start", bench.start) for key, bench in spec.benches.items()}


def _filled(
    vessel: VesselSpec | StartSpec, changed: Mapping[str, float], goals: Sequence[str], known: Materials
) -> float:
    """Return the most litres that a vessel may hold, with ``changed`` mol of some of its contents."""
    filled = litres_of({**vessel.contents, **changed}, known)
    if isinstance(vessel, StartSpec):
        filled += max(litres_of({goal: vessel.goal_mol}, known) for goal in goals)
        also = vessel.companion
        if also is not None:
            filled += max(litres_of({name: also.mol}, known) for name in (also.material, also.if_goal))
    return filled


def check_vessels(spec: Scenario, known: Materials, where: str) -> None:
    """Check that contents fit their vessels."""
    for key, vessel in _vessels(spec).values():
        filled = _filled(vessel, {}, spec.goals, known)
        if filled > vessel.capacity_l:
            raise DataError(
                f"{where}: {key}: contents of {filled:.4g} L do not fit in capacity_l = {vessel.capacity_l:g}"
            )


def check_charges(spec: Scenario, known: Materials, family: ReactionFamily, where: str) -> None:
    """Check that ions have counter-ions that balance their charge."""

    def alone(key: str, name: str) -> None:
        if not known[name].charge:
            return
        salts = [salt.solid for salt in family.salt if name in (salt.cation, salt.anion)]
        hint = f"name a salt of it ({', '.join(salts)})" if salts else "name a salt of it, with its [[salt]] entry"
        raise DataError(f"{where}: {key}: {name!r} is an ion, which cannot occur alone; {hint} instead")

    for name in spec.stock:
        alone("stock", name)
    for key, vessel in _vessels(spec).values():
        charge = sum(mol * known[name].charge for name, mol in vessel.contents.items())
        if abs(charge) > _NEUTRAL * sum(mol * abs(known[name].charge) for name, mol in vessel.contents.items()):
            raise DataError(
                f"{where}: {key}.contents: must be neutral; the charge is {charge:+.4g} mol; add the ions that "
                "balance it, or salts"
            )
        if isinstance(vessel, StartSpec) and vessel.goal_mol:
            for goal in spec.goals:
                alone(f"{key}.goal_mol", goal)
        if isinstance(vessel, StartSpec) and vessel.companion is not None:
            for name in (vessel.companion.material, vessel.companion.if_goal):
                alone(f"{key}.companion", name)
    for key, bench in spec.benches.items():
        options = bench.model_extra or {}
        reagents, process = options.get("reagents"), options.get("process")
        named = [("reagents", name) for name in reagents] if isinstance(reagents, Mapping) else []
        for i, entry in enumerate(process if isinstance(process, (list, tuple)) else ()):
            named += [(f"process.{i}.material", entry.get("material"))] if isinstance(entry, Mapping) else []
        for option, name in named:
            if isinstance(name, str) and name in known:  # the bench's options model refuses other values
                alone(f"benches.{key}.{option}", name)
    for key, draw in spec.world.draws.items():
        if draw.what in VESSEL_QUANTITIES:
            for name in draw.materials:
                alone(f"world.draws.{key}", name)


def check_draws(spec: Scenario, known: Materials, where: str) -> None:
    """Check that nothing is drawn twice, that drawn vessels exist, and that drawn contents fit."""
    starts = {name: vessel for name, (_, vessel) in _vessels(spec).items()}
    drawn: dict[tuple[str, str, str], str] = {}
    most: dict[str, dict[str, float]] = {}
    for key, draw in spec.world.draws.items():
        here = f"{where}: world.draws.{key}"
        for name in draw.of or ("the laboratory",):
            other = drawn.setdefault((name, str(draw.material), draw.what), key)
            if other != key:
                raise DataError(f"{here}: {name}: world.draws.{other} draws its {draw.what} already; remove one")
        if draw.what in DEVICE_QUANTITIES:
            _check_devices(spec, draw, here)
        if draw.what in ORDER_QUANTITIES:
            _check_terms(spec, draw, here)
        if draw.what not in VESSEL_QUANTITIES:
            continue
        for name in draw.of:
            if name == BOTTLE and name not in starts:
                _check_bottle(spec, draw, here)
                continue
            if name not in starts:
                raise DataError(f"{here}.of: unknown vessel {name!r}; choose from {', '.join([*starts, BOTTLE])}")
            contents = starts[name].contents
            if draw.material not in contents:
                held = f"{', '.join(contents)} only" if contents else "nothing"
                raise DataError(f"{here}.material: {draw.material!r} is not in {name}, which has {held}")
            material = str(draw.material)
            _check_titre(draw, f"{here}: {name}")
            if draw.what == "amount":
                least, highest = changed_limits(draw, starts[name].contents[material])
                most.setdefault(name, {})[material] = highest
                filled = _filled(starts[name], most[name], spec.goals, known)
                if not (least >= 0.0 and filled <= starts[name].capacity_l):
                    raise DataError(
                        f"{here}: {name}: {least:g} to {highest:g} mol, up to {filled:.4g} L with all else that it may "
                        f"hold, must be at least 0 and fit in capacity_l = {starts[name].capacity_l:g}; give low and "
                        "high"
                    )


def _check_bottle(spec: Scenario, draw: Draw, where: str) -> None:
    """Check that drawn bottles exist and belong to one draw each."""
    if draw.material not in spec.stock:
        bottles = ", ".join(spec.stock) or "none"
        raise DataError(f"{where}.material: there is no bottle of {draw.material!r} in stock; choose from {bottles}")
    if draw.what == "amount":
        raise DataError(f"{where}.what: a bottle's amount is observed and cannot be hidden; draw its identity or titre")
    others = [other for other in spec.world.draws.values() if BOTTLE in other.of and other.material == draw.material]
    if len(others) > 1:
        raise DataError(f"{where}: the bottle of {draw.material!r} is drawn twice; remove one")
    _check_titre(draw, where)


def _check_devices(spec: Scenario, draw: Draw, where: str) -> None:
    """Check that drawn conditions belong to benches or instruments that have them."""
    if draw.what in ("gain", "life"):
        table, example = "wear", "{ gain = 1.0 }"
        known = {
            **{agent: agent.rpartition("_")[0] for agent in spec.bench_agents()},
            **{key: key for key in spec.benches},
        }
        lacking = {name for name, key in known.items() if spec.benches[key].wear is None}
    else:
        table, example = "drift", "{ error = 0.0 }"
        known = {name: name for name in spec.instruments}
        lacking = {name for name in known if spec.instruments[name].drift is None}
    for name in draw.of:
        if name not in known:
            raise DataError(f"{where}.of: {name!r} has no {draw.what}; choose from {', '.join(known)}")
        if name in lacking:
            kind = "benches" if table == "wear" else "instruments"
            raise DataError(f"{where}.of: {name!r} has no {table}; give {kind}.{known[name]} one: {table} = {example}")
    low, _ = draw_limits(draw)
    if table == "drift" and draw.change == "factor":
        raise DataError(f"{where}.change: must be offset or value for {draw.what}, whose declared value is 0")
    if table == "wear" and not (draw.change != "offset" and low > 0.0):
        raise DataError(f"{where}: {draw.what} must stay above 0; use factor or value, and give low")


def _check_terms(spec: Scenario, draw: Draw, where: str) -> None:
    """Check that drawn orders and terms exist."""
    terms = {f"order_{o}": order for o, order in enumerate(spec.demand.order)}
    for name in draw.of:
        if name not in terms:
            raise DataError(
                f"{where}.of: unknown order {name!r}; choose from {', '.join(terms) or 'none: give demand.order'}"
            )
        given = getattr(terms[name], draw.what)
        if given is None and draw.change != "value":
            raise DataError(f"{where}.change: {name} has no {draw.what} to change; add one, or use change = 'value'")
        for number in changed_limits(draw, 0.0 if given is None else given):
            validated(OrderTerms, {draw.what: number}, f"{where}: {name}")


def _check_titre(draw: Draw, where: str) -> None:
    low, high = draw_limits(draw)
    if draw.what == "titre" and not 0.0 <= low <= high <= 1.0:
        raise DataError(f"{where}: a titre must be from 0 to 1, given draws from {low:g} to {high:g}; set low and high")


def check_materials(named: list[tuple[str, str]], known: Materials, where: str) -> None:
    for key, name in named:
        if name not in known:
            raise DataError(f"{where}: {key}: {unknown_material(name, known)}")
        if known[name].role == "gas":
            raise DataError(f"{where}: {key}: {name!r} is a gas; bottles and vessels hold liquids and solids")
