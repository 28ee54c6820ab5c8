"""Open chemistry: materials, pairs, reactions and scenarios from names, structures, templates or a seed.

It runs offline and makes data files, which the rest of chemlab reads. Names, structures and templates need the extra
``chem`` (rdkit, chemicals, thermo, ugropy); invented chemistries (:mod:`.generate`) do not. No other part of the
package imports it.
"""

from __future__ import annotations
