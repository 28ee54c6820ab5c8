"""Episodes as data: written turn by turn while they are played, read back, and proved by playing them again.

| Line of the file | Holds |
|---|---|
| first | format, versions, the whole scenario, seed, options, random streams, goals, policies |
| one a turn | who played what on which observation (a hash), rewards, costs, readings; `hidden`: what no agent sees |
| last | the result: score, goals, amounts and purities, rewards, costs, safety events |

A record is UTF-8 text, one JSON object a line, every number as exact as the simulator had it. The same episode gives
the same bytes. While an episode is being played its record is `FILE.part`; each line is there as soon as its turn is
over, so after a crash everything up to the last whole line can be read. A whole record is `FILE`.

### Keys of a turn
`turn` counts from 0; `tick` is the laboratory's before the turn; `play` maps each agent that acted to
`[hash of observation and mask, action]`; `rewards` and `cost` have the agents' numbers that are not 0; `lost` names
agents whose action was not possible; `events` the safety events; `scores` the experiments that ended; `reading` what
the manager has measured (`slot`, `instrument`, `values` as the manager sees them, from 0 to 1).
`hidden.vessels` has the vessels that changed, by position: `[temperature in K, mol of each of the header's materials]`,
or null where no vessel stands any more; `hidden.stock` and `hidden.waste` likewise [mol of each material] when they
changed; `hidden.state` is a hash of everything the rest of the episode depends on, with every field of each experiment
that is running. The header's `hidden.world` has the number of the world and what follows from it (its values).

### What a record proves
:func:`verify_record` plays the recorded actions on the simulator and compares every line with what a recorder would
write there, byte by byte. So a record that is found right says what these actions lead to, and nothing else. Who chose
them, knowing what, no record can prove: `policies` is a claim, and so are `environment`, `models` and, where `seed` is
null, the random streams and which of all worlds of its split it is.
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
