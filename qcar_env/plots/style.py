"""One look for all figures: a colour and a line for each law, sizes for print.

The colours are those of Okabe and Ito (Color Universal Design, 2008), told apart by colour-blind
readers; each law also has its own line, so that a grey print can be read.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from qcar_env.evaluation import storage


class Line(NamedTuple):
    """How one law is drawn."""

    color: str
    linestyle: str | tuple[int, tuple[int, ...]]
    label: str


LINES: Mapping[str, Line] = MappingProxyType(
    {
        "none": Line("#000000", "-", "no control"),
        "cnvc": Line("#0072B2", "-", "CNVC"),
        "lnvc": Line("#E69F00", (0, (6, 2)), "LNVC"),
        "ppf": Line("#CC79A7", (0, (1, 1)), "PPF"),
        "ndf": Line("#009E73", (0, (4, 1, 1, 1)), "NDF"),
        "pd": Line("#56B4E9", (0, (3, 2)), "PD"),
        "learned": Line("#D55E00", "-", "learned"),
        "ppo": Line("#D55E00", "-", "PPO"),
        "sac": Line("#D55E00", (0, (3, 1)), "SAC"),
        "cma": Line("#882255", (0, (5, 1, 1, 1)), "CMA-ES"),
        "optimum": Line("#7F7F7F", (0, (2, 2)), "optimum"),
    }
)

# Laws beyond the paper's, in the order in which they are drawn.
OTHERS = ("#882255", "#44AA99", "#999933", "#AA4499", "#332288", "#117733", "#661100", "#DDCC77")

MASSES = (("x_1", "wheel"), ("x_2", "body"))  # symbol and name of each displacement
DOUBLE_COLUMN = 7.2  # [in] width of a figure over both columns of a journal

SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.4,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": 100.0,
    "savefig.dpi": 200.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "qcar_env",  # the same figure gives the same file
    "pdf.fonttype": 42,
}


def line(law: str) -> Line:
    """Return how `law` is drawn; a law without a colour of its own gets a fixed other one.

    An agent such as ``ppo-paper`` is drawn as its algorithm.
    """
    key = law.lower()
    for known in (key, key.split("-")[0]):
        if known in LINES:
            return LINES[known]
    return Line(OTHERS[sum(key.encode()) % len(OTHERS)], "-", law)


def shared_legend(figure: Any, axes: Iterable[Axes], *, place: str = "lower") -> None:
    """Put one legend for all panels above (`place` ``"upper"``) or below the figure."""
    entries: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    columns = 4
    if place == "upper":
        columns = -(-len(entries) // 2) if sum(map(len, entries)) > 80 else len(entries)
    where = f"outside {place} center"
    figure.legend(list(entries.values()), list(entries), loc=where, ncols=columns)


def log_ticks(ax: Axes, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Write the values at these multiples of the powers of ten on a logarithmic vertical axis."""
    ax.yaxis.set_major_locator(LogLocator(subs=subs))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and as PDF, under a name without ending, and close it."""
    for suffix in ("png", "pdf"):
        metadata = {"CreationDate": None} if suffix == "pdf" else None  # the same file each time
        with storage.replacing(path.with_name(f"{path.name}.{suffix}")) as temporary:
            figure.savefig(temporary, metadata=metadata)
    plt.close(figure)


@contextmanager
def journal() -> Generator[None, None, None]:
    """Draw everything inside in the settings of this file."""
    with mpl.rc_context(SETTINGS):
        yield
