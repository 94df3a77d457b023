"""Pictures of the car on its road, for `render_mode` "rgb_array" and "human" (pygame).

A frame shows one car: the road that rolls under the tyre, wheel, spring, damper, body, the forces,
and a strip chart of both envelope amplitudes over those of the uncontrolled motion. It is drawn to
scale: a bar gives the length of the displacements, and where the road would be too low to be seen
beside them it is drawn higher, by the factor that the frame states. The model's tyre is linear and
never leaves the road, so the drawn one stretches.

`Painter` needs no display; `Window` opens one.
"""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.physics.state import State, squared_amplitudes
from qcar_env.scenarios import Scenario
from qcar_env.validation import whole

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before pygame greets on stdout
import pygame
import pygame.gfxdraw

Frame = NDArray[np.uint8]
Point = tuple[float, float]
Colour = tuple[int, int, int]

SIZE = (640, 480)  # [px] of a frame
LEAST = (240, 180)  # [px] smallest frame that can still be read
CHART_SECONDS = 4.0  # [s] of the strip chart
CHART_DECADES = (-3.0, 0.5)  # [-] range of its axis: powers of ten of a_i / A_i

# Lengths in a frame of 640 x 480 [px].
_WHEEL = 46.0  # radius of the tyre
_GAP = 84.0  # from the hub to the underside of the body, at rest
_BODY = (168.0, 46.0)
_TYRE_TRAVEL = 0.75 * _WHEEL  # of the uncontrolled wheel
_BODY_TRAVEL = 54.0  # of the uncontrolled body
_HUMP_SEEN = 13.0  # least height of a drawn hump
_HUMP_LENGTH = 150.0
_ARROW = 46.0  # length of the arrow of the largest force

_PAPER = (255, 255, 255)
_INK = (38, 42, 48)
_QUIET = (118, 124, 132)
_FAINT = (222, 225, 229)
_ROAD = (88, 93, 100)
_TYRE = (52, 56, 62)
_RIM = (201, 205, 210)
_STEEL = (128, 135, 144)
_EXTERNAL = (176, 122, 20)  # the external force


@dataclass(frozen=True, kw_only=True)
class Picture:
    """What a frame shows: one car at one instant.

    Parameters
    ----------
    name : str
        Name of what controls the car.
    colour : str
        Its colour, ``#rrggbb``.
    nominal : Scenario
        Gives the uncontrolled amplitudes that the chart refers to.
    episode : Scenario
        The car, road and force of this episode.
    time : float
        Time on the road [s].
    elapsed : float
        Time since the start of the episode [s].
    state : State
        Plant, four floats in SI units.
    action : tuple of float
        Force over its limit, one for each actuator [-].
    note : str
        What else the second line says.
    """

    name: str
    colour: str
    nominal: Scenario
    episode: Scenario
    time: float
    elapsed: float
    state: State
    action: tuple[float, ...]
    note: str = ""

    @property
    def levels(self) -> tuple[float, float]:
        """Envelope amplitudes of wheel and body over the uncontrolled ones [-]."""
        square1, square2 = squared_amplitudes(self.state, 1.0 / self.nominal.reference_frequency)
        a1, a2 = self.nominal.reference_amplitudes
        return math.sqrt(square1) / a1, math.sqrt(square2) / a2


@dataclass(frozen=True, kw_only=True)
class Scales:
    """How metres become pixels in a frame of 640 x 480."""

    displacement: float  # [px/m] of wheel and body
    road: float  # road height over its true one at that scale [-]
    bar: float  # length that the scale bar stands for [m]


def scales(nominal: Scenario) -> Scales:
    """Return scales at which the uncontrolled motion fills the frame and a hump can be seen.

    Parameters
    ----------
    nominal : Scenario
        Its reference amplitudes and hump height decide.
    """
    a1, a2 = nominal.reference_amplitudes
    displacement = min(_TYRE_TRAVEL / a1, _BODY_TRAVEL / a2)
    hump = displacement * abs(nominal.road.h)
    road = float(max(1, math.ceil(_HUMP_SEEN / hump))) if hump > 0.0 else 1.0
    longest = 60.0 / displacement
    decade = 10.0 ** math.floor(math.log10(longest))
    bar = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest)
    return Scales(displacement=displacement, road=road, bar=bar)


class Painter:
    """Draws frames of one car, and remembers the amplitudes of its strip chart.

    Parameters
    ----------
    size : tuple of int
        Width and height [px].

    Raises
    ------
    ValueError
        If the frame would be too small to be read.
    """

    def __init__(self, size: tuple[int, int] = SIZE) -> None:
        for name, value, least in zip(("width", "height"), size, LEAST, strict=True):
            whole(f"frame {name} [px]", value, least=least)
        pygame.font.init()
        self.size = size
        self._unit = min(size[0] / SIZE[0], size[1] / SIZE[1])
        # Red, green and blue in this order in memory: a frame is a plain copy of the surface.
        self._surface = pygame.Surface(size, depth=24, masks=(0xFF, 0xFF00, 0xFF0000, 0))
        self._fonts: dict[int, pygame.font.Font] = {}
        self._texts: dict[tuple[str, int, Colour], pygame.Surface] = {}
        self._history: list[tuple[float, float, float]] = []
        self._still: tuple[object, pygame.Surface] | None = None

    def draw(self, picture: Picture) -> Frame:
        """Return a frame, array (height, width, 3) of the caller's own."""
        self._remember(picture)
        key = (picture.name, picture.colour, picture.note, picture.nominal)
        if self._still is None or self._still[0] != key:
            self._still = (key, self._background(picture))
        self._surface.blit(self._still[1], (0, 0))
        self._scene(picture)
        self._readings(picture)
        self._chart(picture)
        width, height = self.size
        rows = np.frombuffer(self._surface.get_buffer().raw, dtype=np.uint8).reshape(height, -1)
        return rows[:, : 3 * width].reshape(height, width, 3).copy()

    # ---- places -----------------------------------------------------------------------------

    @property
    def _ground(self) -> float:
        """Height of the flat road in the frame [px]."""
        return 0.645 * self.size[1]

    @property
    def _axle(self) -> float:
        """Where the car stands in the frame [px]."""
        return 0.40 * self.size[0]

    @property
    def _chart_area(self) -> pygame.Rect:
        width, height = self.size
        left = round(62 * self._unit)
        top = round(0.735 * height)
        return pygame.Rect(
            left, top, width - left - round(14 * self._unit), height - top - round(28 * self._unit)
        )

    def _chart_height(self, level: float) -> float:
        low, high = CHART_DECADES
        exponent = math.log10(level) if level > 0.0 else low
        share = (min(max(exponent, low), high) - low) / (high - low)
        area = self._chart_area
        return area.bottom - share * area.height

    # ---- what does not move -----------------------------------------------------------------

    def _background(self, picture: Picture) -> pygame.Surface:
        surface = self._surface.copy()
        surface.fill(_PAPER)
        unit = self._unit
        colour = _colour(picture.colour)
        self._text(surface, picture.name, 30, colour, (16 * unit, 14 * unit))
        sizes = scales(picture.nominal)
        note = f"scenario {picture.nominal.name}"
        if sizes.road > 1.0:
            note += f", road drawn {sizes.road:g} x higher"
        if picture.note:
            note += f", {picture.note}"
        self._text(surface, note, 17, _QUIET, (16 * unit, 42 * unit))

        length = sizes.displacement * sizes.bar * unit
        x, bottom = 30 * unit, self._ground - 24 * unit
        _line(surface, _QUIET, (x, bottom), (x, bottom - length), 2 * unit)
        for y in (bottom, bottom - length):
            _line(surface, _QUIET, (x - 5 * unit, y), (x + 5 * unit, y), 2 * unit)
        self._text(
            surface, f"{sizes.bar:g} m", 17, _QUIET, (x + 9 * unit, bottom - length / 2), "left"
        )

        area = self._chart_area
        title = "amplitude over that without control"
        self._text(surface, title, 17, _QUIET, (16 * unit, area.top - 18 * unit))
        for exponent in range(math.ceil(CHART_DECADES[0]), math.floor(CHART_DECADES[1]) + 1):
            y = self._chart_height(10.0**exponent)
            if exponent:
                pygame.draw.line(surface, _FAINT, (area.left, y), (area.right, y))
            else:
                _dashes(surface, _INK, (area.left, y), (area.right, y), 6 * unit)
            label = f"{100.0 * 10.0**exponent:g} %"
            self._text(surface, label, 16, _QUIET, (area.left - 6 * unit, y), "right")
        pygame.draw.line(surface, _STEEL, area.bottomleft, area.bottomright)
        for second in range(int(CHART_SECONDS) + 1):
            x = area.right - second / CHART_SECONDS * area.width
            pygame.draw.line(surface, _STEEL, (x, area.bottom), (x, area.bottom + 4 * unit))
            label = f"-{second} s" if second else "now"
            align = "right" if not second else "middle"
            self._text(surface, label, 16, _QUIET, (x, area.bottom + 12 * unit), align)
        return surface

    # ---- what moves -------------------------------------------------------------------------

    def _scene(self, picture: Picture) -> None:
        surface, unit = self._surface, self._unit
        sizes = scales(picture.nominal)
        per_metre = sizes.displacement * unit
        ground, axle = self._ground, self._axle
        episode = picture.episode
        colour = _colour(picture.colour)

        hump = episode.road.duration if math.isfinite(episode.road.duration) else 0.1
        speed = _HUMP_LENGTH * unit / hump  # [px/s] of the road; a step's has no meaning
        columns = np.arange(0.0, self.size[0] + 4.0, 4.0)
        heights = episode.road.height(picture.time + (columns - axle) / speed)
        profile = ground - heights * per_metre * sizes.road
        contact = ground - float(episode.road.height(picture.time) * per_metre * sizes.road)
        floor = ground + 22 * unit
        outline = list(zip(columns.tolist(), profile.tolist(), strict=True))
        outline += [(self.size[0] + 4.0, floor), (0.0, floor)]
        pygame.draw.polygon(surface, _ROAD, outline)
        pygame.draw.aalines(surface, _ROAD, False, outline[:-2])
        pitch = 0.5 * _HUMP_LENGTH * unit
        first = -((picture.time * speed) % pitch)
        for left in np.arange(first, self.size[0], pitch).tolist():
            pygame.draw.line(
                surface, _FAINT, (left, floor - 5 * unit), (left + 0.4 * pitch, floor - 5 * unit), 2
            )

        hub = ground - _WHEEL * unit - picture.state.x1 * per_metre
        underside = ground - (_WHEEL + _GAP) * unit - picture.state.x2 * per_metre
        rest = ground - (_WHEEL + _GAP) * unit
        a1, a2 = (a * per_metre for a in picture.nominal.reference_amplitudes)
        half, height = 0.5 * _BODY[0] * unit, _BODY[1] * unit
        for sign in (-1.0, 1.0):  # how far body and wheel go without control
            for y, reach in (
                (rest - 0.5 * height + sign * a2, half),
                (ground - _WHEEL * unit + sign * a1, _WHEEL * unit),
            ):
                for side in (-1.0, 1.0):
                    start = axle + side * (reach + 8 * unit)
                    _dashes(surface, _STEEL, (start, y), (start + side * 26 * unit, y), 4 * unit)
        label = (axle + half + 42 * unit, rest - 0.5 * height + a2)
        self._text(surface, "without control", 15, _QUIET, label, "left")

        rolled = picture.time * speed / (_WHEEL * unit)
        self._wheel(axle, hub, contact, rolled)
        self._spring((axle - 20 * unit, hub - 8 * unit), underside)
        self._damper((axle + 20 * unit, hub - 8 * unit), underside)
        plate = pygame.Rect(0, 0, round(62 * unit), max(3, round(9 * unit)))
        plate.center = (round(axle), round(hub - 5 * unit))
        pygame.draw.rect(surface, _STEEL, plate, border_radius=max(1, round(3 * unit)))
        body = pygame.Rect(
            round(axle - half), round(underside - height), round(2 * half), round(height)
        )
        pygame.draw.rect(surface, colour, body, border_radius=max(1, round(10 * unit)))
        bright = 0.3 * colour[0] + 0.6 * colour[1] + 0.1 * colour[2] > 140.0
        self._text(surface, "body", 19, _INK if bright else _PAPER, body.center, "middle")

        if episode.actuator.actuation == "independent":
            on_wheel, on_body = picture.action
        else:
            on_wheel, on_body = -picture.action[0], picture.action[0]
        self._arrow(
            (axle - half + 24 * unit, float(body.top if on_body > 0 else body.bottom)),
            on_body,
            colour,
        )
        self._arrow((axle - 62 * unit, hub), on_wheel, colour)
        if episode.force.f:
            share = float(episode.force.value(picture.time)) / picture.nominal.force.f
            tail = (axle + half - 24 * unit, float(body.top if share > 0 else body.bottom))
            self._arrow(tail, share, _EXTERNAL)

    def _wheel(self, x: float, hub: float, contact: float, rolled: float) -> None:
        """Draw the tyre from the hub down to the road, and the rim with its spokes."""
        surface, radius = self._surface, _WHEEL * self._unit
        below = max(contact - hub, 0.3 * radius)
        wide = radius * (1.0 + 0.12 * max(-1.0, min(1.0, 1.0 - below / radius)))
        angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        sine = np.sin(angles)
        across = x + wide * np.cos(angles)
        down = hub + np.where(sine > 0.0, below, radius) * sine
        outline = list(zip(across.tolist(), down.tolist(), strict=True))
        pygame.gfxdraw.filled_polygon(surface, outline, _TYRE)
        pygame.gfxdraw.aapolygon(surface, outline, _TYRE)
        rim = round(0.55 * radius)
        centre = (round(x), round(hub))
        pygame.gfxdraw.filled_circle(surface, *centre, rim, _RIM)
        pygame.gfxdraw.aacircle(surface, *centre, rim, _RIM)
        for spoke in range(5):
            angle = rolled + 2.0 * math.pi * spoke / 5
            end = (x + 0.5 * radius * math.cos(angle), hub + 0.5 * radius * math.sin(angle))
            _line(surface, _STEEL, (x, hub), end, 3 * self._unit)
        pygame.gfxdraw.filled_circle(surface, *centre, max(2, round(0.13 * radius)), _TYRE)

    def _spring(self, foot: Point, top: float) -> None:
        x, bottom = foot
        shares = np.concatenate([[0.0, 0.12], np.linspace(0.12, 0.88, 12)[1:-1], [0.88, 1.0]])
        sides = np.array([0.0, 0.0, *([1.0, -1.0] * 5), 0.0, 0.0]) * 11 * self._unit
        points = [
            (x + side, bottom + share * (top - bottom))
            for side, share in zip(sides.tolist(), shares.tolist(), strict=True)
        ]
        pieces = list(itertools.pairwise(points))
        for ink, width in ((_PAPER, 5.0), (_INK, 2.6)):
            for a, b in pieces:
                _line(self._surface, ink, a, b, width * self._unit)

    def _damper(self, foot: Point, top: float) -> None:
        surface, unit = self._surface, self._unit
        x, bottom = foot
        cylinder = 34 * unit
        piston = min(max(top + 46 * unit, bottom - cylinder + 4 * unit), bottom - 4 * unit)
        side = 12 * unit
        case = pygame.Rect(
            round(x - side), round(bottom - cylinder), round(2 * side), round(cylinder)
        )
        pygame.draw.rect(surface, _PAPER, case.inflate(4 * unit, 4 * unit))
        for a, b in (
            ((x, top), (x, piston)),
            ((x - 9 * unit, piston), (x + 9 * unit, piston)),
            ((x - side, bottom), (x - side, bottom - cylinder)),
            ((x + side, bottom), (x + side, bottom - cylinder)),
            ((x - side, bottom), (x + side, bottom)),
        ):
            _line(surface, _INK, a, b, 2.6 * unit)

    def _arrow(self, tail: Point, share: float, colour: Colour) -> None:
        """Draw a force over its limit as an arrow, up for a positive one."""
        unit = self._unit
        length = _ARROW * unit * max(-1.5, min(1.5, share))
        if abs(length) < 2.0:
            return
        x, y = tail
        head = math.copysign(min(12 * unit, abs(length)), length)
        wing = 8 * unit
        tip = (x, y - length)
        neck = y - length + head
        for ink, extra in ((_PAPER, 2.0 * unit), (colour, 0.0)):
            _line(self._surface, ink, (x, y), (x, neck), 5 * unit + 2 * extra)
            sign = math.copysign(1.0, length)
            outline = [
                (tip[0], tip[1] - 2 * sign * extra),
                (x - wing - 1.5 * extra, neck + sign * extra),
                (x + wing + 1.5 * extra, neck + sign * extra),
            ]
            pygame.gfxdraw.filled_polygon(self._surface, outline, ink)
            pygame.gfxdraw.aapolygon(self._surface, outline, ink)

    def _readings(self, picture: Picture) -> None:
        surface, unit = self._surface, self._unit
        right = self.size[0] - 16 * unit
        self._text(surface, f"{picture.elapsed:.2f} s", 24, _INK, (right, 16 * unit), "right-top")
        colour = _colour(picture.colour)
        x = picture.state
        unit_name = picture.episode.actuator.unit.replace("^2", "²")
        forces = [
            a * limit
            for a, limit in zip(picture.action, picture.episode.actuator.limit, strict=True)
        ]
        names = ("u1 wheel", "u2 body") if len(forces) == 2 else ("actuator",)
        rows: list[tuple[str, str, Colour]] = [
            ("x2 body", f"{x.x2:+.3f} m", _INK),
            ("x1 wheel", f"{x.x1:+.3f} m", _INK),
            *(
                (name, f"{_whole(force)} {unit_name}", colour)
                for name, force in reversed(list(zip(names, forces, strict=True)))
            ),
        ]
        if picture.episode.force.f:
            external = float(picture.episode.force.value(picture.time))
            rows.append(("F external", f"{_whole(external)} m/s²", _EXTERNAL))
        for number, (name, value, ink) in enumerate(rows):
            y = (84 + 25 * number) * unit
            self._text(surface, name, 19, ink, (right - 168 * unit, y))
            self._text(surface, value, 19, ink, (right, y), "right-top")

    def _remember(self, picture: Picture) -> None:
        if self._history and picture.elapsed < self._history[-1][0]:
            self._history.clear()
        if not self._history or picture.elapsed > self._history[-1][0]:
            self._history.append((picture.elapsed, *picture.levels))
        oldest = picture.elapsed - CHART_SECONDS
        if len(self._history) > 2 and self._history[1][0] < oldest - CHART_SECONDS:
            self._history = [each for each in self._history if each[0] >= oldest - 0.1]

    def _chart(self, picture: Picture) -> None:
        surface, unit = self._surface, self._unit
        area = self._chart_area
        colour = _colour(picture.colour)
        tint = _mix(colour, _PAPER, 0.5)
        history = np.array(self._history)
        history = history[history[:, 0] >= picture.elapsed - CHART_SECONDS]
        keep = max(1, len(history) // (area.width // 2))
        history = history[(len(history) - 1) % keep :: keep]
        across = area.right - (picture.elapsed - history[:, 0]) / CHART_SECONDS * area.width
        low, high = CHART_DECADES
        exponents = np.log10(np.maximum(history[:, 1:], 1e-12)).clip(low, high)
        down = area.bottom - (exponents - low) / (high - low) * area.height
        for column, ink in ((0, tint), (1, colour)):
            if len(across) > 1:
                points = list(zip(across.tolist(), down[:, column].tolist(), strict=True))
                pygame.draw.lines(surface, ink, False, points, max(1, round(2.4 * unit)))
            end = (round(across[-1]), round(down[-1, column]))
            pygame.gfxdraw.filled_circle(surface, *end, max(2, round(4 * unit)), ink)
            pygame.gfxdraw.aacircle(surface, *end, max(2, round(4 * unit)), ink)
        y = area.top - 18 * unit
        right = float(area.right)
        for name, level, ink in zip(
            ("body", "wheel"), reversed(picture.levels), (colour, tint), strict=True
        ):
            text = f"{name} {_percent(level)}"
            self._text(surface, text, 19, ink, (right, y), "right-top")
            right -= 124 * unit

    # ---- text -------------------------------------------------------------------------------

    def _text(
        self,
        surface: pygame.Surface,
        text: str,
        height: int,
        colour: Colour,
        at: Point,
        align: str = "left-top",
    ) -> None:
        """Write `text`, whose height is meant for a frame of 640 x 480, at a point."""
        drawn = self._texts.get((text, height, colour))
        if drawn is None:
            size = max(11, round(height * self._unit))
            if size not in self._fonts:
                self._fonts[size] = pygame.font.Font(None, size)
            if len(self._texts) > 4096:
                self._texts.clear()
            drawn = self._fonts[size].render(text, True, colour)
            self._texts[(text, height, colour)] = drawn
        x, y = at
        if align.startswith("right"):
            x -= drawn.get_width()
        elif align == "middle":
            x -= drawn.get_width() / 2
        if not align.endswith("top"):
            y -= drawn.get_height() / 2
        surface.blit(drawn, (round(x), round(y)))


class Renderer:
    """What an environment renders with: a painter, and a window in the mode "human".

    Parameters
    ----------
    mode : {"rgb_array", "human"}
        Whether frames are returned or shown.
    fps : float
        Frames a second in the window.
    size : tuple of int
        Width and height [px].
    """

    def __init__(self, mode: str, fps: float, size: tuple[int, int] = SIZE) -> None:
        self._painter = Painter(size)
        self._window = Window() if mode == "human" else None
        self._fps = fps

    def render(self, picture: Picture) -> Frame | None:
        """Return a frame (height, width, 3), or show it and return None."""
        frame = self._painter.draw(picture)
        if self._window is None:
            return frame
        self._window.show(frame, self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


class Window:
    """A window on the screen.

    Parameters
    ----------
    title : str
        What its frame says.
    """

    def __init__(self, title: str = "qcar_env") -> None:
        self._title = title
        self._screen: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def show(self, frame: Frame, fps: float) -> bool:
        """Show a frame, wait until it has been seen for ``1 / fps`` seconds.

        Parameters
        ----------
        frame : ndarray (height, width, 3)
            The frame.
        fps : float
            Frames a second.

        Returns
        -------
        bool
            False when the user has closed the window.
        """
        size = (frame.shape[1], frame.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            pygame.display.init()
            pygame.display.set_caption(self._title)
            self._screen = pygame.display.set_mode(size)
        pygame.surfarray.blit_array(self._screen, frame.transpose(1, 0, 2))
        pygame.display.flip()
        self._clock.tick(fps)
        return not any(event.type == pygame.QUIT for event in pygame.event.get())

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            pygame.display.quit()
            self._screen = None


def _colour(code: str) -> Colour:
    colour = pygame.Color(code)
    return (colour.r, colour.g, colour.b)


def _mix(a: Colour, b: Colour, share: float) -> Colour:
    red, green, blue = (round(p + share * (q - p)) for p, q in zip(a, b, strict=True))
    return (red, green, blue)


def _percent(level: float) -> str:
    percent = 100.0 * level
    return f"{percent:.0f} %" if percent >= 9.95 else f"{percent:.2g} %"


def _whole(value: float) -> str:
    return f"{round(value):+d}" if round(value) else "0"


def _line(surface: pygame.Surface, colour: Colour, a: Point, b: Point, width: float) -> None:
    """Draw a thick line with smooth edges."""
    across, down = b[0] - a[0], b[1] - a[1]
    length = math.hypot(across, down)
    if length == 0.0:
        return
    half = 0.5 * max(width, 1.0) / length
    dx, dy = -down * half, across * half
    outline = [
        (a[0] + dx, a[1] + dy),
        (b[0] + dx, b[1] + dy),
        (b[0] - dx, b[1] - dy),
        (a[0] - dx, a[1] - dy),
    ]
    pygame.gfxdraw.filled_polygon(surface, outline, colour)
    pygame.gfxdraw.aapolygon(surface, outline, colour)


def _dashes(surface: pygame.Surface, colour: Colour, a: Point, b: Point, dash: float) -> None:
    """Draw a dashed line of one pixel."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    for start in np.arange(0.0, length, 2.0 * dash).tolist():
        p, q = start / length, min(start + dash, length) / length
        pygame.draw.line(
            surface,
            colour,
            (a[0] + p * (b[0] - a[0]), a[1] + p * (b[1] - a[1])),
            (a[0] + q * (b[0] - a[0]), a[1] + q * (b[1] - a[1])),
        )
