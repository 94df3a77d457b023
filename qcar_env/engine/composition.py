"""What a fleet is compiled for, and what it is made from.

A car's numbers lie in three slabs: what moves, its clock (in double precision whatever the rest
has), and what stays the same during an episode. Their rows are computed from the named tuples that
lie there (`qcar_env.engine.layout`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from qcar_env.engine.course import RoadFunctions
from qcar_env.engine.sensing import Sensed
from qcar_env.engine.starts import Nominal
from qcar_env.physics import tree
from qcar_env.physics.car import CarFunctions
from qcar_env.physics.signals import Signal


@dataclass(frozen=True)
class Composition:
    """What is compiled: classes and functions, no numbers."""

    car: CarFunctions
    road: RoadFunctions
    actuator: type
    observed: tuple[Signal, ...]
    terms: tuple[type, ...]  # of the reward
    delay: int  # of the actuator [intervals]
    sensed: tuple[Sensed | None, ...]  # how each entry of the observation is read
    like: Nominal  # shapes of the numbers; their values do not matter, and are all 1 here

    def __post_init__(self) -> None:
        """Forget the values, so that equal compositions are equal."""
        ones = tree.unflat(self.like, (1.0,) * len(tree.flat(self.like)))
        object.__setattr__(self, "like", ones)

    @property
    def driven(self) -> Composition:
        """What remains when nothing is observed, and is the same for many compositions."""
        numbers = self.like.numbers._replace(sensors=())
        like = self.like._replace(numbers=numbers, scales=(), terms=(), term_scales=())
        return replace(self, observed=(), terms=(), delay=0, sensed=(), like=like)


# A fleet in compiled code ------------------------------------------------------------------------


class Moved(NamedTuple):
    """The arrays that a step takes."""

    slabs: Any  # (blocks, rows * LANES) what moves
    clocks: Any  # (blocks, rows * LANES)
    fixed: Any  # (1 or blocks, rows * LANES) one slab where all cars have the same numbers
    blocks: Any  # (blocks, 3) see `OWN_FIXED`
    tables: Any  # (e,) of all roads
    bounds: Any  # (n, 2) where each car's table lies there
    dt: Any  # control interval [s]
    substeps: Any  # Runge-Kutta steps in it


class Scratch(NamedTuple):
    """What a thread passes on within an interval."""

    numbers: Any  # (rows * LANES,)
    stages: Any  # (rows * LANES,) what a road that is read does at the stage times
    shown: Any  # (entries * LANES,) of float32, observations


class Drawn(NamedTuple):
    """The arrays that episodes are drawn from."""

    streams: Any  # (n, 4) random streams
    chosen: Any  # (n,) which source a car draws its next episode from
    nominals: Any  # (sources, k) `qcar_env.engine.starts.Nominal`
    draws: Any  # (sources, d, e) distributions, see `qcar_env.engine.starts.drawn`
    targets: Any  # (t, 3) what they change, see `qcar_env.engine.starts.vary`
    counts: Any  # (sources, 3) uniform numbers that an episode takes; first and last target
    uniforms: Any  # (n, most) what episodes were drawn from
    row: Any  # (k,) room for one of `nominals`, as drawn


# Of a block: which of `fixed` is its own, for how many intervals none of its cars can meet a kink,
# and whether the episode of one is over.
OWN_FIXED, QUIET, ENDED = range(3)


class Block(NamedTuple):
    """A block of cars, within compiled code."""

    first: Any  # number of its first car
    own: Any  # row of `Fleet.blocks`
    z: Any  # slab of what moves
    clock: Any
    p: Any  # slab of what stays the same
    s: Any  # scratch
    stages: Any
    shown: Any  # observations, in single precision
    lanes: Any  # cars in it
    tables: Any
    bounds: Any  # of the block's cars
    dt: Any
    n: Any
