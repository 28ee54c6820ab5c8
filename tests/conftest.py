"""Settings every test shares. Being here, this file also lets every test import ``helpers``."""

from __future__ import annotations

import os
import tempfile

from hypothesis import HealthCheck, settings

# Derandomized: a failure on one machine is a failure on every machine. HYPOTHESIS_PROFILE=explore looks further.
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("repeatable", derandomize=True, **_COMMON)
settings.register_profile("explore", print_blob=True, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# Seals of what tests train are made with a key of their own; processes that they start have it, too.
_state = tempfile.TemporaryDirectory()
os.environ.setdefault("CHEMLAB_STATE_DIR", _state.name)
