"""What frames are drawn with: lines, arrows, texts, and the parts of a car (pygame).

Places are pixels from the upper left corner. Lengths are meant for a frame of 640 x 480 and grow
with it.
"""

from __future__ import annotations

import itertools
import math
import os

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.picture import WHEEL

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before pygame greets on stdout
import pygame
import pygame.gfxdraw

Frame = NDArray[np.uint8]
Point = tuple[float, float]
Colour = tuple[int, int, int]

PAPER = (255, 255, 255)
INK = (38, 42, 48)
QUIET = (118, 124, 132)
FAINT = (222, 225, 229)
ROAD = (88, 93, 100)
TYRE = (52, 56, 62)
RIM = (201, 205, 210)
STEEL = (128, 135, 144)
EXTERNAL = (176, 122, 20)  # the external force

ARROW = 46.0  # length of the arrow of the largest force [px]


def colour_of(code: str) -> Colour:
    """Return a colour ``#rrggbb``."""
    colour = pygame.Color(code)
    return (colour.r, colour.g, colour.b)


def mixed(a: Colour, b: Colour, share: float) -> Colour:
    """Return a colour between two."""
    red, green, blue = (round(p + share * (q - p)) for p, q in zip(a, b, strict=True))
    return (red, green, blue)


class Canvas:
    """A surface to draw on.

    Parameters
    ----------
    size : tuple of int
        Width and height [px].
    unit : float
        Length of a pixel of a frame of 640 x 480 [px].
    """

    def __init__(self, size: tuple[int, int], unit: float) -> None:
        pygame.font.init()
        self.size, self.unit = size, unit
        # Red, green and blue in this order in memory: a frame is a plain copy of the surface.
        self.surface = pygame.Surface(size, depth=24, masks=(0xFF, 0xFF00, 0xFF0000, 0))
        self._fonts: dict[int, pygame.font.Font] = {}
        self._texts: dict[tuple[str, int, Colour], pygame.Surface] = {}

    def frame(self) -> Frame:
        """Return what has been drawn, array (height, width, 3) of the caller's own."""
        width, height = self.size
        rows = np.frombuffer(self.surface.get_buffer().raw, dtype=np.uint8).reshape(height, -1)
        return rows[:, : 3 * width].reshape(height, width, 3).copy()

    def line(self, colour: Colour, a: Point, b: Point, width: float) -> None:
        """Draw a thick line with smooth edges."""
        across, down = b[0] - a[0], b[1] - a[1]
        length = math.hypot(across, down)
        if length == 0.0:
            return
        half = 0.5 * max(width, 1.0) / length
        dx, dy = -down * half, across * half
        self.polygon(
            colour,
            [
                (a[0] + dx, a[1] + dy),
                (b[0] + dx, b[1] + dy),
                (b[0] - dx, b[1] - dy),
                (a[0] - dx, a[1] - dy),
            ],
        )

    def polygon(self, colour: Colour, outline: list[Point]) -> None:
        """Fill a polygon with smooth edges."""
        pygame.gfxdraw.filled_polygon(self.surface, outline, colour)
        pygame.gfxdraw.aapolygon(self.surface, outline, colour)

    def dot(self, colour: Colour, at: Point, radius: float) -> None:
        """Fill a circle with smooth edges."""
        x, y = round(at[0]), round(at[1])
        pygame.gfxdraw.filled_circle(self.surface, x, y, max(2, round(radius)), colour)
        pygame.gfxdraw.aacircle(self.surface, x, y, max(2, round(radius)), colour)

    def dashes(self, colour: Colour, a: Point, b: Point, dash: float) -> None:
        """Draw a dashed line of one pixel."""
        length = math.hypot(b[0] - a[0], b[1] - a[1])
        for start in np.arange(0.0, length, 2.0 * dash).tolist():
            p, q = start / length, min(start + dash, length) / length
            pygame.draw.line(
                self.surface,
                colour,
                (a[0] + p * (b[0] - a[0]), a[1] + p * (b[1] - a[1])),
                (a[0] + q * (b[0] - a[0]), a[1] + q * (b[1] - a[1])),
            )

    def text(
        self, text: str, height: int, colour: Colour, at: Point, align: str = "left-top"
    ) -> None:
        """Write at a point, which `align` says where in the text it is."""
        drawn = self._texts.get((text, height, colour))
        if drawn is None:
            size = max(11, round(height * self.unit))
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
        self.surface.blit(drawn, (round(x), round(y)))

    def arrow(self, tail: Point, share: float, colour: Colour) -> None:
        """Draw a force over its largest one as an arrow, up for a positive one."""
        unit = self.unit
        length = ARROW * unit * max(-1.5, min(1.5, share))
        if abs(length) < 2.0:
            return
        x, y = tail
        head = math.copysign(min(12 * unit, abs(length)), length)
        wing, sign = 8 * unit, math.copysign(1.0, length)
        tip, neck = y - length, y - length + head
        for ink, extra in ((PAPER, 2.0 * unit), (colour, 0.0)):
            self.line(ink, (x, y), (x, neck), 5 * unit + 2 * extra)
            outline: list[Point] = [
                (x, tip - 2 * sign * extra),
                (x - wing - 1.5 * extra, neck + sign * extra),
                (x + wing + 1.5 * extra, neck + sign * extra),
            ]
            self.polygon(ink, outline)

    # ---- parts of a car ---------------------------------------------------------------------

    def wheel(self, x: float, hub: float, contact: float, rolled: float) -> None:
        """Draw the tyre from the hub down to the road, and the rim with its spokes."""
        radius = WHEEL * self.unit
        below = max(contact - hub, 0.3 * radius)
        wide = radius * (1.0 + 0.12 * max(-1.0, min(1.0, 1.0 - below / radius)))
        angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        sine = np.sin(angles)
        across = x + wide * np.cos(angles)
        down = hub + np.where(sine > 0.0, below, radius) * sine
        self.polygon(TYRE, list(zip(across.tolist(), down.tolist(), strict=True)))
        self.dot(RIM, (x, hub), 0.55 * radius)
        for spoke in range(5):
            angle = rolled + 2.0 * math.pi * spoke / 5
            end = (x + 0.5 * radius * math.cos(angle), hub + 0.5 * radius * math.sin(angle))
            self.line(STEEL, (x, hub), end, 3 * self.unit)
        self.dot(TYRE, (x, hub), 0.13 * radius)

    def spring(self, foot: Point, top: float) -> None:
        """Draw a coil from its foot up to `top`."""
        x, bottom = foot
        shares = np.concatenate([[0.0, 0.12], np.linspace(0.12, 0.88, 12)[1:-1], [0.88, 1.0]])
        sides = np.array([0.0, 0.0, *([1.0, -1.0] * 5), 0.0, 0.0]) * 11 * self.unit
        points = [
            (x + side, bottom + share * (top - bottom))
            for side, share in zip(sides.tolist(), shares.tolist(), strict=True)
        ]
        pieces = list(itertools.pairwise(points))
        for ink, width in ((PAPER, 5.0), (INK, 2.6)):
            for a, b in pieces:
                self.line(ink, a, b, width * self.unit)

    def damper(self, foot: Point, top: float) -> None:
        """Draw a cylinder on its foot, and the piston that hangs from `top`."""
        unit = self.unit
        x, bottom = foot
        cylinder = 34 * unit
        piston = min(max(top + 46 * unit, bottom - cylinder + 4 * unit), bottom - 4 * unit)
        side = 12 * unit
        case = pygame.Rect(
            round(x - side), round(bottom - cylinder), round(2 * side), round(cylinder)
        )
        pygame.draw.rect(self.surface, PAPER, case.inflate(4 * unit, 4 * unit))
        for a, b in (
            ((x, top), (x, piston)),
            ((x - 9 * unit, piston), (x + 9 * unit, piston)),
            ((x - side, bottom), (x - side, bottom - cylinder)),
            ((x + side, bottom), (x + side, bottom - cylinder)),
            ((x - side, bottom), (x + side, bottom)),
        ):
            self.line(INK, a, b, 2.6 * unit)

    def box(self, colour: Colour, box: pygame.Rect, radius: float) -> None:
        """Fill a box with round corners."""
        pygame.draw.rect(self.surface, colour, box, border_radius=max(1, round(radius)))
