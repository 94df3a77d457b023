"""Frames of the car on its road, for `render_mode` "rgb_array" and "human" (pygame).

A frame shows one car: the road that rolls under the tyre, wheel, spring, damper, body, the forces,
and a strip chart of both envelope amplitudes over those of the uncontrolled motion. It is drawn to
scale: a bar gives the length of the displacements, and where the road would be too low to be seen
beside them it is drawn higher, by the factor that the frame states; distances along the road have a
scale of their own. The drawn tyre stretches down to the road wherever the wheel is.

`Painter` needs no display; `Window` opens one.
"""

from __future__ import annotations

import math

import numpy as np

from qcar_env.envs.drawing import (
    EXTERNAL,
    FAINT,
    INK,
    PAPER,
    QUIET,
    ROAD,
    STEEL,
    Canvas,
    Colour,
    Frame,
    colour_of,
    mixed,
    pygame,
)
from qcar_env.envs.picture import WHEEL, Picture, Sizes, profile, sizes
from qcar_env.validation import whole

SIZE = (640, 480)  # [px] of a frame
LEAST = (240, 180)  # [px] smallest frame that can still be read
CHART_SECONDS = 4.0  # [s] of the strip chart
CHART_DECADES = (-3.0, 0.5)  # [-] range of its axis: powers of ten of a_i / A_i

# Lengths in a frame of 640 x 480 [px].
_GAP = 84.0  # from the hub to the underside of the body, at rest
_BODY = (168.0, 46.0)
_MARK = 75.0  # from one mark on the road to the next


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
        self.size = size
        self._unit = min(size[0] / SIZE[0], size[1] / SIZE[1])
        self._canvas = Canvas(size, self._unit)
        self._history: list[tuple[float, float, float]] = []
        self._still: tuple[object, pygame.Surface] | None = None
        self._scale = Sizes(displacement=1.0, road=1.0, bar=1.0, along=1.0)

    def draw(self, picture: Picture) -> Frame:
        """Return a frame, array (height, width, 3) of the caller's own."""
        self._remember(picture)
        key = (picture.name, picture.colour, picture.note, picture.nominal)
        if self._still is None or self._still[0] != key:
            self._scale = sizes(picture.nominal)
            self._background(picture)
            self._still = (key, self._canvas.surface.copy())
        self._canvas.surface.blit(self._still[1], (0, 0))
        self._scene(picture)
        self._readings(picture)
        self._chart(picture)
        return self._canvas.frame()

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

    def _background(self, picture: Picture) -> None:
        canvas, unit = self._canvas, self._unit
        canvas.surface.fill(PAPER)
        canvas.text(picture.name, 30, colour_of(picture.colour), (16 * unit, 14 * unit))
        scale = self._scale
        note = f"scenario {picture.nominal.name}"
        if scale.road > 1.0:
            note += f", road drawn {scale.road:g} x higher"
        if picture.note:
            note += f", {picture.note}"
        canvas.text(note, 17, QUIET, (16 * unit, 42 * unit))

        length = scale.displacement * scale.bar * unit
        x, bottom = 30 * unit, self._ground - 24 * unit
        canvas.line(QUIET, (x, bottom), (x, bottom - length), 2 * unit)
        for y in (bottom, bottom - length):
            canvas.line(QUIET, (x - 5 * unit, y), (x + 5 * unit, y), 2 * unit)
        canvas.text(f"{scale.bar:g} m", 17, QUIET, (x + 9 * unit, bottom - length / 2), "left")
        self._axes()

    def _axes(self) -> None:
        canvas, unit, area = self._canvas, self._unit, self._chart_area
        title = "amplitude over that without control"
        canvas.text(title, 17, QUIET, (16 * unit, area.top - 18 * unit))
        for exponent in range(math.ceil(CHART_DECADES[0]), math.floor(CHART_DECADES[1]) + 1):
            y = self._chart_height(10.0**exponent)
            if exponent:
                pygame.draw.line(canvas.surface, FAINT, (area.left, y), (area.right, y))
            else:
                canvas.dashes(INK, (area.left, y), (area.right, y), 6 * unit)
            label = f"{100.0 * 10.0**exponent:g} %"
            canvas.text(label, 16, QUIET, (area.left - 6 * unit, y), "right")
        pygame.draw.line(canvas.surface, STEEL, area.bottomleft, area.bottomright)
        for second in range(int(CHART_SECONDS) + 1):
            x = area.right - second / CHART_SECONDS * area.width
            pygame.draw.line(canvas.surface, STEEL, (x, area.bottom), (x, area.bottom + 4 * unit))
            label = f"-{second} s" if second else "now"
            align = "right" if not second else "middle"
            canvas.text(label, 16, QUIET, (x, area.bottom + 12 * unit), align)

    # ---- what moves -------------------------------------------------------------------------

    def _scene(self, picture: Picture) -> None:
        canvas, unit = self._canvas, self._unit
        scale, x = self._scale, picture.state
        per_metre = scale.displacement * unit
        ground, axle = self._ground, self._axle
        contact = self._road(picture)
        hub = ground - WHEEL * unit - x.x1 * per_metre
        rest = ground - (WHEEL + _GAP) * unit
        underside = rest - x.x2 * per_metre
        self._reach(picture, per_metre)
        rolled = picture.distance * scale.along / WHEEL
        canvas.wheel(axle, hub, contact, rolled)
        canvas.spring((axle - 20 * unit, hub - 8 * unit), underside)
        canvas.damper((axle + 20 * unit, hub - 8 * unit), underside)
        plate = pygame.Rect(0, 0, round(62 * unit), max(3, round(9 * unit)))
        plate.center = (round(axle), round(hub - 5 * unit))
        canvas.box(STEEL, plate, 3 * unit)
        half, height = 0.5 * _BODY[0] * unit, _BODY[1] * unit
        body = pygame.Rect(
            round(axle - half), round(underside - height), round(2 * half), round(height)
        )
        colour = colour_of(picture.colour)
        canvas.box(colour, body, 10 * unit)
        bright = 0.3 * colour[0] + 0.6 * colour[1] + 0.1 * colour[2] > 140.0
        canvas.text("body", 19, INK if bright else PAPER, body.center, "middle")
        self._arrows(picture, body, hub)

    def _road(self, picture: Picture) -> float:
        """Draw the road; return where the tyre stands on it [px]."""
        canvas, unit, road = self._canvas, self._unit, picture.episode.road
        scale = self._scale
        along, up = scale.along * unit, scale.displacement * scale.road * unit
        ground, axle, right = self._ground, self._axle, self.size[0] + 4.0
        here = picture.distance
        low, high = here - axle / along, here + (right - axle) / along
        s, heights = profile(road, low, high, round(right / 4.0) + 1)
        across, down = axle + (s - here) * along, ground - heights * up
        floor = ground + 22 * unit
        outline = list(zip(across.tolist(), down.tolist(), strict=True))
        filled = [*outline, (right, floor), (0.0, floor)]
        pygame.draw.polygon(canvas.surface, ROAD, filled)
        pygame.draw.aalines(canvas.surface, ROAD, False, outline)
        pitch, y = _MARK * unit, floor - 5 * unit
        first = -((here * along) % pitch)
        for left in np.arange(first, self.size[0], pitch).tolist():
            pygame.draw.line(canvas.surface, FAINT, (left, y), (left + 0.4 * pitch, y), 2)
        return ground - float(road.heights(here)) * up

    def _reach(self, picture: Picture, per_metre: float) -> None:
        """Mark how far wheel and body go without control."""
        canvas, unit, axle = self._canvas, self._unit, self._axle
        a1, a2 = (a * per_metre for a in picture.nominal.reference.amplitudes)
        hub = self._ground - WHEEL * unit
        half, middle = 0.5 * _BODY[0] * unit, hub - (_GAP + 0.5 * _BODY[1]) * unit
        for sign in (-1.0, 1.0):
            for y, reach in ((middle + sign * a2, half), (hub + sign * a1, WHEEL * unit)):
                for side in (-1.0, 1.0):
                    start = axle + side * (reach + 8 * unit)
                    canvas.dashes(STEEL, (start, y), (start + side * 26 * unit, y), 4 * unit)
        label = (axle + half + 42 * unit, middle + a2)
        canvas.text("without control", 15, QUIET, label, "left")

    def _arrows(self, picture: Picture, body: pygame.Rect, hub: float) -> None:
        unit, colour = self._unit, colour_of(picture.colour)
        on_wheel, on_body = picture.shares
        top, bottom = float(body.top), float(body.bottom)
        tail = (body.left + 24 * unit, top if on_body > 0 else bottom)
        self._canvas.arrow(tail, on_body, colour)
        self._canvas.arrow((self._axle - 62 * unit, hub), on_wheel, colour)
        force = picture.episode.force
        if force.f:
            share = float(force.value(picture.time)) / abs(picture.nominal.force.f or force.f)
            tail = (body.right - 24 * unit, top if share > 0 else bottom)
            self._canvas.arrow(tail, share, EXTERNAL)

    def _readings(self, picture: Picture) -> None:
        canvas, unit = self._canvas, self._unit
        right = self.size[0] - 16 * unit
        canvas.text(f"{picture.elapsed:.2f} s", 24, INK, (right, 16 * unit), "right-top")
        colour, x, episode = colour_of(picture.colour), picture.state, picture.episode
        unit_name = episode.actuator.unit.replace("^2", "²")
        u1, u2 = picture.force
        pair = (("u2 body", u2), ("u1 wheel", u1))
        forces = pair if episode.actuator.size == 2 else (("actuator", u2),)
        rows: list[tuple[str, str, Colour]] = [
            ("x2 body", f"{x.x2:+.3f} m", INK),
            ("x1 wheel", f"{x.x1:+.3f} m", INK),
            *((name, f"{_whole(force)} {unit_name}", colour) for name, force in forces),
        ]
        if episode.force.f:
            external = float(episode.force.value(picture.time))
            rows.append(("F external", f"{_whole(external)} m/s²", EXTERNAL))
        for number, (name, value, ink) in enumerate(rows):
            y = (84 + 25 * number) * unit
            canvas.text(name, 19, ink, (right - 168 * unit, y))
            canvas.text(value, 19, ink, (right, y), "right-top")

    def _remember(self, picture: Picture) -> None:
        if self._history and picture.elapsed < self._history[-1][0]:
            self._history.clear()
        if not self._history or picture.elapsed > self._history[-1][0]:
            self._history.append((picture.elapsed, *picture.levels))
        oldest = picture.elapsed - CHART_SECONDS
        if len(self._history) > 2 and self._history[1][0] < oldest - CHART_SECONDS:
            self._history = [each for each in self._history if each[0] >= oldest - 0.1]

    def _chart(self, picture: Picture) -> None:
        canvas, unit = self._canvas, self._unit
        area = self._chart_area
        colour = colour_of(picture.colour)
        tint = mixed(colour, PAPER, 0.5)
        history = np.array(self._history)
        history = history[history[:, 0] >= picture.elapsed - CHART_SECONDS]
        keep = max(1, len(history) // (area.width // 2))
        history = history[(len(history) - 1) % keep :: keep]
        across = area.right - (picture.elapsed - history[:, 0]) / CHART_SECONDS * area.width
        low, high = CHART_DECADES
        exponents = np.log10(np.maximum(history[:, 1:], 1e-12)).clip(low, high)
        down = area.bottom - (exponents - low) / (high - low) * area.height
        for column, ink in ((0, tint), (1, colour)):
            points = list(zip(across.tolist(), down[:, column].tolist(), strict=True))
            if len(points) > 1:
                width = max(1, round(2.4 * unit))
                pygame.draw.lines(canvas.surface, ink, False, points, width)
            canvas.dot(ink, points[-1], 4 * unit)
        y = area.top - 18 * unit
        right = float(area.right)
        for name, level, ink in zip(
            ("body", "wheel"), reversed(picture.levels), (colour, tint), strict=True
        ):
            canvas.text(f"{name} {_percent(level)}", 19, ink, (right, y), "right-top")
            right -= 124 * unit


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


def _percent(level: float) -> str:
    percent = 100.0 * level
    return f"{percent:.0f} %" if percent >= 9.95 else f"{percent:.2g} %"


def _whole(value: float) -> str:
    return f"{round(value):+d}" if round(value) else "0"
