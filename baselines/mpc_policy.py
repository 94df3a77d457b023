"""Model predictive control: preview of the road, the optimal steady motion as plan, OSQP."""

from __future__ import annotations

import importlib
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.sparse import csc_matrix, triu

from qcar_env.analysis.optimum import period_optimum
from qcar_env.control.lqr import Weights
from qcar_env.control.mpc import tracking_program
from qcar_env.envs import episode as task
from qcar_env.physics import linear
from qcar_env.scenarios import Scenario, scenario as find_scenario

from .linear_policy import sampled_plant
from .observation import entries_of, scales_of

Array = NDArray[np.float64]

PLAN_SAMPLES = 256  # forces in a period of the plan; 64 leave a kink at every hold
WEIGHTS = Weights(q1=1.0, q2=1.0, r1=1e-2, r2=1e-2)  # chosen here on the validation set
HORIZON = 12  # control intervals, half a period: beyond it the cost to go stands in


class MPCPolicy:
    """MPC on a harmonic road, for any number of cars at once.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road, force, force limit and control interval.
    weights : Weights
        Of the program's cost.
    horizon : int
        Control intervals that the program looks ahead.

    Raises
    ------
    ValueError
        If the plant is not linear, the road not harmonic or an argument out of range.
    RuntimeError
        If OSQP is not installed.

    Notes
    -----
    What it knows of the world: the car, the frequency of road and force, and at each sample the
    present road and force, which it continues as the sinusoids that they are over the horizon.
    The programs of all cars are solved as one, warm started with the last solution, which
    travels in `state` together with the multipliers.
    """

    reads: Literal["full"] = "full"
    name = "MPC"

    def __init__(
        self, scenario: str | Scenario, weights: Weights = WEIGHTS, *, horizon: int = HORIZON
    ) -> None:
        try:
            self._osqp = importlib.import_module("osqp")
        except ImportError:
            raise RuntimeError(
                "MPC solves its programs with OSQP: pip install 'qcar_env[mpc]'"
            ) from None
        scenario = find_scenario(scenario)
        plant = sampled_plant(scenario)
        road, force, dt = scenario.excitation, scenario.force, scenario.dt
        step = linear.exact_transition(scenario.car, road, force, dt)
        scales = scales_of(scenario)
        scale = scales[: task.FEEDBACK_SIZE]
        sizes = np.array([road.h, road.h * road.omega, force.f, force.f * force.Omega])
        shown = scales[task.FEEDBACK_SIZE :]
        self._of_phasors = np.divide(shown, sizes, out=np.zeros(4), where=sizes != 0.0)
        world = np.hstack([step.road, step.force]) / scale[:, np.newaxis]
        turn = block_diag(_turn(road.omega * dt), _turn(force.Omega * dt))
        self._program = tracking_program(plant, world, turn, weights, horizon)
        plan = period_optimum(scenario, samples=PLAN_SAMPLES)
        self._plan_x = plan.x[:-1] / scale
        self._plan_u = plan.u / np.array(scenario.actuator.limit)
        self._omega = road.omega
        self._dt = dt
        self._actions = scenario.actuator.size
        self._solvers: dict[int, Any] = {}

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...]]:
        """Return the actions and the programs' solutions (see `qcar_env.evaluation.policy.Policy`).

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), has fewer than eight entries, or is not
            finite.
        RuntimeError
            If a program is not solved.
        """
        entries = entries_of(observation, task.FULL_SIZE)
        seen = np.atleast_2d(entries)
        if not np.isfinite(seen).all():
            raise ValueError(
                f"observation must be finite, got {seen[~np.isfinite(seen).all(axis=1)][0]}; "
                "give what the environment returns"
            )
        n = len(seen)
        program = self._program
        size = len(program.H)
        if not n:
            nothing = np.empty((0, size))
            return np.empty((0, self._actions), dtype=np.float32), (nothing, nothing)
        # The phasors (s, c) and (S, C) of road and force; F' / (f Omega) is -S.
        s, c, C, minus_S = (seen[:, 4:8] * self._of_phasors).T
        world = np.stack([s, c, -minus_S, C], axis=1)
        phase = np.arctan2(s, c)
        x_plan, u_plan = self._plan(phase)
        linear_term = (
            seen[:, :4] @ program.from_state.T
            + world @ program.from_world.T
            - x_plan @ program.from_plan.T
            - u_plan @ program.from_forces.T
        )
        if state is None:
            guess, multipliers = np.zeros((n, size)), np.zeros((n, size))
        else:
            guess, multipliers = state
            if episode_start is not None:
                going = ~np.asarray(episode_start)[:, np.newaxis]
                guess, multipliers = guess * going, multipliers * going
        solver = self._solver(n)
        solver.update(q=linear_term.ravel())
        solver.warm_start(x=guess.ravel(), y=multipliers.ravel())
        result, status = solver.solve(raise_error=False), self._osqp.SolverStatus
        if result.info.status_val == status.OSQP_SIGINT:  # it keeps Ctrl-C from Python
            raise KeyboardInterrupt
        if result.info.status_val != status.OSQP_SOLVED:
            raise RuntimeError(
                f"OSQP did not solve the program ({result.info.status}); give other weights or a "
                "shorter horizon"
            )
        found = np.asarray(result.x).reshape(n, size)
        action = np.clip(found[:, : self._actions], -1.0, 1.0)
        following = np.hstack([found[:, self._actions :], found[:, -self._actions :]])
        dual = np.asarray(result.y).reshape(n, size)
        dual = np.hstack([dual[:, self._actions :], dual[:, -self._actions :]])
        shaped = action.astype(np.float32).reshape((*entries.shape[:-1], self._actions))
        return shaped, (following, dual)

    def _plan(self, phase: Array) -> tuple[Array, Array]:
        """Return the plan over the horizon from each phase, (n, 4 N) and (n, N m)."""
        count = len(self._plan_x)
        ahead = self._omega * self._dt * np.arange(self._program.horizon + 1)
        at = (phase[:, np.newaxis] + ahead) / (2.0 * np.pi) * count
        low = np.floor(at).astype(np.intp)
        share = (at - low)[:, 1:, np.newaxis]
        left, right = self._plan_x[low[:, 1:] % count], self._plan_x[(low[:, 1:] + 1) % count]
        x = left + share * (right - left)
        # Mean of the plan's force over each interval, from its running integral.
        total = self._integral(at)
        u = np.diff(total, axis=1) / (at[:, 1:] - at[:, :-1])[:, :, np.newaxis]
        n = len(phase)
        return x.reshape(n, -1), u.reshape(n, -1)

    def _integral(self, at: Array) -> Array:
        """Return the integral of the plan's force up to position `at` in samples, (..., m)."""
        count = len(self._plan_u)
        running = np.vstack([np.zeros(self._actions), np.cumsum(self._plan_u, axis=0)])
        turns = np.floor(at / count)
        inside = at - turns * count
        low = np.minimum(np.floor(inside).astype(np.intp), count - 1)
        share = (inside - low)[..., np.newaxis]
        return running[low] + share * self._plan_u[low] + turns[..., np.newaxis] * running[-1]

    def _solver(self, n: int) -> Any:
        if n not in self._solvers:
            solver = self._osqp.OSQP()
            h = block_diag(*[self._program.H] * n)
            size = len(h)
            solver.setup(
                P=csc_matrix(triu(h)),
                q=np.zeros(size),
                A=csc_matrix(np.eye(size)),
                l=-np.ones(size),
                u=np.ones(size),
                eps_abs=1e-4,
                eps_rel=1e-4,
                max_iter=200,
                check_termination=5,
                adaptive_rho=False,
                rho=0.1,
                polishing=False,
                verbose=False,
            )
            self._solvers[n] = solver
        return self._solvers[n]


def _turn(angle: float) -> Array:
    s, c = np.sin(angle), np.cos(angle)
    return np.array([[c, s], [-s, c]])
