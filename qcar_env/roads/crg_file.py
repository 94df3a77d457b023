"""Profiles along a road surface in the OpenCRG format (ASAM), read by the package pyopencrg.

A surface is a curved strip: heights over the distance u along its reference line and the lateral
position v. A profile is the line of one v, with slope and banking of the road in its heights.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.roads.samples import Samples
from qcar_env.validation import finite


def read_crg(
    path: Path, *, channel: float | None = None, longest_gap: float | None = None
) -> Samples:
    """Return a profile along a surface.

    Parameters
    ----------
    path : Path
        The file, text or binary.
    channel : float, optional
        Lateral position v [m], to the left of the reference line; 0 where not given.
    longest_gap : float, optional
        As of `Samples` [m].

    Raises
    ------
    RuntimeError
        If pyopencrg is not installed.
    ValueError
        If the file does not pass the checks of OpenCRG, v lies beside the road, or as `Samples`.

    Notes
    -----
    Between the columns of the surface heights are joined by straight lines. The modifiers of the
    file are applied, but for those that fill holes: a hole in the profile is refused.
    """
    try:
        crg: Any = importlib.import_module("pyopencrg")
    except ImportError:
        raise RuntimeError(
            "an OpenCRG road needs pyopencrg: pip install 'qcar_env[roads]'"
        ) from None
    try:
        surface = crg.read(path)
    except ValueError as error:
        raise ValueError(
            f"{path} must be an OpenCRG file that passes the checks of the format, got one with "
            f"errors ({error}); repair it or fetch it again"
        ) from error
    if surface.mods:
        kept = {key: value for key, value in surface.mods.items() if key != "grid_nan_offset"}
        surface.mods = {**kept, "grid_nan_mode": 0}
        surface = surface.apply_mods()
    v = finite("channel (lateral position v)", 0.0 if channel is None else channel, "m")
    if not surface.v_min <= v <= surface.v_max:
        raise ValueError(
            f"channel (lateral position v) must lie on the road, {surface.v_min:g} to "
            f"{surface.v_max:g} m, got {v:g} m; give channel=..."
        )
    distances, heights = surface.long_section(v)
    return Samples(
        path=path,
        distances=np.asarray(distances, dtype=np.float64),
        heights=np.asarray(heights, dtype=np.float64),
        place="cross-section",
        numbers=range(1, len(distances) + 1),
        longest_gap=longest_gap,
    )
