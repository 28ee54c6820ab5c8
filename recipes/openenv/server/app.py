"""A seat of chemlab as an OpenEnv server: ``uvicorn server.app:app`` in the folder of openenv.yaml.

The variables CHEMLAB_SCENARIO and CHEMLAB_SEAT choose scenario and seat. Run with openenv 0.10.0.
"""

from __future__ import annotations

import os

import uvicorn

from chemlab.agents.openenv_server import seat_app

app = seat_app(
    scenario=os.environ.get("CHEMLAB_SCENARIO", "wurtz_dodecane"),
    seat=os.environ.get("CHEMLAB_SEAT", "manager_0"),
    condition="tools only",
)


def main(host: str = "0.0.0.0", port: int = 8000) -> None:
    """Serve until interrupted."""
    uvicorn.run(app, host=host, port=port)


if __name__ == "__main__":
    main()
