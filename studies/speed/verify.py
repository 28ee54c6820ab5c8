"""False alarms of verification: record honest episodes of every scenario and verify them.

Run ``python studies/speed/verify.py --episodes 1000`` (``--json`` for machines). A third of the episodes is played by
the scripted policies, a third by random ones and a third by policies that also try invalid actions. It also reports the
size of records and the processor time of recording.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from helpers import Careless

from chemlab import raw_env
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.inherit import scenario_names
from chemlab.record import Recorder, read_record, verify_record

POLICIES = ("scripted", "random", "careless")


def policies(name: str, env: raw_env, seed: int) -> dict[str, Any]:
    """Return policies by name, including those with invalid actions."""
    labs = env.laboratories
    if name == "careless":
        return {agent: Careless(labs, i, seed) for i, agent in enumerate(labs.agents)}
    return dict(make_policies(name, labs, seed))


def main() -> int:
    """Play, verify and report; return 1 if an honest record was rejected."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--scenario", action="append", choices=scenario_names(), help="default: every one; repeatable")
    parser.add_argument("--json", action="store_true", help="print JSON")
    args = parser.parse_args()
    names = args.scenario or scenario_names()
    envs = {name: raw_env(name) for name in names}
    found: Counter[str] = Counter()
    alarms, turns, ticks, size, lost = [], 0, 0, 0, 0
    seconds = {"play": 0.0, "record": 0.0, "verify": 0.0}
    with tempfile.TemporaryDirectory() as folder:
        for e in range(args.episodes):
            name, policy = names[e % len(names)], POLICIES[e // len(names) % len(POLICIES)]
            env, path = envs[name], Path(folder) / f"{e}.jsonl"
            marks = [time.process_time()]
            play_episode(env, policies(policy, env, e), e)
            marks.append(time.process_time())
            played = play_episode(env, policies(policy, env, e), e, recorder=Recorder(path, env.laboratories))
            marks.append(time.process_time())
            result = verify_record(path)
            marks.append(time.process_time())
            for key, start, stop in zip(seconds, marks, marks[1:], strict=False):
                seconds[key] += stop - start
            found[result.status] += 1
            if result.status != "ok" or result.score != played.score:
                alarms.append((name, policy, e, result.message))
            turns, ticks, size = turns + result.turns, ticks + played.ticks, size + path.stat().st_size
            lost += sum("lost" in turn for turn in read_record(path).turns)
            path.unlink()
    report = {
        "episodes": args.episodes,
        "turns": turns,
        "ticks": ticks,
        "lost_turns": lost,
        "status": dict(found),
        "alarms": alarms,
        "bytes_a_turn": size / turns,
        "recording_us_a_turn": 1e6 * (seconds["record"] - seconds["play"]) / turns,
        "seconds": seconds,
    }
    print(json.dumps(report) if args.json else "\n".join(f"{key}: {value}" for key, value in report.items()))
    return 1 if alarms else 0


if __name__ == "__main__":
    sys.exit(main())
