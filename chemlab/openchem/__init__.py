"""Open chemistry: from a name, a structure, a template or a seed to materials, pairs, reactions and a scenario.

Runs offline and before any environment does: it makes data, which the rest of chemlab reads. What is made of names,
structures and templates needs the extra ``chem`` (rdkit, chemicals, thermo, ugropy), what is invented does not
(:mod:`.generate`); nothing below imports it.
"""

from __future__ import annotations

__all__: list[str] = []
