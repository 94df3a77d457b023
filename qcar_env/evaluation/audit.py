"""What no force between the masses can change: an audit of a stored drive.

Whatever pushes between wheel and body, linear or not, learned or not, wheel and body together see
the road alone:

    m1 x1'' + m2 x2'' = k (y - x1) + c (y' - x1') + m2 F.

Multiply by e^(-s t) and integrate over any window, by parts. Let A, Y, D, F be the integrals of
x2'', y, x2 - x1 and F times e^(-s t), ``p = v + s x``, and [.] its end less its beginning:

    wheel hop   m1 s^2 + c s + k = 0
                m2 A = (k + c s) Y + m2 F - [(m1 p1 + c (x1 - y)) e^(-s t)]
    travel      (m1 + m2) s^2 + c s + k = 0
                m2 s^2 D = (k + c s) Y + m2 F - [(m1 p1 + m2 p2 + c (x1 - y)) e^(-s t)]
    momentum    of any tyre
                int (load - static) dt = [m1 v1 + m2 v2] - m2 int F dt

From rest to rest the brackets vanish. Without damping s is ``j sqrt(k / m1)``, the frequency of
wheel hop, and ``j sqrt(k / (m1 + m2))``: what no controller changes there. Damping of the tyre
takes both off the imaginary axis (S. Turkay, H. Akcay, Journal of Sound and Vibration 311, 2008,
440); the law holds on at the complex s.

Beside these the stored numbers must fit each other: acceleration, force and travel, load and road
at every instant; acceleration and velocity, velocity and displacement; force and limit; and a
semi-active damper only takes energy out.

Residuals of integrals are the largest of windows of a quarter of a second. Their tolerance is what
sampling may miss: for integrals by trapezoids a quarter of the second differences, three times what
they miss of a smooth motion and twice what they can of a bend between two samples; for the others,
over each two intervals, what they change by when the sample between is left out. A force that
jumps at the samples, or gets from one to the next in its own way, hides a bend in each interval
alike, and adds to it; so does rounding. A drive that passes obeys mechanics; that it was driven, by
the policy that is said, is not shown.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.evaluation.fine import cubic, measurable
from qcar_env.evaluation.rollouts import Rollout
from qcar_env.parts.part import Nothing
from qcar_env.parts.tyre import LiftOffTyre, LinearTyre
from qcar_env.physics.car import GRAVITY
from qcar_env.roads.profile import Road

Array = NDArray[np.float64]

AUDIT_SIGNALS = ("body_acceleration", "tyre_load")  # that a rollout must keep
WINDOW = 0.25  # [s], chosen here: two periods of a hopping wheel
NODES = 8  # of Gauss and Legendre in a control interval, chosen here
LONG_AGO = 1e9  # [m] before the start: no road of ours begins earlier
ROUNDING = 1e-6  # of the sums that are compared: signals are kept to single precision [-]


@dataclass(frozen=True, kw_only=True)
class Check:
    """One law: how far a drive is from it, and how far sampling can make it seem."""

    residual: float
    tolerance: float
    unit: str

    @property
    def ok(self) -> bool:
        """Whether the residual is within the tolerance; False where it is no number."""
        return self.residual <= self.tolerance


@dataclass(frozen=True, kw_only=True)
class Audit:
    """The laws that apply, and why others do not."""

    checks: Mapping[str, Check]
    left_out: Mapping[str, str]

    @property
    def ok(self) -> bool:
        """Whether all hold."""
        return all(each.ok for each in self.checks.values())


def audit(rollout: Rollout) -> Audit:
    """Check a stored drive against laws of mechanics.

    Parameters
    ----------
    rollout : Rollout
        With the signals `AUDIT_SIGNALS`, of a `QuarterCar` whose actuator pushes between the
        masses; of four control intervals or more.

    Returns
    -------
    Audit
        At every instant ``body_force``, ``tyre_load``, ``force`` or, of a semi-active damper,
        ``energy``; of windows ``body_acceleration``, ``body_velocity``, ``wheel_velocity``,
        ``wheel_hop``, ``travel``, ``momentum``. Wheel hop and travel are left out for a tyre that
        lifts off or is not linear, momentum where the road jumps under a damped tyre.

    Raises
    ------
    ValueError
        If signals were not kept, the drive is too short, the car has no masses or the actuator
        pushes against the ground.
    """
    car = measurable(rollout, AUDIT_SIGNALS)
    scenario = rollout.scenario
    if len(rollout.t) < 4:
        raise ValueError(
            f"the rollout must last four control intervals, got {len(rollout.t)}; drive longer"
        )
    left_out: dict[str, str] = {}
    laws: dict[str, tuple[_Law, str]] = {
        "body_acceleration": (_body_acceleration, "m/s"),
        "body_velocity": (_body_velocity, "m"),
        "wheel_velocity": (_wheel_velocity, "m"),
    }
    tyre: Any = car.tyre
    lifts = bool(np.min(rollout.signals["tyre_load"]) <= 0.0)
    if not isinstance(tyre, (LinearTyre, LiftOffTyre)):
        left_out |= dict.fromkeys(("wheel_hop", "travel"), "the tyre is not linear")
    elif isinstance(tyre, LiftOffTyre) and lifts:
        left_out |= dict.fromkeys(("wheel_hop", "travel"), "the tyre lifts off")
    else:
        laws["wheel_hop"] = (_wheel_hop, "N s")
        laws["travel"] = (_travel, "N s")
    if getattr(tyre, "c", 0.0) and _jumps(scenario.road, scenario.speed * float(rollout.t[-1])):
        left_out["momentum"] = "the road jumps under a damped tyre"
    else:
        laws["momentum"] = (_momentum, "N s")
    windows = list(_windows(rollout))
    checks = {name: _check(law, unit, windows) for name, (law, unit) in laws.items()}
    checks |= {"body_force": _body_force(rollout, car), "tyre_load": _tyre_load(rollout, car)}
    force, power = rollout.force[:, -1], rollout.force[:, -1] * (rollout.v2 - rollout.v1)
    if hasattr(scenario.actuator, "c_max"):
        rounding = 1e-9 * float(np.abs(power).max())
        checks["energy"] = Check(residual=float(power.max()), tolerance=rounding, unit="W")
    else:
        limit = scenario.actuator.limit[0]
        largest = float(np.abs(force).max())
        checks["force"] = Check(residual=largest, tolerance=(1.0 + ROUNDING) * limit, unit="N")
    return Audit(checks=checks, left_out=left_out)


def _force(part: Any, *moved: Array) -> Any:
    return type(part).force(*moved, part.numbers)


def _body_force(rollout: Rollout, car: Any) -> Check:
    """Compare mass times acceleration with the forces on the body, at every instant."""
    travel, rate = rollout.x2 - rollout.x1, rollout.v2 - rollout.v1
    forces = (
        rollout.force[:, -1],
        -_force(car.spring, travel),
        -_force(car.damper, rate),
        -_force(car.stops, travel) + 0.0 * travel,
        car.m2 * rollout.scenario.force.value(rollout.t),
    )
    off = car.m2 * rollout.signals["body_acceleration"] - np.sum(forces, axis=0)
    return _at_instants(off, sum(np.abs(each).max() for each in forces))


def _tyre_load(rollout: Rollout, car: Any) -> Check:
    """Compare the load with the tyre's force, at every instant that is not on a kink."""
    scenario, static = rollout.scenario, (car.m1 + car.m2) * GRAVITY
    on = scenario.excitation
    t = rollout.t + (rollout.phase / on.omega if on.harmonic else 0.0)
    compressed, rate = on.height(t) - rollout.x1, on.rate(t) - rollout.v1
    load = static + type(car.tyre).force(compressed, rate, static, car.tyre.numbers)
    kinks = np.array(on.kinks(-scenario.dt, float(t[-1]) + scenario.dt))
    near = np.abs(t[:, np.newaxis] - kinks).min(axis=1, initial=np.inf) <= ROUNDING * scenario.dt
    off = np.where(near, 0.0, rollout.signals["tyre_load"] - load)
    return _at_instants(off, static + float(np.abs(load).max()))


def _at_instants(off: Array, size: float) -> Check:
    return Check(residual=float(np.abs(off).max()), tolerance=ROUNDING * float(size), unit="N")


def _jumps(road: Road, last: float) -> bool:
    """Return whether a road's height jumps before the distance `last` [m]."""
    pieces = range(len(road.kinks(-LONG_AGO, last)))
    return any(type(road).jump(piece, road.numbers, road.table) for piece in pieces)


# Windows ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Window:
    """Some samples of a drive, every one or every second; times from the first of them."""

    rollout: Rollout
    h: float  # between samples [s]
    t: Array  # (k,)
    x1: Array
    x2: Array
    v1: Array
    v2: Array
    a: Array
    load: Array
    force: Array
    given: float  # integral of a held force over the window [N s], 0 for one that is not held
    held: bool
    steps: float  # all changes of the force from one sample to the next [N]

    @property
    def car(self) -> Any:
        return self.rollout.scenario.car


def _windows(rollout: Rollout) -> Any:
    """Yield windows, each with all samples and with every second one."""
    scenario = rollout.scenario
    dt, count = scenario.dt, len(rollout.t) - 1  # the first sample is the end of an interval
    size = 2 * max(1, min(round(0.5 * WINDOW / dt), count // 2))
    held = bool(scenario.actuator.linear) and scenario.actuator.State is Nothing
    for start in (*range(0, count - size, size), count - size):
        all_of = slice(start, start + size + 1)
        force = rollout.force[all_of, -1]

        def window(step: int, all_of: slice = all_of, force: Array = force) -> _Window:
            def of(values: Array) -> Array:
                return np.asarray(values, dtype=np.float64)[all_of][::step]

            return _Window(
                rollout=rollout,
                h=dt * step,
                t=of(rollout.t),
                x1=of(rollout.x1),
                x2=of(rollout.x2),
                v1=of(rollout.v1),
                v2=of(rollout.v2),
                a=of(rollout.signals["body_acceleration"]),
                load=of(rollout.signals["tyre_load"]),
                force=force[::step],
                given=float(force[1:].sum()) * dt if held else 0.0,
                held=held,
                steps=float(np.abs(np.diff(force)).sum()),
            )

        yield window(1), window(2)


def _check(law: _Law, unit: str, windows: list[tuple[_Window, _Window]]) -> Check:
    residual = tolerance = 0.0
    for all_samples, every_second in windows:
        found, missed, size = law(all_samples, every_second)
        residual = abs(found) if not abs(found) <= residual else residual  # NaN stays
        tolerance = max(tolerance, missed + ROUNDING * size)
    return Check(residual=float(residual), tolerance=float(tolerance), unit=unit)


# Laws: each returns its residual, what sampling may miss, and the size of what is compared -------

_Law = Callable[[_Window, _Window], tuple[complex, float, float]]


def _sum(h: float, values: Array) -> float:
    """Return the integral by the trapezoidal rule."""
    return h * float(values.sum() - 0.5 * (values[0] + values[-1]))


def _bent(h: float, values: Array) -> float:
    """Return what the trapezoids may miss: of a bend by d in the slope they miss d h^2 / 8."""
    return 0.25 * h * float(np.abs(np.diff(np.pad(values, 1, mode="edge"), 2)).sum())


def _moved(w: _Window, x: Array, v: Array, mass: float) -> tuple[float, float, float]:
    hidden = w.steps * w.h * w.h / (6.0 * mass)  # twice that of a step at either end of an interval
    size = _sum(w.h, np.abs(v)) + float(np.abs(x).max())
    return _sum(w.h, v) - float(x[-1] - x[0]), _bent(w.h, v) + hidden, size


def _body_velocity(w: _Window, coarse: _Window) -> tuple[float, float, float]:
    return _moved(w, w.x2, w.v2, w.car.m2)


def _wheel_velocity(w: _Window, coarse: _Window) -> tuple[float, float, float]:
    return _moved(w, w.x1, w.v1, w.car.m1)


def _body_acceleration(w: _Window, coarse: _Window) -> tuple[float, float, float]:
    """Compare: what a held force does is taken out of the acceleration, which jumps by it.

    Steps of a held force bend what is left through the damper. A force with a memory is between
    its ends in each interval, and may come to the last at once.
    """
    m1, m2 = w.car.m1, w.car.m2
    smooth = w.a - w.force / m2 if w.held else w.a
    share = _damping(w) * w.h * (1.0 / m1 + 1.0 / m2) / 6.0 if w.held else 0.5
    found = _sum(w.h, smooth) + w.given / m2 - float(w.v2[-1] - w.v2[0])
    size = _sum(w.h, np.abs(w.a)) + float(np.abs(w.v2).max())
    return found, _bent(w.h, smooth) + share * w.steps * w.h / m2, size


def _damping(w: _Window) -> float:
    """Return the steepest slope of the damper at the kept rates [N s/m]."""
    rate = w.v2 - w.v1
    step = 1e-3  # [m/s]
    rise = _force(w.car.damper, rate + step) - _force(w.car.damper, rate - step)
    return float(np.abs(rise).max()) / (2.0 * step)


def _momentum(w: _Window, coarse: _Window) -> tuple[float, float, float]:
    m1, m2 = w.car.m1, w.car.m2
    over = w.load - (m1 + m2) * GRAVITY
    p = m1 * w.v1 + m2 * w.v2
    F = m2 * w.rollout.scenario.force.value(w.t)
    k, c = (getattr(w.car.tyre, name, 0.0) for name in ("k", "c"))
    hidden = w.steps / m1 * (c + 0.5 * k * w.h) * w.h * w.h / 6.0
    found = _sum(w.h, over) + _sum(w.h, F) - float(p[-1] - p[0])
    return found, _bent(w.h, over) + _bent(w.h, F) + hidden, _sum(w.h, np.abs(w.load))


def _wheel_hop(w: _Window, coarse: _Window) -> tuple[complex, float, float]:
    m1, m2 = w.car.m1, w.car.m2

    def inside(each: _Window, s: complex) -> Array:
        x2, _ = cubic(each.x2, each.v2, each.h, _INSIDE)
        return m2 * s * s * x2

    def ends(each: _Window, s: complex) -> Any:  # of the acceleration by parts, and of the law
        return m2 * (each.v2 + s * each.x2) + m1 * (each.v1 + s * each.x1)

    return _at_root(m1, inside, ends, w, coarse)


def _travel(w: _Window, coarse: _Window) -> tuple[complex, float, float]:
    m1, m2 = w.car.m1, w.car.m2

    def inside(each: _Window, s: complex) -> Array:
        D, _ = cubic(each.x2 - each.x1, each.v2 - each.v1, each.h, _INSIDE)
        return m2 * s * s * D

    def ends(each: _Window, s: complex) -> Any:
        return m1 * (each.v1 + s * each.x1) + m2 * (each.v2 + s * each.x2)

    return _at_root(m1 + m2, inside, ends, w, coarse)


_nodes, _weights = np.polynomial.legendre.leggauss(NODES)
_INSIDE, _SHARES = 0.5 * (1.0 + _nodes), 0.5 * _weights  # of an interval


def _at_root(
    mass: float, inside: Any, ends: Any, w: _Window, coarse: _Window
) -> tuple[complex, float, float]:
    """Return a law at the root s of ``mass s^2 + c s + k``.

    ``inside(w, s)`` is what is integrated, (k, NODES), less the road's; ``ends(w, s)`` what stands
    in the bracket besides the tyre's damping.
    """
    scenario, tyre = w.rollout.scenario, w.car.tyre
    on, k, c = scenario.excitation, tyre.k, tyre.c
    s = (-c + cmath.sqrt(c * c - 4.0 * mass * k)) / (2.0 * mass)
    offset = w.rollout.phase / on.omega if on.harmonic else 0.0

    def parts(each: _Window) -> Any:
        """Return the integral over each interval."""
        t = each.t[:-1, np.newaxis] + each.h * _INSIDE
        y = on.height((t + offset).ravel()).reshape(t.shape)
        F = scenario.force.value(t.ravel()).reshape(t.shape)
        given = inside(each, s) - (k + c * s) * y - w.car.m2 * F
        return (given * np.exp(-s * (t - each.t[0]))) @ _SHARES * each.h

    fine, rough = parts(w), parts(coarse)
    compressed = on.height(w.t + offset) - w.x1
    bracket = (ends(w, s) - c * compressed) * np.exp(-s * (w.t - w.t[0]))
    missed = float(np.abs(fine.reshape(-1, 2).sum(axis=1) - rough).sum())
    size = float(np.abs(fine).sum() + np.abs(bracket).max())
    return complex(fine.sum() + bracket[-1] - bracket[0]), missed, size
