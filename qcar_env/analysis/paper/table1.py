"""Table 1 of the paper: what each law does to the worst case, from continuous-time simulation.

The paper gives the difference and the percentage error of the steady-state amplitudes without and
with control. Both amplitudes follow from the two, which allows a comparison of ratios.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.control import CNVC, LNVC, NDF, PPF, Passive
from qcar_env.control.law import Law
from qcar_env.scenarios import Scenario


@dataclass(frozen=True, kw_only=True)
class PrintedRow:
    """A row of the paper's Table 1."""

    law: Law
    gain: float  # G1 = G2, in the unit of the law
    absolute_error: tuple[float, float]  # vA1 - vA2 of x1 and x2 [m]
    percentage_error: tuple[float, float]  # (vA1 - vA2) / vA2 [%]

    @property
    def ratios(self) -> tuple[float, float]:
        """Uncontrolled over controlled amplitude of x1 and x2 [-]."""
        return self.percentage_error[0] / 100.0 + 1.0, self.percentage_error[1] / 100.0 + 1.0

    @property
    def uncontrolled(self) -> tuple[float, float]:
        """Uncontrolled amplitudes that the row implies [m]."""
        first, second = (
            difference * ratio / (ratio - 1.0)
            for difference, ratio in zip(self.absolute_error, self.ratios, strict=True)
        )
        return first, second


def _row(law: Law, gain: float, x1: tuple[float, float], x2: tuple[float, float]) -> PrintedRow:
    return PrintedRow(
        law=law, gain=gain, absolute_error=(x1[0], x2[0]), percentage_error=(x1[1], x2[1])
    )


PRINTED: tuple[PrintedRow, ...] = (  # law, G, then (error [m], error [%]) of x1 and of x2
    _row(NDF(G1=1.2, G2=1.2), 1.2, (0.68, 157.0), (1.35, 633.0)),
    _row(PPF(G1=30.0, G2=30.0), 30.0, (0.57, 61.2), (0.496, 42.2)),
    _row(PPF(G1=70.0, G2=70.0), 70.0, (0.84, 127.6), (0.923, 126.9)),
    _row(LNVC(G1=1.2, G2=1.2), 1.2, (0.486, 75.0), (1.187, 316.0)),
    _row(CNVC(G1=0.5, G2=0.5), 0.5, (0.976, 712.0), (1.5, 2272.0)),
    _row(CNVC(G1=1.2, G2=1.2), 1.2, (1.002, 814.0), (1.52, 2556.0)),
)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell pair of Table 1, ours beside the paper's."""

    law: str
    gain: float
    mass: int  # 1 wheel, 2 body
    uncontrolled: float  # our amplitude without control [m]
    controlled: float  # our amplitude with control [m]
    printed: float  # the paper's percentage error [%]

    @property
    def absolute_error(self) -> float:
        """``vA1 - vA2`` [m]."""
        return self.uncontrolled - self.controlled

    @property
    def percentage_error(self) -> float:
        """``(vA1 - vA2) / vA2`` [%]."""
        return 100.0 * (self.uncontrolled - self.controlled) / self.controlled

    @property
    def agreement(self) -> float:
        """Our ratio of uncontrolled to controlled amplitude over the paper's [-]."""
        return (self.uncontrolled / self.controlled) / (self.printed / 100.0 + 1.0)


def table1(
    scenario: Scenario, *, duration: float = 60.0, rows: Sequence[PrintedRow] = PRINTED
) -> tuple[Cell, ...]:
    """Compute Table 1.

    Parameters
    ----------
    scenario : Scenario
        Car, road and external force; its actuator limits are not applied, as in the paper.
    duration : float
        Simulated time from rest [s]; the slow mode needs 40 s or more.
    rows : sequence of PrintedRow
        The rows.

    Returns
    -------
    tuple of Cell
        Two for each row: wheel and body.
    """
    without, *with_control = (
        _amplitudes(scenario, law, duration) for law in (Passive(), *(row.law for row in rows))
    )
    return tuple(
        Cell(
            law=row.law.name,
            gain=row.gain,
            mass=i + 1,
            uncontrolled=without[i],
            controlled=amplitudes[i],
            printed=row.percentage_error[i],
        )
        for row, amplitudes in zip(rows, with_control, strict=True)
        for i in range(2)
    )


def _amplitudes(scenario: Scenario, law: Law, duration: float) -> tuple[float, float]:
    found = steady_amplitudes(
        scenario.car, scenario.excitation, scenario.force, law, duration=duration
    )
    return float(found.x1), float(found.x2)
