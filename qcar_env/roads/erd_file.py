"""Profiles in the ERD format of the University of Michigan (UMTRI), which profilometers write.

    ERDFILEV2.00
          2,  25544,     -1,      1,      5,      0.25,     -1,
    SHORTNAMLElev.  RElev.
    UNITSNAMmm      mm
    XUNITS  m
    END
    0.37 0.41
    ...

The second line: number of channels, number of samples, two numbers on records, how the data are
stored (5: as text), the spacing. Then keywords of eight characters, `SHORTNAM` and `UNITSNAM`
with eight for each channel. Source: UMTRI, The ERD file specification; the program of M. W. Sayers,
Transportation Research Record 1501 (1995) 1.

Data in binary form (1: floats of 4 bytes, recalled, as is their order: the channels of a sample
side by side, little-endian) lie in a second file, whose name is that of the first and `.bin`. They
have not been compared with a file of another program.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_env.roads.samples import Samples, chosen, metres
from qcar_env.validation import shown

MAGIC = "ERDFILEV2"
KEY = 8  # characters of a keyword, and of a channel's entry
FLOATS, TEXT = 1, 5  # how the data are stored
MOST_CHANNELS = 1000  # chosen here: a header with more is damaged


def read_erd(
    path: Path, *, channel: str | None = None, longest_gap: float | None = None
) -> Samples:
    """Return a profile of an ERD file.

    Parameters
    ----------
    path : Path
        The file, for binary data the one with the header.
    channel : str, optional
        Short name of the channel, or its number from "1" where it has none; the only one needs no
        name.
    longest_gap : float, optional
        As of `Samples` [m].

    Raises
    ------
    ValueError
        If the header or a number cannot be read, samples are missing, or as `Samples`; the line is
        named.
    """
    lines = path.read_text(encoding="latin-1").split("\n")
    if not lines or not lines[0].startswith(MAGIC):
        got = shown(lines[0] if lines else "")
        raise ValueError(
            f"an ERD file must begin with {MAGIC}.00, got {got} in line 1 of {path}; export it "
            "again as ERD, or name a table .csv"
        )
    channels, count, stored, step = _layout(lines[1] if len(lines) > 1 else "", path)
    keywords: dict[str, tuple[str, int]] = {}
    for number, line in enumerate(lines[2:], 3):
        if line.strip() == "END":
            break
        keywords[line[:KEY].strip()] = line[KEY:], number
    else:
        raise ValueError(f"the header of {path} must end with a line END, got none; add it")
    units = _entries("UNITSNAM", keywords, channels, path)
    names = _entries("SHORTNAM", keywords, channels, path, needed=False)
    names = [name or str(i) for i, name in enumerate(names, 1)]
    at = chosen(channel, names, path)
    if "XUNITS" not in keywords:
        raise ValueError(f"the header of {path} must have XUNITS, got none; add: XUNITS  m")
    unit, line = keywords["XUNITS"]
    spacing = step * metres(unit, "XUNITS", f"in line {line} of {path}")
    factor = metres(units[at], names[at], f"in line {keywords['UNITSNAM'][1]} of {path}")
    if stored == TEXT:
        data = _text(lines, number, channels, path)
    else:
        data = _binary(path, channels)
    if data.shape[0] != count:
        raise ValueError(
            f"{path} must hold the {count} samples that its line 2 states, got {data.shape[0]}; "
            "it may be cut off: fetch or export it again"
        )
    with np.errstate(over="ignore"):  # it is refused
        distances = np.arange(count, dtype=np.float64) * spacing
        heights = data[:, at] * factor
    return Samples(
        path=path,
        distances=distances,
        heights=heights,
        place="line" if stored == TEXT else "sample",
        numbers=range(number + 1, number + 1 + count) if stored == TEXT else range(1, count + 1),
        longest_gap=longest_gap,
    )


def _layout(line: str, path: Path) -> tuple[int, int, int, float]:
    """Return number of channels, number of samples, how they are stored, and the spacing."""
    cells = line.replace(",", " ").split()
    try:
        channels, count, _, _, stored, step = (float(cell) for cell in cells[:6])
    except ValueError:
        channels = count = stored = step = math.nan
    if not (1.0 <= channels <= MOST_CHANNELS and 2.0 <= count < math.inf and 0.0 < step < math.inf):
        raise ValueError(
            f"line 2 of {path} must be number of channels (1 to {MOST_CHANNELS}), number of "
            f"samples (2 or more), two numbers, kind of data and positive spacing, got "
            f"{shown(line)}; export the file again"
        )
    if stored not in (FLOATS, TEXT):
        raise ValueError(
            f"kind of data must be {TEXT} (text) or {FLOATS} (floats of 4 bytes), got {stored:g} "
            f"in line 2 of {path}; export the file as text"
        )
    return int(channels), int(count), int(stored), step


def _entries(
    key: str,
    keywords: dict[str, tuple[str, int]],
    channels: int,
    path: Path,
    *,
    needed: bool = True,
) -> list[str]:
    """Return the entry of each channel under a keyword."""
    if needed and key not in keywords:
        raise ValueError(f"the header of {path} must have {key}, got none; add: {key}mm")
    text, _ = keywords.get(key, ("", 0))
    return [text[KEY * i : KEY * (i + 1)].strip() for i in range(channels)]


def _text(lines: list[str], end: int, channels: int, path: Path) -> NDArray[np.float64]:
    """Return the numbers of the lines after END, array (n, channels)."""
    data: list[list[float]] = []
    for number, line in enumerate(lines[end:], end + 1):
        cells = line.replace(",", " ").split()
        if not cells:
            if not any(map(str.strip, lines[number:])):
                break  # blank lines at the end
            raise ValueError(f"line {number} of {path} must be a sample, got none; fill it in")
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != channels:
            raise ValueError(
                f"a line must have {channels} numbers, got {shown(line)} in line {number} of "
                f"{path}; write one number per channel, with decimal points"
            )
        data.append(row)
    return np.array(data, dtype=np.float64).reshape(-1, channels)


def _binary(path: Path, channels: int) -> NDArray[np.float64]:
    """Return the numbers of the second file, array (n, channels)."""
    both = (path.with_name(f"{path.name}.bin"), path.with_suffix(".bin"))
    for each in both:
        if each.is_file():
            data = np.frombuffer(each.read_bytes()[: each.stat().st_size // 4 * 4], dtype="<f4")
            whole = data.size // channels * channels
            return data[:whole].reshape(-1, channels).astype(np.float64)
    raise ValueError(
        f"the data of {path} must lie beside it in {both[0].name} or {both[1].name}, got neither; "
        "put the file there or export the profile as text"
    )
