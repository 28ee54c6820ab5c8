"""A seat as an instrument of IvoryOS's deck, for people: ``python recipes/seats/ivoryos_deck.py``, then port 8000.

IvoryOS needs no adapter: it finds the object and its typed methods in this module. Run with ivoryos 1.7.2.
"""

from __future__ import annotations

from chemlab.agents.seats import LabTools, Room

laboratory = LabTools(Room("wurtz_dodecane", ("manager_0",), folder="results"), "manager_0")

if __name__ == "__main__":
    import ivoryos

    ivoryos.run(__name__, host="127.0.0.1")
