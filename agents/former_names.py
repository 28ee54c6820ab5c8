"""Names of policies: former ones, which are accepted for one release, and the way that a learned policy is played."""

from __future__ import annotations

import re
import sys

GREEDY, SAMPLED = "greedy", "sampled"
"""Ways to play a learned policy: its most probable action, or an action drawn from its distribution."""

_FORMER = {
    "heuristic": "scripted",
    "hasty": "scripted:unsafe",
    "direct": "scripted:no-extraction",
}
_NAMED = re.compile(rf"(?<![^,=])({'|'.join(_FORMER)})(?![^,@])")
_noticed: set[str] = set()


def current_name(policy: str) -> str:
    """Replace former names in a policy (``ROLE=POLICY`` exceptions included); a notice on stderr names each once."""

    def replace(found: re.Match[str]) -> str:
        old = found[0]
        if old not in _noticed:
            _noticed.add(old)
            print(
                f"policy {old!r} is now called {_FORMER[old]!r}; the old name ends with this release", file=sys.stderr
            )
        return _FORMER[old]

    return _NAMED.sub(replace, policy)


def split_way(policy: str) -> tuple[str, str | None]:
    """Split a policy's name from the way that it is played, if ``:greedy`` or ``:sampled`` follows it."""
    name, _, way = policy.rpartition(":")
    return (name, way) if name and way in (GREEDY, SAMPLED) else (policy, None)
