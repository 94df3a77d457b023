"""Model predictive control of a suspension as a policy, which solves its programs with OSQP."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, triu

from qcar_env.control.suspension import STATES
from qcar_env.control.suspension_mpc import SuspensionProgram
from qcar_env.scenarios import Scenario

from .actuation import check_one
from .observation import entries_of, scales_of

Array = NDArray[np.float64]


class SuspensionMPCPolicy:
    """The first force of a program that is solved anew in every control interval, by OSQP.

    Parameters
    ----------
    program : SuspensionProgram
        The program.
    scenario : Scenario
        Gives the units of the observation; its actuator is the one of the program.
    slopes : ndarray (k,)
        Of the road in time, in each control interval since the episode began [m/s].

    Raises
    ------
    ValueError
        If the scenario has no actuator between the masses.
    RuntimeError
        If OSQP is not installed.

    Notes
    -----
    Each car's program is solved by itself, warm started with its own last solution, so that a car
    moves as it would alone. The policy's `state` has solution, multipliers, the force of the
    interval before in limits, and the number of intervals passed.
    """

    name = "MPC"
    reads = STATES

    def __init__(self, program: SuspensionProgram, scenario: Scenario, slopes: Array) -> None:
        try:
            osqp: Any = importlib.import_module("osqp")
        except ImportError:
            raise RuntimeError(
                "MPC solves its programs with OSQP: pip install 'qcar_env[mpc]'"
            ) from None
        check_one(scenario, self.name)
        self._program, self._status = program, osqp.SolverStatus
        self._ahead = program.from_slopes.shape[1]
        self._slopes = np.append(slopes, np.zeros(self._ahead))
        self._scales = scales_of(scenario, self.reads)
        rows, size = program.M.shape
        self._solver: Any = osqp.OSQP()
        self._solver.setup(
            P=csc_matrix(triu(program.H)),
            q=np.zeros(size),
            A=csc_matrix(program.M),
            l=np.full(rows, -np.inf),
            u=np.full(rows, np.inf),
            eps_abs=1e-5,
            eps_rel=1e-5,
            max_iter=20_000,
            check_termination=5,
            adaptive_rho=False,  # it goes by the clock, and leaves its mark on the next car
            rho=0.1,
            polishing=False,
            verbose=False,
        )

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
            If the observation is not (n, k) or (k,), has too few entries, or is not finite.
        RuntimeError
            If a program is not solved.
        """
        entries = entries_of(observation, len(self.reads), self.reads)
        read = np.atleast_2d(entries)[:, : len(self.reads)] * self._scales
        if not np.isfinite(read).all():
            raise ValueError(
                f"observation must be finite, got {read[~np.isfinite(read).all(axis=1)][0]}; "
                "give what the environment returns"
            )
        n, (rows, size) = len(read), self._program.M.shape
        solution, multipliers = np.zeros((n, size)), np.zeros((n, rows))
        before, k = np.zeros(n), np.zeros(n, dtype=np.intp)
        if state is not None:
            fresh = np.zeros(n, dtype=bool) if episode_start is None else np.asarray(episode_start)
            going = ~fresh[:, np.newaxis]
            solution, multipliers = state[0] * going, state[1] * going
            before, k = state[2] * ~fresh, state[3] * ~fresh
        action, found, dual = np.zeros(n), np.zeros((n, size)), np.zeros((n, rows))
        for j in range(n):
            first = min(int(k[j]), len(self._slopes) - self._ahead)
            road = self._slopes[first : first + self._ahead]
            found[j], dual[j] = self._solve(read[j], road, before[j], solution[j], multipliers[j])
            # The solver keeps its tolerance, the actuator its limits.
            change = self._program.change
            action[j] = np.clip(found[j, 0], before[j] - change, before[j] + change)
        action = np.clip(action, -1.0, 1.0)
        shaped = action.astype(np.float32).reshape((*entries.shape[:-1], 1))
        return shaped, (found, dual, action, k + 1)

    def _solve(
        self, xi: Array, slopes: Array, before: float, guess: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        g, low, high = self._program.vectors(xi, slopes, before)
        self._solver.update(q=g, l=low, u=high)
        self._solver.warm_start(x=guess, y=multipliers)
        result, status = self._solver.solve(raise_error=False), self._status
        if result.info.status_val == status.OSQP_SIGINT:  # it keeps Ctrl-C from Python
            raise KeyboardInterrupt
        if result.info.status_val != status.OSQP_SOLVED:
            raise RuntimeError(
                f"OSQP did not solve the program ({result.info.status}); give other weights or a "
                "shorter horizon"
            )
        return np.array(result.x), np.array(result.y)
