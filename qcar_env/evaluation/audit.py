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
they change by when every second sample is left out, and rounding: errors of sampling fall by four
or more from there, forged numbers do not care. A drive that passes obeys mechanics; that it was
driven, by the policy that is said, is not shown.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.evaluation.fine import PARTS, cubic
from qcar_env.evaluation.rollouts import Rollout
from qcar_env.parts.part import Nothing
from qcar_env.parts.tyre import LiftOffTyre, LinearTyre
from qcar_env.physics.car import GRAVITY, QuarterCar
from qcar_env.roads.profile import Road

Array = NDArray[np.float64]

AUDIT_SIGNALS = ("body_acceleration", "tyre_load")  # that a rollout must keep
WINDOW = 0.25  # [s], chosen here: two periods of a hopping wheel
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
    scenario = rollout.scenario
    car: Any = scenario.car
    if not isinstance(car, QuarterCar) or scenario.actuator.unit != "N":
        raise ValueError(
            f"the car must have masses and an actuator in newtons, got {type(car).__name__} with "
            f"{type(scenario.actuator).__name__}; give a QuarterCar with a SuspensionActuator"
        )
    missing = [name for name in AUDIT_SIGNALS if name not in rollout.signals]
    if missing or len(rollout.t) < 4:
        raise ValueError(
            f"the rollout must keep {', '.join(AUDIT_SIGNALS)} over four control intervals, got "
            f"{', '.join(rollout.signals) or 'no signals'} over {len(rollout.t)}; roll out with "
            f"signals={AUDIT_SIGNALS}"
        )
    left_out: dict[str, str] = {}
    laws: dict[str, tuple[Callable[[_Window], tuple[complex, float]], str]] = {
        "body_acceleration": (_body_acceleration, "m/s"),
        "body_velocity": (lambda w: _moved(w, w.x2, w.v2), "m"),
        "wheel_velocity": (lambda w: _moved(w, w.x1, w.v1), "m"),
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
            )

        yield window(1), window(2)


def _check(law: Any, unit: str, windows: list[tuple[_Window, _Window]]) -> Check:
    residual = tolerance = 0.0
    for all_samples, every_second in windows:
        (fine, size), (coarse, _) = law(all_samples), law(every_second)
        found = abs(fine)
        residual = found if not found <= residual else residual
        tolerance = max(tolerance, abs(fine - coarse) + ROUNDING * size)
    return Check(residual=float(residual), tolerance=float(tolerance), unit=unit)


# Laws: each returns its residual and the size of what is compared --------------------------------


def _sum(h: float, values: Array) -> float:
    """Return the integral by the trapezoidal rule."""
    return h * float(values.sum() - 0.5 * (values[0] + values[-1]))


def _moved(w: _Window, x: Array, v: Array) -> tuple[float, float]:
    return _sum(w.h, v) - float(x[-1] - x[0]), _sum(w.h, np.abs(v)) + float(np.abs(x).max())


def _body_acceleration(w: _Window) -> tuple[float, float]:
    """Compare: what a held force does is taken out of the acceleration, which jumps by it."""
    smooth = w.a - w.force / w.car.m2 if w.held else w.a
    found = _sum(w.h, smooth) + w.given / w.car.m2 - float(w.v2[-1] - w.v2[0])
    return found, _sum(w.h, np.abs(w.a)) + float(np.abs(w.v2).max())


def _momentum(w: _Window) -> tuple[float, float]:
    m1, m2 = w.car.m1, w.car.m2
    over = w.load - (m1 + m2) * GRAVITY
    p = m1 * w.v1 + m2 * w.v2
    pushed = m2 * _sum(w.h, w.rollout.scenario.force.value(w.t))
    return _sum(w.h, over) + pushed - float(p[-1] - p[0]), _sum(w.h, np.abs(w.load))


def _wheel_hop(w: _Window) -> tuple[complex, float]:
    m2 = w.car.m2
    s, e, ends = _kernel(w, w.car.m1)
    x2, _ = cubic(w.x2, w.v2, w.h, _MIDDLES)
    A = ends(w.v2 + s * w.x2) + s * s * e(x2)  # of the velocity, by parts
    road, size = _road(w, s, e, ends)
    return m2 * A - road + ends(w.car.m1 * (w.v1 + s * w.x1)), size


def _travel(w: _Window) -> tuple[complex, float]:
    m1, m2 = w.car.m1, w.car.m2
    s, e, ends = _kernel(w, m1 + m2)
    D, _ = cubic(w.x2 - w.x1, w.v2 - w.v1, w.h, _MIDDLES)
    road, size = _road(w, s, e, ends)
    momentum = m1 * (w.v1 + s * w.x1) + m2 * (w.v2 + s * w.x2)
    return m2 * s * s * e(D) - road + ends(momentum), size


_MIDDLES = (np.arange(PARTS) + 0.5) / PARTS


def _kernel(w: _Window, mass: float) -> tuple[complex, Any, Any]:
    """Return s, the integral times e^(-s t) of values (k, PARTS), and end less beginning."""
    k, c = w.car.tyre.k, w.car.tyre.c
    s = (-c + cmath.sqrt(c * c - 4.0 * mass * k)) / (2.0 * mass)
    begin = w.t[0]
    inside = np.exp(-s * (w.t[:-1, np.newaxis] - begin + w.h * _MIDDLES))
    last = np.exp(-s * (w.t[-1] - begin))

    def integral(values: Array) -> complex:
        return complex((values * inside).sum()) * w.h / PARTS

    def ends(values: NDArray[Any]) -> complex:
        return complex(values[-1] * last - values[0])

    return s, integral, ends


def _road(w: _Window, s: complex, integral: Any, ends: Any) -> tuple[complex, float]:
    """Return what the road and the external force do, and how much they would without signs."""
    scenario, tyre = w.rollout.scenario, w.car.tyre
    on = scenario.excitation
    offset = w.rollout.phase / on.omega if on.harmonic else 0.0
    inside = w.t[:-1, np.newaxis] + w.h * _MIDDLES
    y = on.height((inside + offset).ravel()).reshape(inside.shape)
    F = scenario.force.value(inside.ravel()).reshape(inside.shape)
    compressed = on.height(w.t + offset) - w.x1
    found = (tyre.k + tyre.c * s) * integral(y) + tyre.c * ends(compressed)
    size = tyre.k * _sum(w.h, np.abs(w.x1)) + w.car.m2 * float(np.abs(w.v2).max())
    return found + w.car.m2 * integral(F), size + tyre.k * _sum(w.h, np.abs(compressed))
