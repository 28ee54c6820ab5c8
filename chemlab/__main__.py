"""``python -m chemlab``: the ``chemlab`` command."""

import sys


def main() -> None:
    """Entry point of the ``chemlab`` command; an interruption while modules load ends it without a traceback."""
    try:
        from chemlab.cli import main as command
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
