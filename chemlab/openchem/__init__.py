"""Open chemistry: from a name, a structure or a reaction template to materials, pairs, reactions and a scenario.

Runs offline and before any environment does: it writes data files, which the rest of chemlab reads. Needs the extra
``chem`` (rdkit, chemicals, thermo, ugropy); nothing below imports it.
"""

from __future__ import annotations

__all__: list[str] = []
