"""Arrays of N laboratories besides vessels and benches, and the scenario's static parameters of turns."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ..kernels.arrays import BoolArray, Field, FloatArray, IntArray, StreamArray

COST_ITEMS: tuple[str, ...] = ("instruments", "stock", "waste", "time", "illegal_actions", "safety")
"""Cost items of the manager's score, in units of the score; calibrations are part of instruments, repairs of time."""
COST_WORDS: tuple[str, ...] = (*COST_ITEMS[:4], "invalid actions", COST_ITEMS[5])
"""The items as people read them."""
INSTRUMENTS, STOCK, WASTE, TIME, ILLEGAL, SAFETY = range(len(COST_ITEMS))

RUNNING, CLOSED, LIMIT = range(3)
"""Status of an episode: running; no order can be fulfilled any more; a limit on manager actions or ticks is reached.

Environments report ``terminated`` for both ends. The limits are part of the scenario, the manager observes the
remainder, and nothing follows them: bootstrapping after a limit would count rewards that cannot be earned.
"""
STATUS_WORDS = ("running", "submitted", "limit reached")
"""The same in words, for people, records and pictures."""

MANAGER = -1
"""Cursor value while the manager has the turn."""

ARRIVES, WITHIN, PRICE, LEAST_AMOUNT, LEAST_PURITY = range(5)
"""Terms of an order, in the order of :data:`chemlab.config.draws.ORDER_QUANTITIES`."""


class ManagerState(NamedTuple):
    """Arrays of laboratories except vessels and experiments.

    N laboratories, S slots, B benches, G agents, O orders, K orders with terms (all or none), C orders (all or none)
    with noisy feedback, F benches (all or none) that report 3 numbers, T numbers revealed to the manager, I
    instruments, R numbers of all readings, M materials, E kinds of safety events, items of the costs.

    With degrading benches W = B, else 0; with drifting instruments D = I and Z = R, else 0.
    """

    reserved: Annotated[IntArray, Field("N S", first=-1)]
    """[N, S] index of the bench for which a slot is reserved, or -1"""
    last_bench: Annotated[IntArray, Field("N S")]
    """[N, S] 0 for none, else 1 + index of the kind of the vessel's last bench"""
    last_position: Annotated[IntArray, Field("N S")]
    """[N, S] its position there"""
    reading: Annotated[FloatArray, Field("N S R")]
    """[N, S, R] last reading of every instrument"""
    age: Annotated[IntArray, Field("N S I", first=-1)]
    """[N, S, I] ticks since that reading, -1 for never"""
    origin: Annotated[IntArray, Field("N B")]
    """[N, B] slot the running experiment's main vessel came from"""
    goal: Annotated[IntArray, Field("N O", first=None)]
    """[N, O] goal of each order, an index into the scenario's goals"""
    filled: Annotated[BoolArray, Field("N O")]
    """[N, O] whether a vessel has been submitted for the order"""
    terms: Annotated[FloatArray, Field("N K 5", first=None)]
    """[N, K, 5] ARRIVES (tick), WITHIN (ticks from then), PRICE, LEAST_AMOUNT (mol) and LEAST_PURITY of each order"""
    paid: Annotated[FloatArray, Field("N K")]
    """[N, K] payment received, as a share of the price"""
    feedback: Annotated[FloatArray, Field("N C 3")]
    """[N, C, 3] noisy feedback on each order's submission: mol, purity, and the reward given for it at once"""
    report: Annotated[FloatArray, Field("N F 3")]
    """[N, F, 3] last self-reported outcome of each bench from 0 to 1 (see :data:`chemlab.roles.grades.REPORT`)"""
    told: Annotated[FloatArray, Field("N T", first=None)]
    """[N, T] hidden parameters revealed to the manager, scaled to [0, 1]"""
    actions: Annotated[IntArray, Field("N")]
    """[N] manager actions so far"""
    ticks: Annotated[IntArray, Field("N")]
    """[N] ticks so far"""
    cursor: Annotated[IntArray, Field("N", first=MANAGER)]
    """[N] bench that has the turn, or MANAGER"""
    finished: Annotated[BoolArray, Field("N")]
    """[N] whether an experiment has ended in this tick"""
    status: Annotated[IntArray, Field("N", first=RUNNING)]
    """[N] RUNNING, CLOSED or LIMIT"""
    charges: Annotated[FloatArray, Field("N items")]
    """[N, items] costs so far (stock and waste, which follow from amounts, at the end: see itemize)"""
    submitted: Annotated[FloatArray, Field("N O 2")]
    """[N, O, 2] mol of the goal and its purity in the vessel submitted for each order"""
    delivered: Annotated[FloatArray, Field("N M")]
    """[N, M] mol removed with submitted vessels during the episode"""
    stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] random stream of goals and instruments"""
    illegal: Annotated[BoolArray, Field("N")]
    """[N] whether the manager's last action was invalid"""
    begun: Annotated[IntArray, Field("N", first=-1)]
    """[N] bench started by the manager's last action, or -1"""
    recalled: Annotated[IntArray, Field("N", first=-1)]
    """[N] bench recalled by it, or -1"""
    measured: Annotated[IntArray, Field("N", first=-1)]
    """[N] slot to be measured by it, or -1"""
    # An agent's numbers are adjacent, so that a bench's turn touches only its own row. Agents' rows are not reset with
    # a laboratory's, but cleared at every turn.
    rewards: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] rewards of the last turn (or round)"""
    cost: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] weighted safety events of the last turn or round"""
    scores: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] scores of experiments that ended, else NaN"""
    safety_totals: Annotated[FloatArray, Field("N E")]
    """[N, E] safety events since the episode began"""
    ready: Annotated[IntArray, Field("N W")]
    """[N, W] tick from which each bench is usable again after a repair"""
    broken: Annotated[BoolArray, Field("W N", first=None, kept=False)]
    """[W, N] whether benches are broken, shared with their experiments"""
    bias: Annotated[FloatArray, Field("N Z")]
    """[N, Z] bias of each value of each instrument in addition to the scenario's"""
    trend: Annotated[FloatArray, Field("N D")]
    """[N, D] its change per tick"""
    since: Annotated[IntArray, Field("N D")]
    """[N, D] tick at which the bias was last updated"""
    calibrated: Annotated[IntArray, Field("N D")]
    """[N, D] tick of the last calibration"""
    drift_stream: Annotated[StreamArray, Field("N D", first=None)]
    """[N, D] random stream of the drift, derived from the world"""
    busy: Annotated[BoolArray, Field("B N", first=None, kept=False)]
    """[B, N] and the two below: arrays that the benches' experiments share with the manager's kernels"""
    bench_goal: Annotated[IntArray, Field("B N", first=None, kept=False)]
    bench_steps: Annotated[IntArray, Field("B N", first=None, kept=False)]


class Rules(NamedTuple):
    """Static parameters of the manager's kernels. A actions, B benches, G goals, M materials, I instruments."""

    table: Annotated[IntArray, Field("A 5")]
    """[A, 5] the manager's actions: see :class:`~chemlab.roles.manager_actions.ManagerActions`"""
    manager: Annotated[int, Field("")]
    """index of the manager among the agents"""
    agent: Annotated[IntArray, Field("B")]
    """[B] index of each bench's agent among the agents"""
    slots: Annotated[int, Field("")]
    first: Annotated[IntArray, Field("B")]
    """[B] index of each bench's first vessel position"""
    positions: Annotated[IntArray, Field("B")]
    """[B] number of vessel positions of each bench"""
    most_positions: Annotated[int, Field("")]
    """maximum of these"""
    bench_of: Annotated[IntArray, Field("B")]
    """[B] index of the bench's kind"""
    kinds: Annotated[int, Field("")]
    """number of bench kinds"""
    limit: Annotated[IntArray, Field("B")]
    """[B] step limit of each bench"""
    parts: Annotated[IntArray, Field("G 3")]
    """[G, 3] see Goals.parts"""
    counts: Annotated[FloatArray, Field("G M")]
    """[G, M] see Goals.absolute_counts; 0 for materials that a specification's purity excludes"""
    maximum: Annotated[FloatArray, Field("G")]
    """[G] mol, theoretical maximum of each goal"""
    share: Annotated[float, Field("")]
    """weight of a submission's score in the manager's reward"""
    first_stock: Annotated[FloatArray, Field("M")]
    """[M] initial mol in the bottles"""
    stocked: Annotated[IntArray, Field("k")]
    """[k] indices of materials with a bottle"""
    stock_price: Annotated[FloatArray, Field("M")]
    """[M] price per mol in units of the score"""
    reading_start: Annotated[IntArray, Field("I+1")]
    """[I + 1] offset of each reading"""
    seen: Annotated[IntArray, Field("I")]
    """[I] 1 if the reading is part of the observation"""
    price: Annotated[FloatArray, Field("I")]
    """[I] price of a measurement in units of the score"""
    waste_per_l: Annotated[float, Field("")]
    tick_price: Annotated[float, Field("")]
    illegal_price: Annotated[float, Field("")]
    event_price: Annotated[float, Field("")]
    budget: Annotated[float, Field("")]
    action_limit: Annotated[int, Field("")]
    tick_limit: Annotated[int, Field("")]
    largest_capacity: Annotated[float, Field("")]
    """L"""
    drift_first: Annotated[FloatArray, Field("D")]
    """[D] how instruments drift, this and the four below: see :class:`chemlab.config.scenario.DriftSpec`"""
    drift_walk: Annotated[FloatArray, Field("D")]
    drift_trend: Annotated[FloatArray, Field("D")]
    calibration_price: Annotated[FloatArray, Field("D")]
    calibration_error: Annotated[FloatArray, Field("D")]
    repair_price: Annotated[FloatArray, Field("W")]
    """[W] score for a repair"""
    repair_ticks: Annotated[IntArray, Field("W")]
    """[W] ticks that it takes"""
    drifting: Annotated[IntArray, Field("d")]
    """[d] indices of drifting instruments; [w] of degrading benches"""
    wearing: Annotated[IntArray, Field("w")]
    least_purity: Annotated[FloatArray, Field("G")]
    """[G] minimum purity of a submission"""
    least_amount: Annotated[FloatArray, Field("G")]
    """[G] minimum mol of a submission"""
    late: Annotated[float, Field("")]
    """share of the price that an order with terms pays for a late submission"""
    short: Annotated[float, Field("")]
    """share of the price for a submission that fails the terms"""
    most_terms: Annotated[FloatArray, Field("5")]
    """[5] upper bounds of the terms of any order"""
    feedback: Annotated[float, Field("")]
    """standard deviation of the feedback on a submission; below 0: no feedback before the end"""
    hides: Annotated[int, Field("")]
    """1 if parameters are hidden: a vessel is submitted only after a bench, and recalled only after a tick"""
    least_fill: Annotated[float, Field("")]
    """minimum fill level, as observed, of a vessel that may be submitted"""
    gauge: Annotated[float, Field("")]
    """resolution of fill levels and capacities as a share, and of stock as a share of the first; 0: exact"""
    work: Annotated[FloatArray, Field("a b")]
    """scratch"""
