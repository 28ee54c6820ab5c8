"""``python -m chemlab``: the ``chemlab`` command."""

from chemlab.cli import main

main()
