"""Random cars, roads, forces and states: `@given(...)` draws them from a test's annotations.

The examples are the same on every run, so that a failure belongs to the code and not to the day;
`pytest --hypothesis-profile=explore` draws new ones, and more of them.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import settings, strategies as st

from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.state import Filter, State
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation

settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile("repeatable")


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


# A light car to a bus, as in print: 20 to 500 kg, 150 to 3000 kg; dampers down to none.
PHYSICAL = {
    "m1": between(20.0, 500.0),
    "m2": between(150.0, 3_000.0),
    "k1": between(5e4, 6e5),
    "k2": between(5e3, 1e5),
    "c1": between(0.0, 2e4),
    "c2": between(0.0, 1e4),
}
# Around the paper's preset, each coefficient by itself.
COEFFICIENTS = {
    "omega1": between(10.0, 100.0),
    "omega2": between(5.0, 100.0),
    "b1": between(0.0, 50.0),
    "b2": between(0.0, 10.0),
    "E1": between(0.0, 20.0),
    "E2": between(0.0, 10.0),
    "E3": between(0.0, 20.0),
    "mu1": between(0.0, 5_000.0),
    "mu2": between(0.0, 50.0),
}
HUMP = {"h": between(-0.2, 0.2), "omega": between(1.0, 100.0), "start": between(-1.0, 1.0)}

st.register_type_strategy(
    PaperCar,
    st.one_of(
        st.builds(PaperCar.from_physical, **PHYSICAL, reciprocal=st.booleans()),
        st.builds(PaperCar, **COEFFICIENTS),
    ),
)
st.register_type_strategy(QuarterCar, st.builds(QuarterCar.from_physical, **PHYSICAL))
st.register_type_strategy(
    Excitation,
    st.one_of(
        st.builds(roads.harmonic, h=HUMP["h"], omega=HUMP["omega"]),
        st.builds(roads.hump, **HUMP),
        st.builds(roads.train, **HUMP, count=st.integers(1, 5), gap=between(0.0, 3.0)),
        st.builds(roads.step, h=HUMP["h"], start=HUMP["start"]),
    ),
)
st.register_type_strategy(
    ExternalForce, st.builds(ExternalForce, f=between(-50.0, 50.0), Omega=between(0.0, 100.0))
)
st.register_type_strategy(
    State,
    st.builds(
        State,
        x1=between(-1.0, 1.0),
        x2=between(-1.0, 1.0),
        v1=between(-50.0, 50.0),
        v2=between(-50.0, 50.0),
    ),
)
st.register_type_strategy(
    Filter,
    st.builds(
        Filter,
        eta1=between(-1.0, 1.0),
        eta2=between(-1.0, 1.0),
        eta1_dot=between(-50.0, 50.0),
        eta2_dot=between(-50.0, 50.0),
    ),
)


@pytest.fixture
def same_bits() -> Callable[..., None]:
    """Assert that a function gives the same bits on arrays, tensors and floats, row by row.

    Its arguments are named tuples (or one array) of arrays (n,); so is what it returns.
    """
    torch = pytest.importorskip("torch")

    def check(function: Callable[..., Any], *args: Any) -> None:
        arrays = leaves(function(*args))
        tensors = leaves(function(*(convert(arg, torch.from_numpy) for arg in args)))
        for array, tensor in zip(arrays, tensors, strict=True):
            assert array.dtype == np.float64
            assert tensor.dtype == torch.float64
            assert array.tobytes() == tensor.numpy().tobytes()
        for row in range(len(arrays[0])):
            floats = leaves(function(*(convert(arg, lambda a: float(a[row])) for arg in args)))  # noqa: B023
            assert all(type(value) is float for value in floats)
            expected = np.array([array[row] for array in arrays])
            assert np.array(floats).tobytes() == expected.tobytes()

    return check


def convert(tree: Any, kind: Callable[[Any], Any]) -> Any:
    """Return a nested named tuple with `kind` applied to every entry."""
    if isinstance(tree, tuple):
        entries = [convert(entry, kind) for entry in tree]
        return type(tree)(*entries) if hasattr(tree, "_fields") else tuple(entries)
    return kind(tree)


def leaves(tree: Any) -> list[Any]:
    """Return the entries of a nested tuple in order."""
    if isinstance(tree, tuple):
        return [leaf for entry in tree for leaf in leaves(entry)]
    return [tree]
