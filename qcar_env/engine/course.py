"""A road under a driving car, for compiled fleets: what it does to the car, as a function of time.

Two kinds. A **turning** road has pieces ``y = h s``, ``y' = h omega c`` with a phasor ``(s, c)``
that turns at the rate omega, or rests: the sine, half-sine humps and their trains, the step. Any
other is **read**: height and slope at the distance ``speed t``, at every stage time.

At a kink a piece ends: the slope jumps, or the height. No step crosses one.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from qcar_env.engine.compile import compiled, compiled_apart
from qcar_env.physics.car import CarFunctions
from qcar_env.physics.motion import (
    Input,
    Phasor,
    Phasors,
    angle,
    given_step,
    input_of,
    middle_force,
    turn,
    turn_both,
    turning,
    turning_step,
)
from qcar_env.physics.rk4 import rk4_step, step_fractions
from qcar_env.roads.shapes import HalfSine, Sine, Step
from qcar_env.roads.train import Train

ENDLESS = 1e30  # [s] duration of a step; finite, so that 0 * ENDLESS is 0


class Pieces(NamedTuple):
    """A turning road in time."""

    h: Any  # height [m]
    omega: Any  # angular frequency of the pieces that turn [rad/s], 0 for a step
    start: Any  # time of the first kink [s]
    length: Any  # duration of a hump [s], endless for a step
    pitch: Any  # from the beginning of one hump to that of the next [s]
    count: Any  # number of humps; 0 for an endless sine


@dataclass(frozen=True)
class RoadFunctions:
    """A class of roads: either `pieces`, of a turning one, or the others (see `qcar_env.roads`)."""

    pieces: Any = None  # pieces(p, speed) -> Pieces
    height: Any = None  # height(s, piece, p, table) [m]
    slope: Any = None  # slope(s, piece, p, table) [-]
    kink: Any = None  # kink(piece, p, table), where a piece ends [m]
    jump: Any = None  # jump(piece, p, table), of the height there [m]


class Course(NamedTuple):
    """Compiled functions of a class of roads under a class of cars.

    `kink` is the number of the next kink, `w` the phasors, `fixed` what the episode fixes.
    """

    begin: Any  # begin(numbers, phase, endless) -> road numbers, time at the start, frequency
    amplitudes: Any  # amplitudes(road, ready) -> road's parts of the input, see `Turning`
    phasor: Any  # phasor(t, kink, road) -> Phasor
    next_kink: Any  # next_kink(kink, road, speed, table) -> its time [s]
    jump: Any  # jump(kink, fixed, table) -> jump of the height at a kink [m]
    after: Any  # after(w, kink, fixed) -> phasors with which the piece after it begins
    reading: Any  # reading(t, kink, w, fixed, table) -> y, y', input
    steps: Any  # steps(rate, x, w, turning, step, n, t, kink, command, fixed, table) -> x, w


def kink_time(index: Any, road: Any) -> Any:
    """Return when kink `index` (0, 1, 2, ...) of a turning road happens [s].

    Even kinks begin a hump, odd ones end it; past the last one it is infinite.
    """
    hump = index // 2
    time = road.start + hump * road.pitch + (index - hump - hump) * road.length
    return time if hump < road.count else math.inf


def piece_phasor(kink: Any, road: Any) -> Phasor:
    """Return the phasor with which the piece after kink `kink` begins.

    A hump begins at its foot, rising: (0, 1); a step at its top: (1, 0); a flat road rests.
    """
    if kink % 2 == 1:
        return Phasor(0.0, 0.0)
    if road.omega > 0.0:
        return Phasor(0.0, 1.0)
    return Phasor(1.0, 0.0)


def phasor_at(t: Any, kink: Any, road: Any) -> Phasor:
    """Return the phasor of a turning road at `t` [s], after which kink `kink` is the next."""
    if road.count == 0.0:
        return angle(road.omega * (t - road.start))
    if kink % 2 == 0:
        return Phasor(0.0, 0.0)
    if road.omega == 0.0:
        return Phasor(1.0, 0.0)
    return angle(road.omega * (t - kink_time(kink - 1, road)))


for _each in (
    angle,
    given_step,
    input_of,
    kink_time,
    middle_force,
    phasor_at,
    piece_phasor,
    rk4_step,
    step_fractions,
    turn,
    turn_both,
    turning,
    turning_step,
):
    compiled(_each)


def course(road: RoadFunctions, car: CarFunctions) -> Course:
    """Return the functions of a class of roads under a class of cars."""
    for each in (*car, road.pieces, road.height, road.slope, road.kink, road.jump):
        if each is not None:
            compiled(each)
    made = _read(road, car) if road.pieces is None else _turning(road, car)
    for each in made:
        (compiled_apart if each is made.steps else compiled)(each)
    return made


@cache
def _turning(road: RoadFunctions, car: CarFunctions) -> Course:
    pieces_of, road_input = road.pieces, car.road_input

    def begin(numbers, phase, endless):
        made = pieces_of(numbers.road, numbers.speed)
        return made, phase / made.omega if endless > 0.0 else 0.0, made.omega

    def amplitudes(road, ready):
        return road_input(road.h, 0.0, ready), road_input(0.0, road.h * road.omega, ready)

    def next_kink(kink, road, speed, table):
        return kink_time(kink, road)

    def jump(kink, fixed, table):
        return fixed.road.h if fixed.road.omega == 0.0 and kink % 2 == 0 else 0.0

    def after(w, kink, fixed):
        return Phasors(piece_phasor(kink, fixed.road), w.force)

    def reading(t, kink, w, fixed, table):
        y = fixed.road.h * w.road.s
        y_dot = fixed.road.h * fixed.road.omega * w.road.c
        return y, y_dot, input_of(w, fixed.turning)

    def steps(rate, x, w, turning, step, n, t, kink, command, fixed, table):
        for _ in range(n):
            x, w = turning_step(rate, x, w, turning, step, command, fixed)
        return x, w

    return Course(begin, amplitudes, phasor_at, next_kink, jump, after, reading, steps)


@cache
def _read(road: RoadFunctions, car: CarFunctions) -> Course:
    height, slope, kink_at, jump_at = road.height, road.slope, road.kink, road.jump
    road_input = car.road_input

    def begin(numbers, phase, endless):
        return numbers.road, 0.0, 0.0

    def amplitudes(road, ready):
        return road_input(0.0, 0.0, ready), road_input(0.0, 0.0, ready)

    def phasor(t, kink, road):
        return Phasor(0.0, 0.0)

    def next_kink(kink, road, speed, table):
        return kink_at(kink, road, table) / speed

    def jump(kink, fixed, table):
        return jump_at(kink, fixed.road, table)

    def after(w, kink, fixed):
        return w

    def on_road(t, kink, fixed, table):
        s = fixed.speed * t
        y = height(s, kink, fixed.road, table)
        return road_input(y, slope(s, kink, fixed.road, table) * fixed.speed, fixed.car)

    compiled_apart(on_road)

    def reading(t, kink, w, fixed, table):
        s = fixed.speed * t
        y = height(s, kink, fixed.road, table)
        y_dot = slope(s, kink, fixed.road, table) * fixed.speed
        return y, y_dot, Input(road_input(y, y_dot, fixed.car), fixed.turning.F * w.force.c)

    def steps(rate, x, w, turning, step, n, t, kink, command, fixed, table):
        for k in range(n):
            x, w = given_step(
                rate,
                x,
                w,
                turning,
                step,
                on_road(t + k * step.full, kink, fixed, table),
                on_road(t + (k + 0.5) * step.full, kink, fixed, table),
                on_road(t + (k + 1) * step.full, kink, fixed, table),
                command,
                fixed,
            )
        return x, w

    return Course(begin, amplitudes, phasor, next_kink, jump, after, reading, steps)


# Turning roads by class --------------------------------------------------------------------------


def sine_pieces(p: Any, speed: Any) -> Pieces:
    """Return a `qcar_env.roads.shapes.Sine` in time."""
    return Pieces(p.h, p.wavenumber * speed, p.start / speed, ENDLESS, 0.0, 0.0)


def half_sine_pieces(p: Any, speed: Any) -> Pieces:
    """Return a `HalfSine` in time."""
    omega = p.wavenumber * speed
    duration = math.pi / omega
    return Pieces(p.h, omega, p.start / speed, duration, duration, 1.0)


def step_pieces(p: Any, speed: Any) -> Pieces:
    """Return a `Step` in time."""
    return Pieces(p.h, 0.0, p.start / speed, ENDLESS, 0.0, 1.0)


def train_pieces(p: Any, speed: Any) -> Pieces:
    """Return a `Train` of half sines in time."""
    one = half_sine_pieces(p.shape, speed)
    return Pieces(one.h, one.omega, one.start, one.length, one.length + p.gap / speed, p.count)


def road_functions(kind: type) -> RoadFunctions:
    """Return the compiled interface of a class of roads."""
    road: Any = kind
    if road.turning:
        for known, pieces in (
            (Sine, sine_pieces),
            (HalfSine, half_sine_pieces),
            (Step, step_pieces),
            (Train, train_pieces),
        ):
            if issubclass(kind, known):
                return RoadFunctions(pieces=pieces)
    return RoadFunctions(height=road.height, slope=road.slope, kink=road.kink, jump=road.jump)
