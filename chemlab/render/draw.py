"""Draw scenes as pictures: shelf, benches, costs and a legend. Uses Pillow; needs no display.

Parts that do not change within an episode (cards, legend, headings) are drawn once and copied. Lengths are in units:
a 16:9 picture has 960 x 540 units at any size. With other aspect ratios, the longer side has more units.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..lab.text import EVENT_WORDS, event_words
from .canvas import Box, Canvas, Image, ImageDraw, TextBox, text_width
from .scene import (
    BenchPicture,
    ChannelPicture,
    LayerPicture,
    MaterialPicture,
    Scene,
    SlotPicture,
    VesselPicture,
)

_UNITS = (960.0, 540.0)
_SMALLEST = (480, 270)
_SMALLEST_VESSEL = 120
_LARGEST = 8192
"""Maximum width and height in pixels; a picture of this size takes 200 MB."""

PAGE, CARD, EDGE, TRACK = "#f4f6f8", "#ffffff", "#d5dbe1", "#e4e8ec"
INK, SOFT, FAINT = "#1b2733", "#56636f", "#7a8793"
BLUE, ORANGE, GLASS = "#0072b2", "#d55e00", "#7d8b98"
AIR = "#fbfcfd"

_MARGIN, _GAP = 10.0, 6.0
_HEADER, _SIDEBAR = 48.0, 196.0
_LINE = 14.0
_SECTION = 16.0
_LEGEND_ROWS = 4
_MORE = 60.0
"""Width reserved in the legend's last row for the number of omitted materials."""
_READINGS = 46.0
_KEY = 66.0
_LEAST_BESIDE = 60.0
"""Width and height below which nothing is drawn beside a bench's vessel."""
_LOWEST_GLASS = 10.0
"""Minimum height of a vessel; lower ones are not drawn."""


class GlassBox(NamedTuple):
    """Interior of a vessel in a picture; its contents begin at ``box.bottom``."""

    owner: str
    """bench agent, or ``shelf``"""
    position: str
    box: Box
    pixels_per_l: float


class Painting(NamedTuple):
    """A picture with the positions of its texts and vessels."""

    image: Image.Image
    texts: list[TextBox]
    glasses: list[GlassBox]


class _Rect(NamedTuple):
    """A rectangle in units."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.bottom - self.top

    def grid(self, count: int, columns: int) -> list[_Rect]:
        """Divide a rectangle into a grid of ``count`` cells."""
        rows = math.ceil(count / columns)
        wide = (self.width - _GAP * (columns - 1)) / columns
        high = (self.height - _GAP * (rows - 1)) / rows
        cells = []
        for i in range(count):
            left, top = self.left + i % columns * (wide + _GAP), self.top + i // columns * (high + _GAP)
            cells.append(_Rect(left, top, left + wide, top + high))
        return cells


@dataclass(frozen=True)
class _Plan:
    """Layout of a picture."""

    header: _Rect
    sidebar: _Rect
    legend: _Rect
    shelf: _Rect | None
    benches: _Rect
    slots: tuple[_Rect, ...]
    cards: tuple[_Rect, ...]
    stock_lines: int


class _Still(NamedTuple):
    """Parts of a scene that are constant within an episode; with the size, the key of the cached background."""

    kind: str
    title: str
    scenario: str
    slots: int
    benches: tuple[tuple[str, int], ...]
    """(agent, positions)"""
    stock: tuple[str, ...]
    materials: tuple[MaterialPicture, ...]
    temperatures: tuple[float, float]


def draw(scene: Scene, width: int = 960, height: int = 540) -> npt.NDArray[np.uint8]:
    """Draw a scene and return it as an array [height, width, 3] of RGB values.

    Args:
        scene: scene to draw.
        width, height: size in pixels; at least 480 x 270, and at most 8192 each.

    Raises:
        ImportError: Pillow is not installed.
        ValueError: the size is out of bounds.
    """
    return np.array(paint(scene, width, height).image)


def paint(scene: Scene, width: int = 960, height: int = 540) -> Painting:
    """Draw a scene like :func:`draw`, and return the picture with the positions of texts and vessels."""
    _check_size(width, height, *_SMALLEST)
    still = _Still(
        scene.kind,
        scene.title,
        scene.scenario,
        len(scene.shelf),
        tuple((bench.agent, len(bench.positions)) for bench in scene.benches),
        tuple(bottle.material for bottle in scene.stock),
        scene.materials,
        scene.temperature_range_k,
    )
    image, texts, plan = _background(still, width, height)
    canvas = Canvas(image.copy(), _scale(width, height), texts)
    painter = _Painter(scene, canvas)
    painter.header(plan)
    painter.sidebar(plan)
    for slot, rect in zip(scene.shelf, plan.slots, strict=True):
        painter.slot(slot, rect)
    for bench, rect in zip(scene.benches, plan.cards, strict=True):
        painter.bench(bench, rect)
    return Painting(canvas.image, canvas.texts, painter.glasses)


def draw_vessel(scene: Scene, width: int = 240, height: int = 240) -> npt.NDArray[np.uint8]:
    """Draw a single vessel with a legend of its contents, as an array [height, width, 3] of RGB values.

    Args:
        scene: scene of :func:`~chemlab.render.scene.vessel_scene`.
        width, height: size in pixels; from 120 to 8192 each.

    Raises:
        ImportError: Pillow is not installed.
        ValueError: the size is out of bounds.
    """
    _check_size(width, height, _SMALLEST_VESSEL, _SMALLEST_VESSEL)
    canvas = Canvas(Image.new("RGB", (width, height), CARD), 1.0)
    vessel = scene.shelf[0].vessel
    if vessel is None:
        return np.array(canvas.image)
    held = [material for material in scene.materials if material.name in dict(vessel.contents)]
    rows = _legend_rows(held, width - 8.0, 1.0)
    y = height - 15.0 * len(rows) - 4.0
    _Painter(scene, canvas).vessel(vessel, "shelf", _Rect(4.0, 4.0, width - 4.0, y), False)
    _legend(canvas, rows, 4.0, y, width - 8.0)
    return np.array(canvas.image)


def _check_size(width: int, height: int, least_width: int, least_height: int) -> None:
    """Raise ValueError if a picture's size in pixels is out of bounds."""
    if width < least_width or height < least_height or max(width, height) > _LARGEST:
        raise ValueError(
            f"width x height must be at least {least_width} x {least_height}, and at most {_LARGEST} each, "
            f"given {width} x {height}"
        )


def _scale(width: int, height: int) -> float:
    return min(width / _UNITS[0], height / _UNITS[1])


# -- static background ------------------------------------------------------------------------------------------------


_TAG_WIDTH = 30.0


_LegendRow = list[tuple[MaterialPicture, str, float]]
"""Materials with the text beside the tag, empty if the tag is the full name, and with their width."""


def _legend_rows(materials: Sequence[MaterialPicture], room: float, scale: float) -> list[_LegendRow]:
    """Arrange materials in rows of at most ``room`` units; materials beyond the last row are omitted."""
    rows: list[_LegendRow] = [[]]
    used = 0.0
    for material in materials:
        name = "" if material.name == material.tag else material.name.replace("_", " ")
        beside = 5.0 + text_width(name, max(round(10.0 * scale), 5)) / scale if name else 0.0
        wide = min(_TAG_WIDTH + beside, 240.0) + 14.0
        if rows[-1] and used + wide > room - (_MORE if len(rows) == _LEGEND_ROWS else 0.0):
            if len(rows) == _LEGEND_ROWS:
                break
            rows.append([])
            used = 0.0
        rows[-1].append((material, name, wide))
        used += wide
    return rows


def _legend(canvas: Canvas, rows: list[_LegendRow], left: float, top: float, room: float) -> None:
    """Draw rows of the legend, each material at most ``room`` units wide."""
    for i, row in enumerate(rows):
        x, y = left, top + 15.0 * i
        for material, name, width in row:
            color, right, wide = material.color, x + _TAG_WIDTH, min(width, room)
            edge = "#" + bytes(int(value * 0.75) for value in _rgb(color)).hex()
            canvas.card(x, y + 1.5, right, y + 13.5, color, edge, radius=3.0)
            middle = x + _TAG_WIDTH / 2
            canvas.text(middle, y + 11.0, material.tag, 9.0, _ink_on(color), "center", room=_TAG_WIDTH - 2.0)
            canvas.text(right + 5.0, y + 11.0, name, 10.0, SOFT, room=wide - _TAG_WIDTH - 15.0)
            x += wide


def _columns(count: int, rect: _Rect, shapes: Sequence[int]) -> int:
    """Choose the number of grid columns that gives the benches' vessels the most room."""

    def vessel_size(columns: int) -> float:
        cell = rect.grid(count, columns)[0]
        return min((cell.width - 12.0) / max(shapes) / 55.0, (cell.height - 30.0) / 60.0, cell.width / 110.0)

    return max(range(1, count + 1), key=vessel_size)


def _plan(still: _Still, width: int, height: int) -> _Plan:
    scale = _scale(width, height)
    right, bottom = width / scale - _MARGIN, height / scale - _MARGIN
    rows = len(_legend_rows(still.materials, right - _MARGIN - 8.0, scale))
    legend = _Rect(_MARGIN, bottom - rows * 15.0, right, bottom)
    header = _Rect(0.0, 0.0, width / scale, _HEADER)
    top, low = _HEADER + 4.0, legend.top - 6.0
    sidebar = _Rect(right - _SIDEBAR, top + 4.0, right, low)
    benches = _Rect(_MARGIN, top + _SECTION, sidebar.left - 10.0, low)
    shelf: _Rect | None = None
    slots: list[_Rect] = []
    if still.slots:
        slot_rows = math.ceil(still.slots / 13)
        # Two rows of benches need a larger share of the height than one.
        share = 0.42 if len(still.benches) <= 4 else 0.37
        shelf = benches._replace(bottom=benches.top + (low - top) * share)
        slots = shelf.grid(still.slots, math.ceil(still.slots / slot_rows))
        benches = benches._replace(top=shelf.bottom + _SECTION + 4.0)
    cards = benches.grid(
        len(still.benches), _columns(len(still.benches), benches, [positions for _, positions in still.benches])
    )
    # The sidebar around the stock takes these lines: result and costs; waste and every kind of safety event; the key.
    before = 38.0 + 8 * _LINE if still.kind == "laboratory" else 0.0
    fitting = int((sidebar.height - before - (3 + len(EVENT_WORDS)) * _LINE - 24.0 - _KEY) / _LINE)
    stock_lines = len(still.stock) if len(still.stock) <= fitting else max(fitting - 1, 0)
    return _Plan(header, sidebar, legend, shelf, benches, tuple(slots), tuple(cards), stock_lines)


@functools.lru_cache(maxsize=16)
def _background(still: _Still, width: int, height: int) -> tuple[Image.Image, tuple[TextBox, ...], _Plan]:
    scale = _scale(width, height)
    plan = _plan(still, width, height)
    canvas = Canvas(Image.new("RGB", (width, height), PAGE), scale)
    canvas.rectangle(*plan.header, CARD)
    canvas.line([(0.0, _HEADER), (plan.header.right, _HEADER)], EDGE)
    canvas.text(_MARGIN, 21.0, still.title, 15.0, INK, room=plan.header.right - 2 * _MARGIN - 420.0)
    if plan.shelf:
        canvas.text(plan.shelf.left, plan.shelf.top - 4.0, "Shelf", 11.0, SOFT)
    canvas.text(plan.benches.left, plan.benches.top - 4.0, "Benches" if plan.shelf else "Bench", 11.0, SOFT)
    for rect in (*plan.slots, *plan.cards):
        canvas.card(*rect, CARD, EDGE)
    _key(canvas, plan.sidebar, still)
    y = plan.legend.top
    canvas.line([(plan.legend.left, y - 3.0), (plan.legend.right, y - 3.0)], EDGE)
    rows = _legend_rows(still.materials, plan.legend.width - 8.0, scale)
    left_out = len(still.materials) - sum(len(row) for row in rows)
    _legend(canvas, rows, plan.legend.left, y, plan.legend.width)
    if left_out:
        canvas.text(plan.legend.right, plan.legend.bottom - 4.0, f"+{left_out} more", 10.0, SOFT, "right")
    return canvas.image, tuple(canvas.texts), plan


def _key(canvas: Canvas, sidebar: _Rect, still: _Still) -> None:
    """Draw the key to the marks around a vessel."""
    left, y = sidebar.left, sidebar.bottom - _KEY + 14.0
    words = left + 20.0
    canvas.bar(left + 5.0, y - 8.0, left + 9.0, y + 1.0, 1.0, ORANGE, TRACK)
    canvas.text(words, y, f"temperature, {still.temperatures[0]:.0f} to {still.temperatures[1]:.0f} K", 10.0, SOFT)
    y += _LINE
    canvas.rectangle(left + 5.0, y - 8.0, left + 8.0, y - 4.0, _grey(0.1), TRACK)
    canvas.rectangle(left + 5.0, y - 4.0, left + 8.0, y + 1.0, _grey(0.6))
    canvas.text(words, y, "layer camera's picture", 10.0, SOFT)
    y += _LINE
    canvas.stack(left, y - 5.0, left + 14.0, y - 1.0, [(0.5, "#e69f00"), (0.3, "#882255"), (0.2, "#bfbfbf")])
    canvas.text(words, y, "solutes and solids, by mol", 10.0, SOFT)
    if not still.slots:
        return
    y += _LINE
    canvas.stack(left, y - 7.0, left + 14.0, y - 1.0, [(0.7, "#eedd88"), (0.3, "#e69f00")])
    canvas.text(words, y, "chromatogram (mole fractions)", 10.0, SOFT)


# -- colours ------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=512)
def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue


@functools.lru_cache(maxsize=512)
def _ink_on(color: str) -> str:
    """Return black or white, whichever has more contrast with a colour."""
    red, green, blue = _rgb(color)
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else "#ffffff"


@functools.lru_cache(maxsize=64)
def _glass(width: int, height: int, lid: bool) -> tuple[Image.Image, Image.Image]:
    """Return the masks of a vessel's interior and of its walls.

    The interior has ``width`` x ``height`` pixels; the walls extend 2 pixels around it. Both are drawn at four times
    the size, so that corners are smooth.
    """
    fine = 4
    radius = max(min(width // 4, 9), 2) * fine
    size = ((width + 4) * fine, (height + 4) * fine)
    inside = Image.new("L", size)
    bounds = (2 * fine, -radius, (width + 2) * fine - 1, (height + 2) * fine - 1)
    ImageDraw.Draw(inside).rounded_rectangle(bounds, radius, fill=255)
    walls = Image.new("L", size)
    pen = ImageDraw.Draw(walls)
    pen.rounded_rectangle((fine // 2, -radius, size[0] - fine // 2, size[1] - fine // 2), radius + fine, fill=255)
    pen.rounded_rectangle(bounds, radius, fill=0)
    if lid:
        pen.rectangle((fine // 2, 0, size[0] - fine // 2, 2 * fine - 1), fill=255)
    small = (width + 4, height + 4)
    box = (2, 2, width + 2, height + 2)
    return inside.resize(small, Image.Resampling.BOX).crop(box), walls.resize(small, Image.Resampling.BOX)


# -- dynamic parts ----------------------------------------------------------------------------------------------------


def _number(value: float) -> str:
    """Format a number with about three digits, without an exponent at the magnitudes of vessels and stock."""
    size = abs(value)
    places = 3 if 0.0005 <= size < 0.0995 else 2 if size < 9.995 else 1 if size < 99.95 else 0
    return f"{value:.{places}f}"


class _Painter:
    """Draws the dynamic parts of one scene."""

    def __init__(self, scene: Scene, canvas: Canvas) -> None:
        self.scene = scene
        self.canvas = canvas
        self.glasses: list[GlassBox] = []
        self.materials = {material.name: material for material in scene.materials}

    def header(self, plan: _Plan) -> None:
        """Draw the orders, the meters and the agent that has the turn."""
        scene, canvas, right = self.scene, self.canvas, plan.header.right - _MARGIN
        laboratory = scene.kind == "laboratory"
        meters = right - 390.0
        states = Counter(order.state(scene.ticks) for order in scene.orders)
        words = "Orders: " + (", ".join(f"{count} {state}" for state, count in states.items()) or "none yet")
        if len(scene.orders) == 1 and scene.orders[0].due is None:
            order = scene.orders[0]
            filled = f" (filled: {_number(order.submitted_mol)} mol, {100.0 * order.purity:.0f} % pure)"
            words = f"{'Order' if laboratory else 'Goal'}: {order.goal}{filled if order.filled else ''}"
        canvas.text(_MARGIN, 39.0, words, 12.0, BLUE, room=meters - _MARGIN - 12.0)
        counts = [("ticks" if laboratory else "steps", scene.ticks, scene.tick_limit)]
        if laboratory:
            counts.insert(0, ("manager actions", scene.manager_actions, scene.manager_action_limit))
        for i, (name, count, limit) in enumerate(counts):
            left = meters + (2 - len(counts) + i) * 132.0
            taken = canvas.text(left + 120.0, 20.0, f"{count} / {limit}", 10.0, INK, "right", room=120.0)
            canvas.text(left, 20.0, name, 10.0, SOFT, room=120.0 - taken - 6.0)
            canvas.bar(left, 27.0, left + 120.0, 32.0, count / max(limit, 1), BLUE, TRACK)
        running = scene.status == "running"
        color = BLUE if running else SOFT
        canvas.card(right - 118.0, 11.0, right, 37.0, CARD, color, radius=6.0)
        label = f"turn: {scene.turn}" if running else scene.status
        canvas.text(right - 59.0, 28.0, label, 11.0, color, "center", room=108.0)

    def sidebar(self, plan: _Plan) -> None:
        """Draw the result and costs, stock, waste and safety events."""
        scene, canvas = self.scene, self.canvas
        left, right, y = plan.sidebar.left, plan.sidebar.right, plan.sidebar.top
        if scene.kind == "laboratory":
            result = "?" if math.isnan(scene.result) else f"{scene.result:+.4f}"
            canvas.text(left, y + 24.0, result, 20.0, INK, room=110.0)
            canvas.text(right, y + 13.0, "score if it", 10.0, SOFT, "right")
            canvas.text(right, y + 25.0, "ended now", 10.0, SOFT, "right")
            y = self._section(left, right, y + 38.0, "Costs", f"{sum(cost for _, cost in scene.costs):.4f}")
            for item, cost in scene.costs:
                color = INK if cost > 0.0 else FAINT
                limit = f" (of {scene.budget:g})" if item == "instruments" else ""
                canvas.text(left, y, item + limit, 10.0, SOFT)
                canvas.text(right, y, f"{cost:.4f}", 10.0, color, "right")
                y += _LINE
            y -= 4.0
        y = self._section(left, right, y, "Stock", "mol")
        for bottle in scene.stock[: plan.stock_lines]:
            canvas.text(left, y, bottle.material.replace("_", " "), 10.0, SOFT, room=92.0)
            canvas.bar(left + 98.0, y - 7.0, right - 38.0, y - 1.0, bottle.mol / bottle.full_mol, BLUE, TRACK)
            canvas.text(right, y, _number(bottle.mol), 10.0, INK, "right")
            y += _LINE
        if plan.stock_lines < len(scene.stock):
            canvas.text(left, y, f"+{len(scene.stock) - plan.stock_lines} more", 10.0, SOFT)
            y += _LINE
        y = self._section(left, right, y - 4.0, "Waste", f"{scene.waste_l:.3f} L")
        y = self._section(left, right, y - 7.0, "Safety events", "" if scene.safety else "none")
        for kind, value in scene.safety:
            word, amount = event_words(kind, value)
            canvas.text(left, y, word, 10.0, ORANGE)
            canvas.text(right, y, amount, 10.0, ORANGE, "right")
            y += _LINE
        if len(scene.orders) > 1 or any(order.due is not None for order in scene.orders):
            self._orders(left, right, y, plan.sidebar.bottom - _KEY)

    def _orders(self, left: float, right: float, y: float, bottom: float) -> None:
        """List the orders that can still be met, the most urgent first, as many as fit."""
        scene = self.scene
        states = ("open", "overdue", "to come")
        waiting = [order for order in scene.orders if order.state(scene.ticks) in states]
        waiting.sort(key=lambda order: (states.index(order.state(scene.ticks)), order.due or 0, order.arrives))
        room = int((bottom - y - 8.0) / _LINE) - 1
        if room < 1 or not waiting:
            return
        y = self._section(left, right, y - 4.0, "Orders", "price")
        shown = waiting if len(waiting) <= room else waiting[: room - 1]
        for order in shown:
            state = order.state(scene.ticks)
            when = f"from tick {order.arrives}" if state == "to come" else "overdue" if state == "overdue" else ""
            if state == "open" and order.due is not None:
                when = f"by tick {order.due}"
            color = ORANGE if state == "overdue" else INK if state == "open" else FAINT
            taken = self.canvas.text(right, y, _number(order.price), 10.0, color, "right")
            self.canvas.text(left, y, f"{order.goal} {when}".strip(), 10.0, color, room=right - left - taken - 8.0)
            y += _LINE
        if len(shown) < len(waiting):
            self.canvas.text(left, y, f"+{len(waiting) - len(shown)} more", 10.0, SOFT)

    def _section(self, left: float, right: float, y: float, title: str, value: str) -> float:
        """Draw a heading under a rule and return the baseline of the next line."""
        self.canvas.line([(left, y), (right, y)], EDGE)
        self.canvas.text(left, y + 13.0, title, 11.0, INK)
        self.canvas.text(right, y + 13.0, value, 10.0, SOFT, "right")
        return y + 13.0 + _LINE

    def slot(self, slot: SlotPicture, rect: _Rect) -> None:
        """Draw the card of a shelf slot."""
        canvas, vessel = self.canvas, slot.vessel
        middle = (rect.left + rect.right) / 2
        canvas.text(rect.left + 5.0, rect.top + 12.0, str(slot.slot), 10.0, FAINT)
        if vessel is None:
            if slot.reserved_for:
                y = (rect.top + rect.bottom) / 2
                canvas.text(middle, y - 2.0, "reserved for", 10.0, FAINT, "center", room=rect.width - 6.0)
                canvas.text(middle, y + 11.0, slot.reserved_for, 10.0, FAINT, "center", room=rect.width - 6.0)
            return
        if slot.origin:
            canvas.text(rect.right - 5.0, rect.top + 12.0, slot.origin, 10.0, SOFT, "right", room=rect.width - 22.0)
        # Space for readings is reserved even without readings, so that all vessels of the shelf have the same scale.
        bottom = rect.bottom - min(_READINGS, 0.26 * rect.height)
        self._readings(slot, _Rect(rect.left + 5.0, bottom, rect.right - 5.0, rect.bottom))
        self.vessel(vessel, "shelf", _Rect(rect.left + 4.0, rect.top + 15.0, rect.right - 4.0, bottom), False)

    def _readings(self, slot: SlotPicture, rect: _Rect) -> None:
        """Draw the readings of a slot from the bottom up, as many as fit."""
        canvas = self.canvas
        left, right, y = rect.left, rect.right, rect.bottom - 4.0
        for reading in sorted(slot.readings, key=lambda reading: reading.age):
            if y - (20.0 if reading.kind == "curve" else 9.0) < rect.top:
                continue
            if reading.labels:  # shares of materials
                parts = [
                    (value, self.materials[name].color if name in self.materials else FAINT)
                    for value, name in zip(reading.values, reading.labels, strict=True)
                ]
                canvas.stack(left, y - 6.0, right, y, parts)
                y -= 9.0
            elif reading.kind == "curve":
                self._curve(reading.values, _Rect(left, y - 20.0, right, y))
                y -= 23.0
            elif len(reading.values) == 1:
                value = reading.low + reading.values[0] * (reading.high - reading.low)
                text = f"{_number(value)} {reading.unit}"
                canvas.text((left + right) / 2, y - 1.0, text, 10.0, BLUE, "center", room=rect.width)
                y -= 12.0
            else:  # grey values from the bottom of the vessel upwards
                grey = [(1.0 / len(reading.values), _grey(value)) for value in reading.values]
                canvas.stack(left, y - 6.0, right, y, grey)
                canvas.rectangle(left, y - 6.0, right, y, None, EDGE)
                y -= 9.0

    def _curve(self, values: Sequence[float], rect: _Rect) -> None:
        """Draw a spectrum with absorptions from 0 to 1."""
        canvas, step = self.canvas, rect.width / (len(values) - 1)
        points = [(rect.left + i * step, rect.bottom - value * rect.height) for i, value in enumerate(values)]
        outline = [(x * canvas.scale, y * canvas.scale) for x, y in points]
        ends = [(rect.right * canvas.scale, rect.bottom * canvas.scale), (outline[0][0], rect.bottom * canvas.scale)]
        canvas.pen.polygon([*outline, *ends], fill="#d6e8f4")
        canvas.line(points, BLUE)
        canvas.line([(rect.left, rect.bottom), (rect.right, rect.bottom)], GLASS)

    def vessel(self, vessel: VesselPicture, owner: str, rect: _Rect, piston: bool, label: str = "") -> None:
        """Draw a vessel with its layers, camera picture, thermometer and a line of figures."""
        canvas = self.canvas
        middle = (rect.left + rect.right) / 2
        kelvin = "" if vessel.temperature_k is None else f"{vessel.temperature_k:.0f} K"
        lines = [f"{_number(vessel.volume_l)}/{_number(vessel.capacity_l)} L", kelvin]
        if text_width(lines[0], canvas.px(10.0)) > rect.width * canvas.scale:
            lines[0] = f"{_number(vessel.volume_l)} L"
        if rect.height < 90.0:
            lines = [f"{_number(vessel.volume_l)} L {lines[1]}"] if rect.width > 66.0 else lines[1:]
        if rect.height < 56.0:
            lines, label = [], ""
        if label:
            canvas.text(middle, rect.top + 9.0, label, 10.0, SOFT, "center", room=rect.width)
        top = rect.top + (14.0 if label else 2.0) + (4.0 if piston else 0.0)
        bottom = rect.bottom - 13.0 * len(lines) - 2.0
        for i, line in enumerate(lines):
            canvas.text(middle, bottom + 13.0 * (i + 1), line, 10.0, INK if i == 0 else SOFT, "center", room=rect.width)
        solutes = bottom - 5.0
        glass_bottom = solutes - 5.0
        if glass_bottom - top < _LOWEST_GLASS:
            return
        per_l = (glass_bottom - top) * canvas.scale / self.scene.largest_capacity_l
        wide = canvas.px(min(max(rect.width - 30.0, 12.0), max(54.0, 0.42 * (glass_bottom - top))))
        high = max(round(vessel.capacity_l * per_l), 4)
        left, low = canvas.px(middle) - wide // 2, canvas.px(glass_bottom)
        box = Box(left, low - high, left + wide, low)
        self.glasses.append(GlassBox(owner, vessel.position, box, per_l))
        self._contents(vessel, box, per_l, piston)
        self._solutes(vessel, box, canvas.px(solutes))
        if vessel.camera:
            self._camera(
                vessel.camera, Box(box.left - 2 - canvas.px(8.0), box.top, box.left - canvas.px(5.0), box.bottom)
            )
        self._thermometer(vessel, box.right + canvas.px(5.0), canvas.px(top), low)

    def _contents(self, vessel: VesselPicture, box: Box, per_l: float, piston: bool) -> None:
        wide, high = box.right - box.left, box.bottom - box.top
        picture = Image.new("RGB", (wide, high), AIR)
        pen = ImageDraw.Draw(picture)
        tags: list[tuple[int, int, str, str]] = []
        low, reached = high, 0.0
        solids = [layer for layer in vessel.layers if layer.phase == "solid"]
        liquids = [layer for layer in vessel.layers if layer.phase == "liquid"]
        for layer in solids if vessel.mixture else vessel.layers:
            reached += layer.volume_l
            top = max(high - round(reached * per_l), 0)
            if top < low:
                pen.rectangle((0, top, wide - 1, low - 1), fill=layer.color)
                tags.append((top, low, self._tag(layer), layer.color))
                low = top
        if vessel.mixture:
            reached += sum(layer.volume_l for layer in liquids)
            top = max(high - round(reached * per_l), 0)
            if top < low:
                column = _blend(vessel.mixture, liquids, low - top)
                picture.paste(column.resize((wide, low - top)), (0, top))
                present = "+".join(self._tag(layer) for layer in liquids if layer.volume_l * per_l >= 2.0)
                red, green, blue = column.getpixel((0, (low - top) // 2))  # type: ignore[misc]
                tags.append((top, low, present, f"#{red:02x}{green:02x}{blue:02x}"))
        inside, walls = _glass(wide, high, piston)
        image = self.canvas.image
        image.paste(picture, (box.left, box.top), inside)
        image.paste(GLASS, (box.left - 2, box.top - 2), walls)
        if piston:
            middle = (box.left + box.right) // 2
            self.canvas.pen.rectangle((middle - 1, box.top - 5, middle + 1, box.top - 2), fill=GLASS)
        scale, size = self.canvas.scale, 9.0
        for top, low, tag, color in tags:
            fits = text_width(tag, max(self.canvas.px(size), 5)) <= wide - 4
            if fits and low - top >= (size + 3.0) * scale:
                y = (box.top + (top + low) / 2) / scale + 3.2
                x = (box.left + box.right) / 2 / scale
                self.canvas.text(x, y, tag, size, _ink_on(color), "center")

    def _tag(self, layer: LayerPicture) -> str:
        return self.materials[layer.material].tag if layer.material in self.materials else ""

    def _solutes(self, vessel: VesselPicture, box: Box, y: int) -> None:
        """Draw a bar of the solutes and solids, by mol."""
        contents = [(self.materials[name], mol) for name, mol in vessel.contents if name in self.materials]
        solutes = [(mol, material.color) for material, mol in contents if material.role != "solvent"]
        total = sum(mol for mol, _ in solutes)
        if total > 1e-3:
            scale, height = self.canvas.scale, max(self.canvas.px(4.0), 2)
            parts = [(mol / total, color) for mol, color in solutes]
            self.canvas.stack(box.left / scale, y / scale, box.right / scale, (y + height) / scale, parts)

    def _camera(self, grey: Sequence[float], box: Box) -> None:
        """Draw the camera picture that the bench's agent observes."""
        values = (255.0 - 225.0 * np.array(grey)[::-1]).astype(np.uint8)[:, None]
        picture = Image.fromarray(values).resize((max(box.right - box.left, 2), box.bottom - box.top))
        self.canvas.image.paste(picture, (box.left, box.top))
        self.canvas.pen.rectangle((box.left - 1, box.top - 1, box.left + picture.width, box.bottom), outline=TRACK)

    def _thermometer(self, vessel: VesselPicture, left: int, top: int, bottom: int) -> None:
        if vessel.temperature_k is None:
            return
        low, high = self.scene.temperature_range_k
        share = min(max((vessel.temperature_k - low) / (high - low), 0.0), 1.0)
        wide = max(self.canvas.px(4.0), 2)
        reached = bottom - round(share * (bottom - top))
        pen = self.canvas.pen
        pen.rectangle((left, top, left + wide - 1, bottom - 1), fill=TRACK)
        if reached < bottom:
            pen.rectangle((left, reached, left + wide - 1, bottom - 1), fill=ORANGE)

    def bench(self, bench: BenchPicture, rect: _Rect) -> None:
        """Draw the card of a bench."""
        canvas = self.canvas
        left, right = rect.left + 8.0, rect.right - 8.0
        if bench.turn:
            canvas.card(*rect, CARD, BLUE, width=max(canvas.px(2.0), 1))
        name = canvas.text(left, rect.top + 16.0, bench.agent, 12.0, INK if bench.busy else FAINT)
        tall = rect.height > 160.0
        words = ", ".join(" ".join(event_words(*event)) for event in bench.events)
        if bench.busy:
            count, room = f"step {bench.step}/{bench.step_limit}", right - left - name - 4.0
            steps = canvas.text(right, rect.top + 16.0, count, 10.0, SOFT, "right", room=room)
            room = right - left - name - steps - 16.0
            text, color = (words, ORANGE) if words and not tall else (bench.goal, BLUE)
            canvas.text(left + name + 8.0, rect.top + 16.0, text, 10.0, color, room=room)
            canvas.bar(left, rect.top + 22.0, right, rect.top + 25.0, bench.step / bench.step_limit, BLUE, TRACK)
        elif not bench.vessels:
            y = (rect.top + rect.bottom) / 2
            canvas.text((left + right) / 2, y + 4.0, "idle", 11.0, FAINT, "center")
            return
        # Space for events is reserved even without events, so that vessels keep their size; not in a low card.
        bottom = rect.bottom - (18.0 if tall else 5.0)
        if tall and words:
            canvas.text(left, rect.bottom - 6.0, words, 10.0, ORANGE, room=right - left)
        area = _Rect(left, rect.top + 29.0, right, bottom)
        spectrum = next((channel for channel in bench.seen if channel.name == "spectrum"), None)
        gauges = [channel for channel in bench.seen if len(channel.values) == 1]
        vessels = area
        if len(bench.positions) == 1 and min(area.width - 60.0, area.height) > _LEAST_BESIDE:
            vessels = _Rect(area.left, area.top, area.left + min(max(area.width * 0.38, 60.0), 140.0), area.bottom)
            beside = _Rect(vessels.right + 8.0, area.top, area.right, area.bottom)
            self._instruments(beside, spectrum.values if spectrum else (), gauges)
        cells = vessels.grid(len(bench.positions), len(bench.positions))
        for vessel in bench.vessels:
            cell = cells[bench.positions.index(vessel.position)]
            self.vessel(vessel, bench.agent, cell, bench.kind == "reaction", vessel.position)

    def _instruments(self, rect: _Rect, spectrum: Sequence[float], gauges: Sequence[ChannelPicture]) -> None:
        """Draw the spectrum and gauges beside a single vessel."""
        canvas, y = self.canvas, rect.bottom - 3.0
        for gauge in reversed(gauges):
            if rect.bottom - y > 0.3 * rect.height:
                break
            value = gauge.low + gauge.values[0] * (gauge.high - gauge.low)
            words = f"{100.0 * value:.3g} %" if gauge.unit == "fraction" else f"{value:.3g} {gauge.unit}"
            taken = canvas.text(rect.right, y, words, 10.0, INK, "right", room=rect.width)
            canvas.text(rect.left, y, gauge.name, 10.0, SOFT, room=rect.width - taken - 4.0)
            y -= 13.0
        if any(spectrum):
            plot = _Rect(rect.left, rect.top + 14.0, rect.right, y - 14.0)
            canvas.text(rect.left, rect.top + 9.0, "absorption", 10.0, SOFT, room=rect.width)
            if plot.height > 14.0:
                canvas.rectangle(*plot, "#fafbfc")
                self._curve(spectrum, plot)
                canvas.text(plot.left, plot.bottom + 10.0, "200", 9.0, FAINT)
                canvas.text(plot.right, plot.bottom + 10.0, "800 nm", 9.0, FAINT, "right")


def _grey(value: float) -> str:
    level = round(255.0 - 225.0 * value)
    return f"#{level:02x}{level:02x}{level:02x}"


def _blend(mixture: Sequence[Sequence[float]], liquids: Sequence[LayerPicture], height: int) -> Image.Image:
    """Return a column of ``height`` pixels, top first, with the mean colour of the liquids at each height."""
    colors = np.array([_rgb(layer.color) for layer in liquids], dtype=np.float64)
    slices = np.array(mixture) @ colors
    at = (np.arange(height)[::-1] + 0.5) / height * len(slices) - 0.5
    rows = np.stack([np.interp(at, np.arange(len(slices)), slices[:, c]) for c in range(3)], axis=1)
    return Image.fromarray(np.rint(rows).astype(np.uint8)[:, None, :])
