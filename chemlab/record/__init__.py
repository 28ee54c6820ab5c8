"""Records of episodes: written turn by turn, read back, and verified by replay.

| Line of the file | Content |
|---|---|
| first | format, versions, the whole scenario, seed, options, random streams, goals, policies |
| one per turn | agents, actions and hashes of observations, rewards, costs, readings; `hidden`: the unobserved state |
| last | the result: score, goals, amounts and purities, rewards, costs, safety events |

A record is UTF-8 text with one JSON object per line; numbers have full precision. Equal episodes give equal bytes. The
record of a running episode is `FILE.part`. Each line is written when its turn is over, so that after a crash all
complete lines can be read. The record of a finished episode is `FILE`.

### Keys of a turn
- `turn` counts from 0; `tick` is the laboratory's tick before the turn.
- `play` maps each acting agent to `[hash of observation and mask, action]`.
- `rewards` and `cost` have the agents' non-zero values.
- `lost` lists agents whose action was invalid; `events` has the safety events; `scores` the experiments that ended.
- `reading` is the manager's new reading: `slot`, `instrument`, and `values` in [0, 1] as observed.
- `hidden.vessels` has the changed vessels by position: `[temperature in K, mol of each of the header's materials]`, or
  null for a removed vessel.
- `hidden.stock` and `hidden.waste` are [mol of each material] if changed.
- `hidden.state` is a hash of all vessels, bottles and waste, and of the arrays of every role.

The header's `hidden.world` has the number of the world and its values.

### Scope of a verification
:func:`verify_record` replays the recorded actions on the simulator and compares every line
byte by byte. A verified record proves the consequences of its actions, and nothing else. It cannot prove who chose the
actions with which information: `policies` is a claim. So are `environment` and, if `seed` is null, the random
streams and the choice of the world within its split.
"""

from .format import FORMAT, LIMITS, Record, RecordError, read_record, recorded_scenario, scenario_hash, seen_hash
from .recorder import Play, Recorder
from .replay import Replay
from .verify import EXIT_CODES, Status, Verification, verify_record

__all__ = [
    "EXIT_CODES",
    "FORMAT",
    "LIMITS",
    "Play",
    "Record",
    "RecordError",
    "Recorder",
    "Replay",
    "Status",
    "Verification",
    "read_record",
    "recorded_scenario",
    "scenario_hash",
    "seen_hash",
    "verify_record",
]
