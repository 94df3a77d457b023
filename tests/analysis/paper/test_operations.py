"""Operations of a control step, against those in the formulas."""

import pytest

from qcar_env.analysis.paper.operations import operations
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF

# Of a Runge-Kutta step of a filter of 4 states: 6 sums x + step k, and k2 + k3.
RK4_MULTIPLICATIONS, RK4_ADDITIONS = 6 * 4, 6 * 4 + 4


@pytest.mark.parametrize(
    ("law", "multiplications", "additions"),
    [
        (LNVC(), 2, 0),  # G v, for each mass
        (CNVC(), 2 * 3, 0),  # G v v v
        (PD(), 2 * 2, 2),  # p x + d v
        # stiffness (x - eta) - damping eta', four times; G eta
        (PPF(), 2 * (4 * 2 + 1) + RK4_MULTIPLICATIONS, 2 * 4 * 2 + RK4_ADDITIONS),
        # w (v - w eta) - damping eta', four times; G eta'
        (NDF(), 2 * (4 * 3 + 1) + RK4_MULTIPLICATIONS, 2 * 4 * 2 + RK4_ADDITIONS),
    ],
    ids=lambda each: getattr(each, "name", None),
)
def test_operations_are_those_of_the_formulas(law, multiplications, additions):
    found = operations(law)
    assert (found.multiplications, found.additions) == (multiplications, additions)
    assert found.total == multiplications + additions


def test_cnvc_computes_three_times_what_lnvc_does():
    assert operations(CNVC()).total == 3 * operations(LNVC()).total == operations(PD()).total


def test_gains_do_not_change_the_count():
    assert operations(NDF(G1=5.0)) == operations(NDF())


def test_what_is_no_law_is_refused():
    with pytest.raises(ValueError, match="law must be a control law"):
        operations("CNVC")
