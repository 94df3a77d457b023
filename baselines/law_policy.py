"""A control law as a policy that acts once every control interval."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from qcar_env.control.law import Law, check_law
from qcar_env.envs import episode as task
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario as find_scenario

from .actuation import Actuation
from .observation import entries_of, scales_of

Array = NDArray[np.float64]


class LawPolicy:
    """A law of `qcar_env.control`, sampled: it reads the state and sets a held force.

    Parameters
    ----------
    law : Law
        The law with its gains.
    scenario : str or Scenario
        Gives the units of the observation, the actuator and the control interval.
    numbers : NamedTuple of ndarray (n,), optional
        Numbers of n laws of this class, one for each car; all have the filter of `law`.

    Raises
    ------
    ValueError
        If the law, alone, destabilises the scenario's car, or an argument is of another kind.

    Notes
    -----
    The law's filter is carried in `state`, one row a car. It is advanced by its exact solution
    over `dt` for an input that runs straight from the last sample to this one (first-order hold),
    which is what a policy can know.

    One actuator between the masses gives what it can of both forces
    (`qcar_env.baselines.actuation`).
    """

    reads: Literal["feedback"] = "feedback"  # the state only

    def __init__(self, law: Law, scenario: str | Scenario, *, numbers: Any = None) -> None:
        check_law(law)
        scenario = find_scenario(scenario)
        if numbers is None:  # of many laws a bad one shows by what it does
            law.check(scenario.car)
        self.law = law
        self.name = law.name
        self._numbers = law.numbers if numbers is None else numbers
        self._scales = scales_of(scenario, self.reads)
        self._actuation = Actuation(scenario)
        if law.filter_rate is not None:
            self._hold = first_order_hold(*filter_matrices(law), scenario.dt)

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the law's force over its limit, clipped to [-1, 1].

        Parameters
        ----------
        observation : ndarray (n, k) or (k,)
            Observations; the first four entries are read.
        state : tuple of ndarray, optional
            Filter (n, k) and last sample (n, 4).
        episode_start : ndarray (n,) of bool, optional
            Cars whose filter starts from rest.
        deterministic : bool
            Without effect: a law does not draw.

        Returns
        -------
        actions : ndarray (n, m) or (m,) float32
        state : tuple of ndarray or None

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), or has fewer than four entries.
        """
        entries = entries_of(observation, task.FEEDBACK_SIZE)
        x = np.atleast_2d(entries)[:, : task.FEEDBACK_SIZE] * self._scales
        if self.law.filter_rate is None:
            memory = None
            eta = np.zeros((len(x), 0))
        else:
            eta = self._filter(x, state, episode_start)
            memory = (eta, x)
        now = State(*x.T)
        u1, u2 = self.law.command(now, self.law.State(*eta.T), self._numbers)
        actions = self._actuation.actions(u1, u2, now.v2 - now.v1).astype(np.float32)
        return actions.reshape((*entries.shape[:-1], self._actuation.size)), memory

    def _filter(
        self,
        x: Array,
        state: tuple[NDArray[Any], ...] | None,
        episode_start: NDArray[np.bool_] | None,
    ) -> Array:
        if state is None:
            return np.zeros((len(x), len(self._hold[0])))
        eta, last = state
        transition, from_last, from_now = self._hold
        eta = eta @ transition.T + last @ from_last.T + x @ from_now.T
        if episode_start is not None:
            eta = np.where(np.asarray(episode_start)[:, np.newaxis], 0.0, eta)
        return eta


def filter_matrices(law: Law) -> tuple[Array, Array]:
    """Return the law's filter as ``eta' = F eta + G x``: F (k, k) and G (k, 4).

    The matrices are read off `Law.filter_rate`, which is linear, by applying it to unit vectors.
    """
    assert law.filter_rate is not None
    k = len(law.at_rest)
    f = law.filter_rate(State(*np.zeros((4, k))), law.State(*np.eye(k)), law.numbers)
    g = law.filter_rate(State(*np.eye(4)), law.State(*np.zeros((k, 4))), law.numbers)
    return np.array(f), np.array(g)


def first_order_hold(f: Array, g: Array, dt: float) -> tuple[Array, Array, Array]:
    """Discretise ``eta' = F eta + G x`` exactly for an `x` that runs straight between samples.

    Parameters
    ----------
    f, g : ndarray (k, k), (k, j)
        The filter.
    dt : float
        Interval [s].

    Returns
    -------
    transition, from_last, from_now : ndarray
        ``eta(t + dt) = transition eta(t) + from_last x(t) + from_now x(t + dt)``.

    Notes
    -----
    G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed.,
    section 6.3.2 (triangle hold): the matrix exponential of
    ``[[F, G, 0], [0, 0, I/dt], [0, 0, 0]] dt``.
    """
    k, j = g.shape
    m = np.zeros((k + 2 * j, k + 2 * j))
    m[:k, :k], m[:k, k : k + j] = f, g
    m[k : k + j, k + j :] = np.eye(j) / dt
    exact = expm(m * dt)
    ramp = exact[:k, k + j :]
    return exact[:k, :k], exact[:k, k : k + j] - ramp, ramp
