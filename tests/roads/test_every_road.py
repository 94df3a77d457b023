"""Laws of every road, of every class that the package holds."""

import copy
import importlib
import inspect
import itertools
import math
import pickle
import pkgutil
import types

import numpy as np
import pytest

from qcar_env import roads
from qcar_env.roads import shapes
from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.measured import SampledRoad
from qcar_env.roads.profile import Road
from qcar_env.roads.sum_of_sines import SumOfSines
from qcar_env.roads.train import Train


def saw(s):
    """A road with a jump of 2 cm at 1 m and a kink at 2 m."""
    if s < 1.0:
        return 0.01 * math.sin(3.0 * s)
    return 0.02 + 0.01 * math.sin(3.0 * s) + 0.05 * abs(s - 2.0)


def saw_slope(s):
    bend = 0.0
    if s >= 1.0:
        bend = 0.05 if s >= 2.0 else -0.05
    return 0.03 * math.cos(3.0 * s) + bend


HUMPS = [
    shapes.HalfSine(h=0.1, wavenumber=1.7, start=0.3),
    shapes.OneMinusCosine(h=0.12, L=4.8, start=-0.4),
    shapes.CircularArc(h=0.1, L=3.7, start=1.1),
    shapes.Parabola(h=0.08, L=1.5, start=0.2),
    shapes.Quartic(h=-0.06, L=3.0, start=0.1),
    shapes.Sextic(h=0.06, L=9.0, start=0.7),
    FlatTop(h=0.075, ramp=0.9, top=2.5, start=0.6),
    SmoothFlatTop(h=0.1, ramp=0.85, top=5.0, start=0.4),
    shapes.SquareBar(h=0.03, L=0.1, start=0.9),
]
ROADS = [
    *HUMPS,
    shapes.Sine(h=0.1, wavenumber=2.3, start=0.2),
    shapes.Step(h=0.1, start=1.3),
    SumOfSines(amplitudes=(0.02, 0.001), wavenumbers=(1.0, 9.0), phases=(0.3, 2.0)),
    Train(shape=HUMPS[0], count=3, gap=0.7),
    Train(shape=HUMPS[6], count=2, gap=0.0),
    Train(shape=HUMPS[8], count=4, gap=0.2),
    FunctionRoad(profile=saw, gradient=saw_slope, kinks_at=(1.0, 2.0)),
    FunctionRoad(profile=saw, kinks_at=(1.0, 2.0)),
    SampledRoad(distances=(0.0, 0.5, 1.0, 1.5, 1.5, 2.5), samples=(0.1, 0.2, 0.1, 0.3, 0.2, 0.4)),
    SampledRoad.from_function(saw, start=-0.5, end=3.0, spacing=0.1, kinks_at=(1.0, 2.0)),
    ISO8608.of_class("C", L=100.0, seed=4, start=1.0),
]


def edges(road):
    """The ends of its pieces [m], from 1 m before the first kink to 1 m after the last."""
    kinks = road.kinks(-1e3, 1e3)
    return [kinks[0] - 1.0, *kinks, kinks[-1] + 1.0] if kinks else [-3.0, 5.0]


def pieces(road):
    """Yield the number and the ends of each piece that is not empty."""
    for piece, (a, b) in enumerate(itertools.pairwise(edges(road))):
        if a < b:
            yield piece, a, b


every_road = pytest.mark.parametrize("road", ROADS, ids=lambda road: type(road).__name__)


def classes():
    """Return the classes of roads in the package that are no other's base."""
    found = set()
    for module in pkgutil.iter_modules(roads.__path__):
        members = vars(importlib.import_module(f"{roads.__name__}.{module.name}")).values()
        found |= {each for each in members if inspect.isclass(each) and issubclass(each, Road)}
    return {each for each in found if not any(each in one.__mro__[1:] for one in found)}


def compiled(function):
    """Compile a function with all that it calls: plain functions around it and enclosed in it."""
    numba = pytest.importorskip("numba")
    done = set()

    def register(one):
        if not isinstance(one, types.FunctionType) or one in done:
            return
        done.add(one)
        inner = inspect.getclosurevars(one)
        for each in [*inner.globals.values(), *inner.nonlocals.values()]:
            register(each)
        if one is not function:
            numba.extending.register_jitable(one)

    register(function)
    return numba.njit(function)


def test_every_class_has_an_example():
    assert classes() == {
        each for each in classes() if any(isinstance(road, each) for road in ROADS)
    }


@every_road
def test_the_slope_is_the_derivative_of_the_height_inside_a_piece(road):
    kind, p, table = type(road), road.numbers, road.table
    for piece, a, b in pieces(road):
        for share in (0.02, 0.21, 0.5, 0.77, 0.98):
            s, d = a + share * (b - a), 1e-5 * (b - a)
            # fourth order: d^4 y^(5) / 30 is below 1e-12, rounding 1e-17 / 1e-6 is 1e-11 of it
            y = [kind.height(s + k * d, piece, p, table) for k in (-2, -1, 1, 2)]
            difference = (y[0] - 8.0 * y[1] + 8.0 * y[2] - y[3]) / (12.0 * d)
            assert kind.slope(s, piece, p, table) == pytest.approx(difference, abs=2e-8)


@every_road
def test_the_height_is_continuous_but_for_its_jumps(road):
    kind, p, table = type(road), road.numbers, road.table
    ends = edges(road)[1:-1]
    for piece, kink in enumerate(ends):
        assert kind.kink(piece, p, table) == kink
        rise = kind.height(kink, piece + 1, p, table) - kind.height(kink, piece, p, table)
        # a slope of at most 1 at distances of at most 100 m, which are rounded to 1e-14 m
        assert rise == pytest.approx(kind.jump(piece, p, table), abs=5e-14)
    assert kind.kink(len(ends), p, table) == math.inf
    assert kind.jump(len(ends), p, table) == 0.0
    assert road.length == (ends[-1] if ends else math.inf)


@every_road
def test_a_piece_reaches_smoothly_up_to_both_its_ends(road):
    kind, p, table = type(road), road.numbers, road.table
    for piece, a, b in pieces(road):
        for end, inward in ((a, 1.0), (b, -1.0)):
            for function in (kind.height, kind.slope):
                near = function(end + inward * 1e-9 * (b - a), piece, p, table)
                # curvatures of at most 10 1/m; the function's missing slope knows 1e-9
                assert function(end, piece, p, table) == pytest.approx(near, abs=1e-7)


@every_road
def test_people_and_the_engine_read_the_same(road):
    kind, p, table = type(road), road.numbers, road.table
    for piece, a, b in pieces(road):
        for s in (a, 0.5 * (a + b)):  # a kink is followed by the piece that begins there
            if s > a or piece > 0:
                assert road.heights(s) == kind.height(s, piece, p, table)
                assert road.slopes([[s]]).tolist() == [[kind.slope(s, piece, p, table)]]


@every_road
def test_compiled_code_gives_the_same_bits(road):
    kind, p, table = type(road), road.numbers, road.table
    height, slope = compiled(kind.height), compiled(kind.slope)
    kink, jump = compiled(kind.kink), compiled(kind.jump)
    for piece, a, b in pieces(road):
        for s in np.linspace(a, b, 7).tolist():
            assert height(s, piece, p, table) == kind.height(s, piece, p, table)
            assert slope(s, piece, p, table) == kind.slope(s, piece, p, table)
        assert kink(piece, p, table) == kind.kink(piece, p, table)
        assert jump(piece, p, table) == kind.jump(piece, p, table)


@every_road
def test_numbers_are_plain_floats(road):
    def leaves(tree):
        return [x for each in tree for x in leaves(each)] if isinstance(tree, tuple) else [tree]

    assert all(type(each) is float for each in leaves(road.numbers))
    assert road.table.dtype == np.float64
    assert not road.table.flags.writeable


@every_road
def test_copies_are_equal_and_of_the_same_class(road):
    for other in (pickle.loads(pickle.dumps(road)), copy.deepcopy(road)):
        assert other == road
        assert hash(other) == hash(road)
        assert type(other) is type(road)


def test_a_road_may_have_kinks_for_ever(monkeypatch):
    class Cobbles(Road):
        @staticmethod
        def height(s, piece, p, table):
            return 0.01 * abs(math.sin(s))

        @staticmethod
        def slope(s, piece, p, table):
            return 0.01 * math.copysign(math.cos(s), math.sin(s) * math.cos(s))

        @staticmethod
        def kink(piece, p, table):
            return math.pi * (piece + 1)

    monkeypatch.setattr("qcar_env.roads.profile.MOST_KINKS", 1000)
    assert Cobbles().length == math.inf
    assert Cobbles().kinks(0.0, 7.0) == [math.pi, 2.0 * math.pi]


def test_a_kink_is_listed_once_with_its_jump():
    road = next(each for each in ROADS if getattr(each, "profile", None) is saw)
    assert road.kinks(-5.0, 5.0) == [1.0, 2.0]
    assert road.kinks(1.0, 5.0) == [2.0]  # the interval is open
    # 2 cm, and the 5 cm per metre of a corner 1 m away
    assert road.jumps(-5.0, 5.0) == [pytest.approx(0.07, abs=1e-15), 0.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, "1", [0.0, math.nan], None])
def test_a_distance_that_is_no_number_is_refused(bad):
    with pytest.raises(ValueError, match="distance s"):
        ROADS[0].heights(bad)
