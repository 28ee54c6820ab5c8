"""Checks of what a batch is given: actions, and the arguments of its reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Integral
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ..config.scenario import MANAGER_AGENT
from ..kernels.rng import checked_seed
from ..lab.hidden import World, Worlds


def check_count(name: str, number: Any, after: str = "") -> None:
    """Check a number of members or threads.

    Args:
        name: of the argument.
        number: the given one.
        after: the argument that follows it, for who swaps them.

    Raises:
        ValueError: it is no integer of at least 1.
    """
    if not isinstance(number, Integral) or isinstance(number, bool) or number < 1:
        place = f" and comes before {after}" if after else ""
        raise ValueError(f"{name} must be an integer of at least 1{place}, given {number!r:.100}")


def checked_options(
    options: Any, goals: Sequence[str], worlds: Worlds, known: Sequence[str] = ("goal", "world"), strict: bool = True
) -> dict[str, Any]:
    """Return the options of a reset (None: none).

    Args:
        options: the given ones.
        goals: possible goals.
        worlds: worlds of the members.
        known: names of options.
        strict: whether other names are an error; otherwise they are a warning.

    Raises:
        ValueError: they are no dict, one of them is unknown, or the goal or world is invalid.
    """
    if not isinstance(options, Mapping | None):
        raise ValueError(f'reset: options must be a dict such as {{"goal": "{goals[0]}"}}, given {options!r:.100}')
    given = dict(options or {})
    unknown = [str(name) for name in given if name not in known]
    if unknown:
        told = f"reset options: known: {', '.join(known)}; {'given' if strict else 'ignored'}: {', '.join(unknown)}"
        if strict:
            raise ValueError(told)
        gymnasium.logger.warn(told)
    if given.get("goal") not in (None, *goals):
        raise ValueError(f"goal: must be one of {', '.join(goals)}, given {given['goal']!r:.100}")
    worlds.check(given.get("world"))
    return given


def check_by_agent(actions: Any) -> None:
    """Check that the actions of a round are given by agent.

    Raises:
        ValueError: they are no mapping.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(
            f'step: needs a mapping of actions by agent such as {{"{MANAGER_AGENT}": ...}}, given {actions!r:.100}'
        )


def number_of(agent: str, agents: Sequence[str]) -> int:
    """Return the index of an agent.

    Raises:
        ValueError: there is no such agent; the message names all.
    """
    if agent not in agents:
        raise ValueError(f"unknown agent {agent!r:.100}; agents: {', '.join(agents)}")
    return agents.index(agent)


def _given(actions: Any, numbers: npt.NDArray[Any] | None, high: float, rows: npt.NDArray[np.bool_] | None) -> str:
    """Describe refused actions: the first of their ``numbers`` that is not in [0, high], in the rows that count, with
    its place; without numbers what was given.
    """
    if numbers is None:
        return f"{actions!r:.200}"
    wrong = ~((numbers >= 0) & (numbers <= high))
    if rows is not None:
        wrong[~rows] = False
    at = np.argwhere(wrong)[0].tolist()
    return f"{numbers[tuple(at)].item()!r} at {at}"


def checked_actions(
    agent: str,
    actions: Any,
    count: int,
    space: gymnasium.Space[Any],
    rows: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[Any]:
    """Return a batch of actions as int64 [B] or float64 [B, n].

    Args:
        agent: name of the agent, for the error message.
        actions: the given actions.
        count: batch size B.
        space: action space of a member.
        rows: [B] rows that count; others may have any values.

    Raises:
        ValueError: an action is outside the space, or the batch has another shape; the message has the first wrong
            number and its place.
    """
    try:
        values = np.asarray(actions)
    except ValueError:  # lists of different lengths
        values = np.empty((), dtype=object)
    numbers: npt.NDArray[Any] | None = None
    # Kernels need native contiguous arrays, whatever layout, width and byte order is given.
    if isinstance(space, gymnasium.spaces.Discrete):
        last = int(space.n) - 1
        if values.dtype.kind in "iu" and values.shape == (count,):
            numbers, whole = values, np.ascontiguousarray(values, dtype=np.int64)
            # Without a sign, negative numbers are very large.
            if (whole if rows is None else whole[rows]).view(np.uint64).max(initial=0) <= last:
                return whole
        raise ValueError(
            f"{agent}: actions must be {count} integers from 0 to {last}, given {_given(actions, numbers, last, rows)}"
        )
    shape = (count, *(space.shape or ()))
    if values.dtype.kind in "fiu" and values.shape == shape:
        numbers = np.ascontiguousarray(values, dtype=np.float64)
        shown = numbers if rows is None else numbers[rows]
        if not shown.size or (shown.min() >= 0.0 and shown.max() <= 1.0):  # False for NaN
            return numbers
    given = _given(actions, numbers, 1.0, rows)
    raise ValueError(f"{agent}: actions must be {list(shape)} finite numbers from 0 to 1, given {given}")


def parsed_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed or None for each of ``count`` members; arguments and errors are those of :func:`parsed_reset`."""
    if isinstance(seed, str) or not np.ndim(seed):  # type: ignore[arg-type]
        first = checked_seed(seed)
        return [None if first is None else first + i for i in range(count)]
    seeds = [checked_seed(own, f"seed[{i}]") for i, own in enumerate(seed)]  # type: ignore[arg-type]
    if len(seeds) != count:
        raise ValueError(f"seed: needs one for each of {count} members, given {len(seeds)}")
    return seeds


def parsed_reset(
    seed: int | Sequence[int | None] | None,
    options: dict[str, Any] | None,
    count: int,
    goals: Sequence[str],
    worlds: Worlds,
    begun: bool,
    random: np.random.Generator,
) -> tuple[npt.NDArray[np.bool_], list[int | None], str | None, World | None]:
    """Parse the arguments of a batch's ``reset``.

    Args:
        seed: s seeds member i with s + i; a sequence gives each member its own (None: the next episode of its series);
            members without one get one from ``random`` at the first reset.
        options: ``{"reset_mask": bool [N]}``, ``{"goal": name}``, ``{"world": seed or values}``.
        count: number of members N.
        goals, worlds: as for :func:`checked_options`.
        begun: whether the batch has been reset before.
        random: source of seeds.

    Returns:
        Members to reset [N], a seed or None for each, a goal or None, a world or None.

    Raises:
        ValueError: an option, goal or world is unknown, a mask or seeds have the wrong length, or a seed is not a
            non-negative integer.
    """
    options = checked_options(options, goals, worlds, ("goal", "world", "reset_mask"))
    mask = np.asarray(options.get("reset_mask", np.ones(count, dtype=np.bool_)))
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise ValueError(f"reset_mask must be {count} booleans, given {mask.dtype} of shape {mask.shape}")
    if not (begun or mask.all()):
        raise ValueError("reset_mask: the first reset must be of all members")
    seeds = parsed_seeds(seed, count)
    if not begun and None in seeds:
        drawn = random.integers(2**63, size=count).tolist()
        seeds = [one if own is None else own for own, one in zip(seeds, drawn, strict=True)]
    return mask, seeds, options.get("goal"), options.get("world")
