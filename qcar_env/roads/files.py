"""Roads from files: tables as text (CSV), ERD, OpenCRG.

    road = load("profile.csv")

What lies between the samples of a file is `interpolation`:

cubic    a spline with a continuous second derivative, the road of `SampledRoad`. Where the file is
         even (to a millionth of its spacing) and no `spacing` is given it goes through the samples
         as they are; elsewhere the spline through them is sampled again, at `spacing` or at the
         median distance of the file's neighbours, and the road goes through these.
linear   straight lines; each sample is a kink. With `spacing` the lines are sampled again first.

Sampling again takes points and does not smooth: with a spacing wider than that of the file short
waves turn into long ones. Smooth first: `qcar_env.roads.enveloping.moving_average`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from qcar_env.roads.crg_file import read_crg
from qcar_env.roads.csv_file import read_csv
from qcar_env.roads.erd_file import read_erd
from qcar_env.roads.measured import EVEN, SampledRoad
from qcar_env.roads.samples import Samples
from qcar_env.validation import finite, known, positive

Interpolation = Literal["cubic", "linear"]

READERS: dict[str, Callable[..., Samples]] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".erd": read_erd,
    ".crg": read_crg,
}


def load(
    path: str | PathLike[str],
    *,
    channel: str | float | None = None,
    spacing: float | None = None,
    interpolation: Interpolation = "cubic",
    start: float | None = None,
    level: bool = True,
    longest_gap: float | None = None,
) -> SampledRoad:
    """Return the road of a file; its ending says which kind of file it is.

    Parameters
    ----------
    path : str or path
        `.csv`, `.tsv`, `.txt`: a table, see `qcar_env.roads.csv_file`. `.erd`: see
        `qcar_env.roads.erd_file`. `.crg`: an OpenCRG surface, see `qcar_env.roads.crg_file`.
    channel : str or float, optional
        Which profile of the file: the name of a column or of a channel, of a surface the lateral
        position [m]. The only one needs no name; a surface is read at 0 m.
    spacing : float, optional
        Spacing to which the profile is sampled again [m].
    interpolation : {"cubic", "linear"}, optional
        What lies between the samples, see above.
    start : float, optional
        Where the road is to begin [m]; without it the distances are those of the file.
    level : bool, optional
        Whether the first height is taken off all, so that a car on the flat before the road starts
        level; else the heights are those of the file.
    longest_gap : float, optional
        Largest distance between two samples [m]; ten times their median where not given.

    Raises
    ------
    ValueError
        If the file cannot be read: the message names the line and what to do.
    RuntimeError
        If an OpenCRG file is given and pyopencrg is not installed.
    OSError
        If there is no such file.
    """
    file = Path(path)
    read = READERS[known("kind of road file", file.suffix.lower(), READERS)]
    known("interpolation", interpolation, get_args(Interpolation))
    chosen: Any = channel
    if read is not read_crg and channel is not None and not isinstance(channel, str):
        chosen = str(channel)
    samples = read(file, channel=chosen, longest_gap=longest_gap)
    s, y = samples.distances, samples.heights
    if level:
        y = y - y[0]
    if start is not None:
        s = s - s[0] + finite("start", start, "m")
    if spacing is not None:
        positive("spacing", spacing, "m")
    if interpolation == "linear":
        if spacing is not None:
            intervals = max(1, math.ceil((s[-1] - s[0]) / spacing))
            grid = np.linspace(s[0], s[-1], intervals + 1)
            s, y = grid, np.interp(grid, s, y)
        return SampledRoad(distances=tuple(s), samples=tuple(y), kinks_at=tuple(s[1:-1]))
    even = np.linspace(s[0], s[-1], s.size)
    if spacing is None and np.abs(s - even).max() <= EVEN * samples.spacing:
        s = even
    elif spacing is None:
        spacing = samples.spacing
    return SampledRoad(distances=tuple(s), samples=tuple(y), spacing=spacing)
