"""Where the humps of a profile are, how high and how long.

A hump is sought as a shape of the library, with unknown beginning, length and height, in the
*differences* of neighbouring heights. There a gradient is a constant, which no hump sees, as one
rises as much as it falls; and a road whose spectrum falls with the square of the wavenumber, as
that of ISO 8608 does, is white noise, for which least squares are the best estimate.

1. Humps of some shapes and lengths are laid at every sample. What each is worth is its *score*: its
   height by least squares over the spread of that height along the whole profile, which is what
   roughness alone gives. Where one flank alone makes it, it is a step and not a hump.
2. The best one is fitted: beginning, length and ramps by least squares for every kind of shape; the
   kind that leaves least is taken.
3. It is taken off the profile, and the next one is sought.

Not validated on measured humps. What tests/roads/test_humps.py shows is stated at `find_humps`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop
from qcar_env.roads.iso8608 import N0
from qcar_env.roads.profile import Shape
from qcar_env.roads.shapes import HalfSine, OneMinusCosine, Parabola, Quartic, Sextic, SquareBar
from qcar_env.validation import finite, finite_array, positive

Floats = NDArray[np.float64]

LEAST_SCORE = 5.0  # chosen here: of 2e6 heights by chance one is as high
FLANK = 1.0 / 3.0  # chosen here: least height of each flank alone, in heights of the hump
SMOOTHEST = 1e-6  # [m^3] Gd(0.1 1/m), chosen here: a sixteenth of class A
RATIO = 1.15  # chosen here: from one length that is sought to the next
LEAST_SAMPLES = 4  # of a hump, chosen here
SAMPLES_SOUGHT = 8  # of the shortest hump when humps are sought, chosen here: others are left out
SAMPLES_FITTED = 200  # of a hump in its fit, chosen here: others are left out
BLOCK = 2.5  # in longest humps, chosen here: where the road has one gradient
MOST_HUMPS = 1000  # chosen here
QUARTILE = 0.3186  # of |x|, x drawn from the normal distribution of spread 1

# Shapes of height 1; of a flat top the ramps are `share` of its length
KINDS: dict[str, Callable[[float, float, float], Shape]] = {
    "half sine": lambda start, L, share: HalfSine.of_length(h=1.0, L=L, start=start),
    "sinusoidal": lambda start, L, share: OneMinusCosine(h=1.0, L=L, start=start),
    "parabola": lambda start, L, share: Parabola(h=1.0, L=L, start=start),
    "quartic": lambda start, L, share: Quartic(h=1.0, L=L, start=start),
    "sextic": lambda start, L, share: Sextic(h=1.0, L=L, start=start),
    "bar": lambda start, L, share: SquareBar(h=1.0, L=L, start=start),
    "flat top": lambda start, L, share: FlatTop(
        h=1.0, ramp=0.5 * share * L, top=(1.0 - share) * L, start=start
    ),
    "smooth flat top": lambda start, L, share: SmoothFlatTop(
        h=1.0, ramp=0.5 * share * L, top=(1.0 - share) * L, start=start
    ),
}
SOUGHT = (("half sine", 1.0), ("sinusoidal", 1.0), ("flat top", 0.25))
SHARES = (0.2, 0.5, 0.8)  # chosen here: where the fit of a flat top begins
LEAST_SHARE = 0.02  # chosen here: with less it is a bar


@dataclass(frozen=True, kw_only=True)
class FoundHump:
    """A hump of a profile.

    Parameters
    ----------
    shape : Shape
        What fits it best, a road by itself. Shapes that look alike, as those without a slope at
        their feet, cannot be told from each other on a rough road.
    score : float
        Its height over what roughness gives by chance [-]; at least 5.
    """

    shape: Shape
    score: float

    @property
    def start(self) -> float:
        """Where it begins [m]."""
        return self.shape.start

    @property
    def length(self) -> float:
        """How long it is [m]."""
        return self.shape.extent

    @property
    def middle(self) -> float:
        """Where its middle is [m]."""
        return self.shape.start + 0.5 * self.shape.extent

    @property
    def height(self) -> float:
        """How high it is above the road [m]."""
        return self.shape.h


def find_humps(
    heights: ArrayLike,
    *,
    spacing: float,
    start: float = 0.0,
    least_height: float = 0.03,
    shortest: float = 0.3,
    longest: float = 12.0,
) -> tuple[FoundHump, ...]:
    """Return the humps of a profile, in the order of the road.

    Parameters
    ----------
    heights : array (n,)
        The profile [m], evenly sampled. For potholes give ``-heights``.
    spacing : float
        Distance between two samples [m].
    start : float, optional
        Where the first sample is [m].
    least_height : float, optional
        Height from which on it is a hump [m].
    shortest, longest : float, optional
        Lengths that are sought [m]; shorter than four samples none is.

    Raises
    ------
    ValueError
        If a height is no number or a number is out of range.

    Notes
    -----
    One hump of 60 to 150 mm and 1.5 to 8 m on a road of 120 m and a gradient of up to 5 %, of nine
    shapes of the library and sixty draws of each, at 0.05 m: all were found and nothing else. The
    errors, half of them below the first and all below the second number:

    =====  ==========  =========================  =============  ==================
    class  middle [m]  length (foot with slope)   length (none)  height times score
    =====  ==========  =========================  =============  ==================
    A      0.01, 0.07  0.3 %, 4 %                 1 %, 14 %      0.7, 3.1
    B      0.01, 0.15  0.3 %, 16 %                2 %, 17 %      0.8, 3.0
    C      0.06, 0.6   1 %, 29 %                  10 %, 37 %     0.8, 3.9
    =====  ==========  =========================  =============  ==================

    So a height is known to within some three to four times ``height / score``. Feet without a slope
    cannot be seen, whence the length: a sextic of 1.15 L is a sinusoidal hump of L.
    """
    y = finite_array("heights", heights, "m")
    dx = positive("spacing", spacing, "m")
    finite("start", start, "m")
    positive("least_height", least_height, "m")
    least = max(positive("shortest", shortest, "m"), LEAST_SAMPLES * dx)
    if positive("longest", longest, "m") < least:
        raise ValueError(
            f"longest must be at least {least:g} m, the shortest hump or four samples, got "
            f"{longest:g} m; give a larger one or closer samples"
        )
    if y.ndim != 1 or y.size < 2:
        raise ValueError(
            f"heights must be two or more in a row, got shape {y.shape}; give one profile"
        )
    every = max(1, math.floor(least / (SAMPLES_SOUGHT * dx)))
    coarse = every * dx
    templates = [
        each
        for each in _templates(coarse, least, longest)
        if 1.5 * each[1].size < y[::every].size - 1
    ]
    left = y.copy()
    block = math.ceil(BLOCK * longest / coarse)
    laid = [_laid(_steep(left[::every], block), each)[0] for _, each in templates]
    spreads = _spreads(laid, templates, coarse)
    done: list[tuple[float, float]] = []
    found: list[FoundHump] = []
    while len(done) < MOST_HUMPS:
        score, at, length = 0.0, 0.0, 0.0
        differences = _steep(left[::every], block)
        for (L, template), spread in zip(templates, spreads, strict=True):
            h, flank = _laid(differences, template)
            middles = coarse * np.arange(h.size) + 0.5 * L
            fits = (h >= least_height) & (flank >= FLANK * h)
            for begin, end in done:
                fits &= (middles < begin) | (middles > end)
            scores = np.where(fits, h / spread, 0.0)
            best = int(scores.argmax())
            if scores[best] > score:
                score, at, length = float(scores[best]), coarse * best, L
        if score < LEAST_SCORE:
            break
        done.append((at, at + length))
        shape = _fitted(left, dx, at, length)
        if shape is None or shape.extent > RATIO * longest:
            continue  # the crest of a hill, not a hump
        if shape.h >= least_height:
            done.append((shape.start, shape.start + shape.extent))
            left -= shape.heights(dx * np.arange(y.size))
            moved = dataclasses.replace(shape, start=start + shape.start)
            found.append(FoundHump(shape=moved, score=score))
    return tuple(sorted(found, key=lambda each: each.start))


def _templates(spacing: float, shortest: float, longest: float) -> Iterator[tuple[float, Floats]]:
    """Yield lengths [m] of humps that are sought and the differences of their heights (n,)."""
    for k in range(math.floor(math.log(longest / shortest) / math.log(RATIO)) + 1):
        L = shortest * RATIO**k
        s = spacing * np.arange(math.ceil(L / spacing) + 1)
        for kind, share in SOUGHT:
            yield L, np.diff(KINDS[kind](0.0, L, share).heights(s))


def _steep(y: Floats, block: int) -> Floats:
    """Return the differences of heights without the road's gradient (n - 1,).

    The gradient is the median of blocks, joined by straight lines: a hump hardly changes it.
    """
    differences = np.diff(y)
    blocks = np.array_split(differences, max(1, differences.size // block))
    ends = np.cumsum([each.size for each in blocks])
    middles = ends - 0.5 * np.array([each.size for each in blocks])
    medians = [float(np.median(each)) for each in blocks]
    return differences - np.interp(np.arange(differences.size), middles, medians)


def _laid(differences: Floats, template: Floats) -> tuple[Floats, Floats]:
    """Return the height of a shape laid at each sample, and that of its lower flank [m].

    By least squares, of the whole shape and of each flank by itself.
    """
    from scipy.signal import correlate  # slow to import

    flanks = [np.maximum(template, 0.0), np.minimum(template, 0.0)]
    energies = [float(flank @ flank) for flank in flanks]
    up, down = (correlate(differences, flank, "valid", "fft") for flank in flanks)
    return (up + down) / sum(energies), np.minimum(up / energies[0], down / energies[1])


def _spreads(
    heights: list[Floats], templates: list[tuple[float, Floats]], spacing: float
) -> list[float]:
    """Return the spread of the heights by roughness alone for each template [m].

    From their lower quartile, which humps do not change as long as they are rare. White noise gives
    all templates one spread times their norm; a template is never given less than their median.
    """
    norms = [float(np.linalg.norm(differences)) for _, differences in templates]
    levels = [
        float(np.quantile(np.abs(h), 0.25)) / QUARTILE * norm
        for h, norm in zip(heights, norms, strict=True)
    ]
    # differences over dx of a road with Gd = G n0^2 / n^2 have the variance 2 pi^2 G n0^2 dx
    smoothest = math.sqrt(2.0 * math.pi**2 * SMOOTHEST * N0 * N0 * spacing)
    least = max(smoothest, float(np.median(levels or [0.0])))
    return [max(level, least) / norm for level, norm in zip(levels, norms, strict=True)]


def _fitted(y: Floats, spacing: float, start: float, L: float) -> Shape | None:
    """Return the shape that leaves least of the differences around a hump; none if none fits.

    A flat top has one number more than the others and must leave less by two variances (Akaike).
    """
    from scipy.optimize import minimize  # slow to import

    every = max(1, math.floor(L / (SAMPLES_FITTED * spacing)))
    first = max(0, math.floor((start - 0.5 * L) / spacing) - LEAST_SAMPLES)
    last = min(y.size, math.ceil((start + 1.5 * L) / spacing) + LEAST_SAMPLES + 1)
    s = spacing * np.arange(first, last)[::every]
    differences = np.diff(y[first:last:every])
    differences -= differences.mean()
    whole = float(differences @ differences)

    def of_height(shape: Shape) -> tuple[float, float]:
        """Return the height by least squares, and what is left."""
        template = np.diff(shape.heights(s))
        template -= template.mean()
        energy = float(template @ template)
        h = float(template @ differences) / energy if energy > 0.0 else 0.0
        return h, whole - h * abs(h) * energy

    def made(kind: str, q: Floats) -> Shape | None:
        """Return the shape of a kind, or none where it does not lie inside."""
        begin, length, share = q[0], q[1], q[2] if q.size > 2 else 1.0
        short = length < LEAST_SAMPLES * every * spacing or not LEAST_SHARE <= share <= 1.0
        outside = begin < s[0] or begin + length > s[-1]
        return None if short or outside else KINDS[kind](float(begin), float(length), float(share))

    def cost(q: Floats, kind: str) -> float:
        shape = made(kind, q)
        return 2.0 * whole if shape is None else of_height(shape)[1]

    candidates: list[Shape] = []
    for kind in KINDS:
        for share in SHARES if kind.endswith("flat top") else (1.0,):
            q = np.array([start, L, share][: 2 + kind.endswith("flat top")])
            moves = np.array(
                [[0.0, 0.0, 0.0], [-0.1, 0.0, 0.0], [-0.1, 0.2, 0.0], [0.0, 0.0, 0.15]]
            )
            corners = q + (moves * (L, L, 1.0))[: q.size + 1, : q.size]
            done: Any = minimize(
                cost,
                q,
                args=(kind,),
                method="Nelder-Mead",
                options={"initial_simplex": corners, "xatol": 1e-3 * L, "fatol": 1e-6 * whole},
            )
            shape = made(kind, done.x)
            candidates += [] if shape is None else [shape]
    half = differences.size // 2
    up, down = int(differences[:half].argmax()), half + int(differences[half:].argmin())
    step = every * spacing
    candidates.append(SquareBar(h=1.0, L=step * (down - up), start=float(s[up]) + 0.5 * step))
    rated = [(*of_height(shape), shape) for shape in candidates]
    variance = min(left for _, left, _ in rated) / differences.size
    h, _, shape = min(rated, key=lambda each: each[1] + 2.0 * variance * (each[2].kink_count - 2))
    return dataclasses.replace(shape, h=h) if h > 0.0 else None
