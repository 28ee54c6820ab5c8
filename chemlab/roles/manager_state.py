"""The arrays of N laboratories beyond their vessels and benches, and the scenario's numbers that their turns need."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from ..kernels.arrays import BoolArray, Field, FloatArray, IntArray, StreamArray

__all__ = [
    "ARRIVES",
    "CLOSED",
    "COST_ITEMS",
    "ILLEGAL",
    "INSTRUMENTS",
    "LEAST_AMOUNT",
    "LEAST_PURITY",
    "LIMIT",
    "MANAGER",
    "PRICE",
    "RUNNING",
    "SAFETY",
    "STATUS_WORDS",
    "STOCK",
    "TIME",
    "WASTE",
    "WITHIN",
    "ManagerState",
    "Rules",
]

COST_ITEMS: tuple[str, ...] = ("instruments", "stock", "waste", "time", "illegal_actions", "safety")
"""What the manager's score is charged for, in units of the score; calibrating is under instruments, a fitter's repairs
under time."""
INSTRUMENTS, STOCK, WASTE, TIME, ILLEGAL, SAFETY = range(len(COST_ITEMS))

RUNNING, CLOSED, LIMIT = range(3)
"""Status of an episode: running; no order can be met any more; a limit on manager actions or ticks has been reached.

Environments say ``terminated`` of both ends. The limits are the scenario's, the manager observes what is left of them,
and nothing follows them: a learner that adds the value of a state after a limit counts rewards that nobody can earn.
"""
STATUS_WORDS = ("running", "submitted", "limit reached")
"""The same for people, records and pictures."""

MANAGER = -1
"""Cursor value while the manager has the turn."""

ARRIVES, WITHIN, PRICE, LEAST_AMOUNT, LEAST_PURITY = range(5)
"""Terms of an order, in the order of :data:`chemlab.config.draws.ORDER_QUANTITIES`."""


class ManagerState(NamedTuple):
    """A laboratory's arrays but for vessels and experiments. N laboratories, S slots, B benches, G agents, O orders,
    K orders with terms (all or none), F benches (all or none) that report 3 numbers, I instruments, R numbers of all
    readings, M materials, E kinds of safety event, items of the costs. Where benches wear there are W = B of them, else
    none; where instruments drift, D = I with Z = R numbers, else none."""

    reserved: Annotated[IntArray, Field("N S", first=-1)]
    """[N, S] bench a slot is reserved for, -1 if none"""
    last_bench: Annotated[IntArray, Field("N S")]
    """[N, S] 0 for none, else 1 + index of the bench kind the vessel last was at"""
    last_position: Annotated[IntArray, Field("N S")]
    """[N, S] position it had there"""
    reading: Annotated[FloatArray, Field("N S R")]
    """[N, S, R] last reading of every instrument"""
    age: Annotated[IntArray, Field("N S I", first=-1)]
    """[N, S, I] ticks since that reading, -1 for never"""
    origin: Annotated[IntArray, Field("N B")]
    """[N, B] slot the running experiment's main vessel came from"""
    goal: Annotated[IntArray, Field("N O", first=None)]
    """[N, O] what each order asks for, an index into the scenario's goals"""
    filled: Annotated[BoolArray, Field("N O")]
    """[N, O] whether a vessel has been submitted for the order"""
    terms: Annotated[FloatArray, Field("N K 5", first=None)]
    """[N, K, 5] ARRIVES (tick), WITHIN (ticks from then), PRICE, LEAST_AMOUNT (mol) and LEAST_PURITY of each order"""
    paid: Annotated[FloatArray, Field("N K")]
    """[N, K] what the submission for it has earned, of its price"""
    report: Annotated[FloatArray, Field("N F 3")]
    """[N, F, 3] what each bench has last reported, each from 0 to 1 (see :data:`chemlab.roles.grades.REPORT`)"""
    actions: Annotated[IntArray, Field("N")]
    """[N] manager actions so far"""
    ticks: Annotated[IntArray, Field("N")]
    """[N] ticks so far"""
    cursor: Annotated[IntArray, Field("N", first=MANAGER)]
    """[N] bench whose turn it is, or MANAGER"""
    finished: Annotated[BoolArray, Field("N")]
    """[N] whether an experiment has ended in this tick"""
    status: Annotated[IntArray, Field("N", first=RUNNING)]
    """[N] RUNNING, CLOSED or LIMIT"""
    charges: Annotated[FloatArray, Field("N items")]
    """[N, items] costs so far (stock and waste, which follow from amounts, at the end: see itemize)"""
    submitted: Annotated[FloatArray, Field("N O 2")]
    """[N, O, 2] mol of the goal and its purity in the vessel submitted for each order"""
    delivered: Annotated[FloatArray, Field("N M")]
    """[N, M] mol that have left with submitted vessels while the episode goes on"""
    stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] random stream of goals and instruments"""
    illegal: Annotated[BoolArray, Field("N")]
    """[N] whether the manager's last action was masked"""
    begun: Annotated[IntArray, Field("N", first=-1)]
    """[N] bench that the manager's last action started, -1 if none"""
    recalled: Annotated[IntArray, Field("N", first=-1)]
    """[N] bench that it recalled, -1 if none"""
    measured: Annotated[IntArray, Field("N", first=-1)]
    """[N] slot that it had measured, -1 if none"""
    # An agent's numbers stand together: a bench's turn touches its own row alone. Agents' rows are not reset with a
    # laboratory's, but opened at every turn.
    rewards: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] what the last turn (or round) earned each agent"""
    cost: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] weighted safety events of the last turn or round"""
    scores: Annotated[FloatArray, Field("G N", first=None)]
    """[G, N] score of the experiment that it ended, NaN where none ended"""
    safety_totals: Annotated[FloatArray, Field("N E")]
    """[N, E] safety events since the episode began"""
    ready: Annotated[IntArray, Field("N W")]
    """[N, W] tick from which each bench can be used again after a repair"""
    broken: Annotated[BoolArray, Field("W N", first=None, kept=False)]
    """[W, N] which benches are broken, as their experiments have it"""
    bias: Annotated[FloatArray, Field("N Z")]
    """[N, Z] what each value of each instrument is off by besides the scenario's bias"""
    trend: Annotated[FloatArray, Field("N D")]
    """[N, D] what it goes off by in a tick"""
    since: Annotated[IntArray, Field("N D")]
    """[N, D] tick at which that was last worked out"""
    calibrated: Annotated[IntArray, Field("N D")]
    """[N, D] tick of the last calibration"""
    drift_stream: Annotated[StreamArray, Field("N D", first=None)]
    """[N, D] random stream of how it drifts: the world's"""
    busy: Annotated[BoolArray, Field("B N", first=None, kept=False)]
    """[B, N] and the two below: what the benches' experiments share with the manager's kernels"""
    bench_goal: Annotated[IntArray, Field("B N", first=None, kept=False)]
    bench_steps: Annotated[IntArray, Field("B N", first=None, kept=False)]


class Rules(NamedTuple):
    """The scenario's numbers that the manager's kernels need. A actions, B benches, G goals, M materials, I
    instruments."""

    table: Annotated[IntArray, Field("A 5")]
    """[A, 5] the manager's actions: see :class:`~chemlab.roles.manager_actions.ManagerActions`"""
    manager: Annotated[int, Field("")]
    """index of the manager among the agents"""
    agent: Annotated[IntArray, Field("B")]
    """[B] index of each bench's agent among the agents"""
    slots: Annotated[int, Field("")]
    first: Annotated[IntArray, Field("B")]
    """[B] first vessel position of each bench"""
    positions: Annotated[IntArray, Field("B")]
    """[B] number of vessels each bench works on"""
    most_positions: Annotated[int, Field("")]
    """the largest of them"""
    bench_of: Annotated[IntArray, Field("B")]
    """[B] index of the bench's kind"""
    kinds: Annotated[int, Field("")]
    """number of bench kinds"""
    limit: Annotated[IntArray, Field("B")]
    """[B] step limits"""
    parts: Annotated[IntArray, Field("G 3")]
    """[G, 3] see Goals.parts"""
    counts: Annotated[FloatArray, Field("G M")]
    """[G, M] see Goals.absolute_counts; 0 of what a specification's purity leaves out"""
    maximum: Annotated[FloatArray, Field("G")]
    """[G] mol, theoretical maximum of each goal"""
    share: Annotated[float, Field("")]
    """of a submission's worth in the manager's reward"""
    first_stock: Annotated[FloatArray, Field("M")]
    """[M] mol in the bottles when an episode begins"""
    stocked: Annotated[IntArray, Field("k")]
    """indices of materials that have a bottle"""
    stock_price: Annotated[FloatArray, Field("M")]
    """[M] score per mol"""
    reading_start: Annotated[IntArray, Field("I+1")]
    """[I + 1] where each reading begins"""
    seen: Annotated[IntArray, Field("I")]
    """[I] 1 where it stands in the observation"""
    price: Annotated[FloatArray, Field("I")]
    """[I] score for a measurement"""
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
    """[d] instruments that drift, and benches that wear [w]"""
    wearing: Annotated[IntArray, Field("w")]
    least_purity: Annotated[FloatArray, Field("G")]
    """[G] what a submission must be, to be worth anything"""
    least_amount: Annotated[FloatArray, Field("G")]
    """[G] mol, the same"""
    late: Annotated[float, Field("")]
    """share of its price that an order with terms pays for what is late"""
    short: Annotated[float, Field("")]
    """the same for what falls short of its terms"""
    most_terms: Annotated[FloatArray, Field("5")]
    """[5] the highest that any order's terms can be"""
    gauge: Annotated[float, Field("")]
    """step of the fill level's marks, as a share of the capacity; 0: none"""
    work: Annotated[FloatArray, Field("a b")]
    """scratch"""
