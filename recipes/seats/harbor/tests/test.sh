#!/bin/sh
# The score of the episode, or 0 if it has no end.
python3 - <<'PY'
import json
from pathlib import Path

lines = map(json.loads, Path("/results/ledger.jsonl").read_text().splitlines())
scores = [line["score"] for line in lines if line["event"] == "ended"]
Path("/logs/verifier/reward.txt").write_text(str(scores[0] if scores else 0.0))
PY
