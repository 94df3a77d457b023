"""Speed humps by name, with the rules that they come from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop
from qcar_env.roads.profile import Shape
from qcar_env.roads.shapes import CircularArc, OneMinusCosine, Parabola, SquareBar
from qcar_env.validation import finite, known


@dataclass(frozen=True, kw_only=True)
class HumpPreset:
    """A speed hump.

    Parameters
    ----------
    title : str
        What it is, for people.
    source : str
        The rule or study that has it.
    shape : Shape
        It, from distance 0 on.
    speed : float
        Speed that it is made for [m/s].
    """

    title: str
    source: str
    shape: Shape
    speed: float


def _hump(title: str, source: str, shape: Shape, km_h: float) -> HumpPreset:
    return HumpPreset(title=title, source=source, shape=shape, speed=km_h / 3.6)


_UK = "UK Highways (Road Humps) Regulations 1999 and Local Transport Note 1/07"
_BELGIUM = "Belgian royal decrees of 9-10-1998 and 3-5-2002, annexes"
_ITALY = "Italy, DPR 495/92, art. 179; the shape is chosen here, as the rule gives none"

HUMPS: Mapping[str, HumpPreset] = MappingProxyType(
    {
        "watts": _hump(
            "Watts' round-topped hump, 3.7 m x 100 mm",
            "G. R. Watts, TRRL Laboratory Report 597 (1973): the best of those he tried, 3.66 m",
            CircularArc(h=0.1, L=3.7),
            30.0,
        ),
        "uk-round": _hump(
            "Round-topped hump, 3.7 m x 75 mm",
            _UK + "; dimensions recalled",
            CircularArc(h=0.075, L=3.7),
            32.0,
        ),
        "uk-sinusoidal": _hump(
            "Sinusoidal hump, 3.7 m x 75 mm",
            "TRL Report 377 (title seen; dimensions recalled)",
            OneMinusCosine(h=0.075, L=3.7),
            32.0,
        ),
        "uk-table": _hump(
            "Flat-topped hump, 75 mm, ramps 1:13, plateau 7 m",
            _UK + "; Leicestershire's ramps",
            FlatTop(h=0.075, ramp=13.0 * 0.075, top=7.0),
            32.0,
        ),
        "cushion": _hump(
            "Speed cushion, 70 mm, ramps 1:8, 2.5 m long",
            _UK + "; a wheel on its middle; gradients recalled",
            FlatTop(h=0.07, ramp=8.0 * 0.07, top=2.5 - 16.0 * 0.07),
            30.0,
        ),
        "seminole": _hump(
            "Seminole County's flat-topped hump, 6.7 m x 100 mm",
            "ITE; Weber and Braaksma 2000: the ramps of Watts' hump and a plateau of 3 m; here "
            "sinusoidal ramps of the same length",
            SmoothFlatTop(h=0.1, ramp=1.85, top=3.0),
            40.0,
        ),
        "us-12ft": _hump(
            "Hump of 12 ft x 3 in, parabolic",
            "practice of US counties (Montgomery); the shape is chosen here",
            Parabola(h=0.0762, L=3.6576),
            32.0,
        ),
        "us-22ft": _hump(
            "Flat-topped hump of 22 ft x 3 in",
            "practice of US counties (Montgomery); ramps of 6 ft are chosen here",
            FlatTop(h=0.0762, ramp=1.8288, top=3.048),
            40.0,
        ),
        "india": _hump(
            "Circular hump, 3.7 m x 100 mm, radius 17 m",
            "IRC:99-1988",
            CircularArc(h=0.1, L=3.7),
            25.0,
        ),
        "brazil-a": _hump(
            "Type A, 3.7 m x 100 mm, parabolic",
            "CONTRAN resolutions 600/2016 and 973/2022",
            Parabola(h=0.1, L=3.7),
            30.0,
        ),
        "brazil-b": _hump(
            "Type B, 1.5 m x 80 mm, parabolic",
            "CONTRAN resolutions 600/2016 and 973/2022",
            Parabola(h=0.08, L=1.5),
            20.0,
        ),
        "italy-30": _hump("Rubber, 1.2 m x 70 mm", _ITALY, Parabola(h=0.07, L=1.2), 30.0),
        "italy-40": _hump("Rubber, 0.9 m x 50 mm", _ITALY, Parabola(h=0.05, L=0.9), 40.0),
        "italy-50": _hump("Rubber, 0.6 m x 30 mm", _ITALY, Parabola(h=0.03, L=0.6), 50.0),
        "belgium": _hump(
            "Sinusoidal hump, 4.8 m x 120 mm", _BELGIUM, OneMinusCosine(h=0.12, L=4.8), 30.0
        ),
        "belgium-table": _hump(
            "Flat-topped hump, 120 mm, ramps 12 %, plateau 5 m",
            _BELGIUM,
            FlatTop(h=0.12, ramp=1.0, top=5.0),
            30.0,
        ),
        "belgium-bus": _hump(
            "The same on bus routes: 120 mm, ramps 4 %, plateau 8 m",
            _BELGIUM,
            FlatTop(h=0.12, ramp=3.0, top=8.0),
            30.0,
        ),
        "netherlands": _hump(
            "Sinusoidal hump, 4.5 m x 120 mm",
            "de Wit 1993 for CROW: 30 km/h on 4 to 5 m",
            OneMinusCosine(h=0.12, L=4.5),
            30.0,
        ),
        "mexico": _hump(
            "Tope, 0.5 m x 80 mm",
            "NOM-034-SCT2-2022, 50 to 120 mm x 0.3 to 0.6 m (secondary source); circular is chosen",
            CircularArc(h=0.08, L=0.5),
            10.0,
        ),
        "egypt-bump": _hump(
            "Bump, 0.305 m x 57 mm",
            "Hassaan, GJRE: harmful above some 2 km/h; circular is chosen here",
            CircularArc(h=0.057, L=0.305),
            5.0,
        ),
        "bar": _hump(
            "Square bar, 0.3 m x 20 mm", "chosen here: a cable ramp", SquareBar(h=0.02, L=0.3), 20.0
        ),
    }
)


def hump(name: str, *, start: float = 0.0) -> Shape:
    """Return a hump by its name, which begins at the distance `start` [m].

    Raises
    ------
    ValueError
        If there is no such hump.
    """
    shape = HUMPS[known("hump", name, HUMPS)].shape
    return dataclasses.replace(shape, start=finite("start", start, "m"))
