"""What a tyre makes of a road that is shorter than itself: a road made from a road.

Both are models of geometry alone. A point that follows the road is right for waves longer than two
or three contact lengths (Pacejka, Tire and Vehicle Dynamics); below that choose one of these:

moving average   the mean height under the contact, as the IRI takes it over 0.25 m
rolling disc     the height of a rigid wheel's centre above its radius, as it rolls over the road
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from qcar_env.roads.measured import SampledRoad, grid
from qcar_env.roads.profile import NEAREST, Road
from qcar_env.validation import finite, positive

SPACING = 0.02  # [m] chosen here: a tenth of a tyre's contact


def moving_average(
    road: Road,
    *,
    contact: float,
    spacing: float = SPACING,
    start: float | None = None,
    end: float | None = None,
) -> SampledRoad:
    """Return the road's mean height over a contact around each distance.

    Parameters
    ----------
    road : Road
        The road.
    contact : float
        Length of the contact [m]: 0.25 m in the IRI, 0.12 to 0.2 m for a car's tyre (recalled).
    spacing : float, optional
        Largest spacing of the result's samples [m].
    start, end : float, optional
        The stretch [m]; where not given, all from the first kink to the last. A road without kinks
        needs both.

    Notes
    -----
    ``Y(s) = 1 / contact * int_{s - contact / 2}^{s + contact / 2} y ds``, by Gauss and Legendre's
    rule of four points on each smooth part between the ends of two contacts. Each kink of the road
    makes two, half a contact before it and after it; a jump of the height becomes a ramp.
    """
    half = 0.5 * positive("contact", contact, "m")
    start, end = _stretch(road, start, end, half)
    edges = np.array(road.kinks(start - contact, end + contact))
    s, _ = grid(start, end, spacing, np.concatenate([edges - half, edges + half]).tolist())
    ends = np.unique(np.concatenate([s - half, s + half, edges]))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    widths = np.diff(ends)
    heights = road.heights(ends[:-1, None] + widths[:, None] * (0.5 + 0.5 * nodes))
    integral = np.append(0.0, np.cumsum(0.5 * widths * (heights @ weights)))
    at_front, at_rear = np.searchsorted(ends, s + half), np.searchsorted(ends, s - half)
    means = (integral[at_front] - integral[at_rear]) / contact
    return SampledRoad(distances=tuple(s.tolist()), samples=tuple(means.tolist()))


def rolling_disc(
    road: Road,
    *,
    radius: float,
    spacing: float = SPACING,
    start: float | None = None,
    end: float | None = None,
) -> SampledRoad:
    """Return the height of the centre of a rigid disc above its radius, as it rolls over a road.

    Parameters
    ----------
    road : Road
        The road; its jumps lower than the radius.
    radius : float
        Radius of the disc [m]: 0.30 to 0.34 m for a car's wheel.
    spacing : float, optional
        Largest spacing of the result's samples [m].
    start, end : float, optional
        The stretch [m], as of `moving_average`.

    Raises
    ------
    ValueError
        If the disc cannot roll over a jump of the road.

    Notes
    -----
    ``Y(s) = max over |x - s| <= radius of y(x) + sqrt(radius^2 - (x - s)^2) - radius``. The road
    is sampled ten times as densely as the result, with both sides of every kink, and the maximum
    found on parabolas through three samples of a smooth piece: exact on a corner and on the level,
    within 4e-9 m on a plane of slope 0.2. Where the disc goes over from one corner or piece of the
    road to another the result has a kink.
    """
    positive("radius", radius, "m")
    fine = 0.1 * positive("spacing", spacing, "m")
    start, end = _stretch(road, start, end, radius)
    low, high = start - radius, end + radius
    for where, jump in zip(road.kinks(low, high), road.jumps(low, high), strict=True):
        if abs(jump) >= radius:
            raise ValueError(
                f"radius must be larger than every jump of the road, got {radius:g} m at a jump "
                f"of {jump:g} m at s = {where:g} m; give a larger disc or a lower step"
            )
    x, seen_from = grid(low, high, fine, road.kinks(low, high))
    y = road.heights(seen_from)
    corners = x[1:][np.diff(x) == 0.0]
    # even on a smooth piece, odd on a corner
    places = np.searchsorted(corners, x, "left") + np.searchsorted(corners, x, "right")

    def touch(s: float) -> tuple[float, float, int]:
        """Return the height [m], where the disc touches [m], and on what."""
        i, j = np.searchsorted(x, [s - radius, s + radius]).tolist()
        u = x[i:j] - s
        rise = y[i:j] + np.sqrt(np.maximum(radius * radius - u * u, 0.0))
        k = int(rise.argmax())
        best = (float(rise[k]), float(x[i + k]), int(places[i + k]))
        for c in range(max(k - 2, 1), min(k + 3, j - i - 1)):
            before, at, after = rise[c - 1 : c + 2].tolist()
            lean, bend = after - before, 2.0 * at - before - after
            if places[i + c] % 2 == 0 and abs(lean) <= 2.0 * bend > 0.0:  # a top on this piece
                where = float(x[i + c] + lean / (2.0 * bend) * (x[i + c + 1] - x[i + c]))
                best = max(best, (at + lean * lean / (8.0 * bend), where, int(places[i + c])))
        return best[0] - radius, best[1], best[2]

    def switches(a: float, b: float) -> Iterator[float]:
        """Yield where between two distances the disc changes what it touches."""
        (_, at_a, on_a), (_, at_b, on_b) = touch(a), touch(b)
        if on_a == on_b and abs(at_b - at_a) <= 1.5 * (b - a) + 2.0 * fine:
            return
        middle = 0.5 * (a + b)
        if b - a < NEAREST:
            yield middle
        else:
            yield from switches(a, middle)
            yield from switches(middle, b)

    coarse = grid(start, end, spacing, ())[0].tolist()
    kinks = [each for a, b in itertools.pairwise(coarse) for each in switches(a, b)]
    return SampledRoad.from_function(
        lambda s: touch(s)[0], start=start, end=end, spacing=spacing, kinks_at=kinks
    )


def _stretch(
    road: Road, start: float | None, end: float | None, margin: float
) -> tuple[float, float]:
    """Return the ends of a stretch: those given, or all kinks and a margin [m]."""
    first = road.kink(0, road.numbers, road.table)
    if (start is None or end is None) and not math.isfinite(first):
        raise ValueError(
            f"start and end must be given for a road without kinks, got {start} and {end}; "
            "give the stretch that the car drives [m]"
        )
    begin = first - margin if start is None else finite("start", start, "m")
    stop = road.length + margin if end is None else finite("end", end, "m")
    return begin, stop
