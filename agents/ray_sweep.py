"""Trials of a sweep through Ray Tune, on this machine or a cluster, with early stopping by ASHA."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.schedulers import ASHAScheduler

from qcar_env.agents import trial_runs
from qcar_env.agents.sweep import Row, Trial
from qcar_env.agents.train import EVALUATIONS, Progress
from qcar_env.agents.trial_runs import Tell

LOST = 3  # times that a trial may lose its machine
GRACE = 3  # live evaluations before a trial may be stopped, of EVALUATIONS: a third of a training

os.environ.setdefault("TUNE_DISABLE_AUTO_CALLBACK_LOGGERS", "1")  # the run folders have it all
os.environ.setdefault("RAY_AIR_NEW_OUTPUT", "0")  # which prints whatever it is told
os.environ.setdefault("TUNE_DISABLE_SIGINT_HANDLER", "1")  # commands tell Ctrl-C themselves


def execute(trials: Sequence[Trial], out: Path, tell: Tell, *, early_stop: bool = False) -> None:
    """Run trials on the cluster that has been joined, one core each.

    A trial whose machine is lost goes on from its checkpoint on another.

    Parameters
    ----------
    trials, out, tell
        See `qcar_env.agents.trial_runs.run`.
    early_stop : bool
        Stop what is behind two thirds of the others of its task at a rung (ASHA). Which ones it is
        depends on the order of their results, and so the table does.
    """
    if early_stop and len(tasks := list(dict.fromkeys(each.task for each in trials))) > 1:
        for task in tasks:  # rho of one task says nothing about another's
            execute([each for each in trials if each.task == task], out, tell, early_stop=True)
        return
    scheduler = None
    if early_stop:
        scheduler = ASHAScheduler(
            time_attr="evaluation",
            metric="rho",
            mode="min",
            grace_period=GRACE,
            reduction_factor=3,
            max_t=EVALUATIONS + 2,  # beyond the last one: the end is no stop
        )
    given = tune.with_parameters(_train, trials=list(trials), out=out.absolute())
    with tempfile.TemporaryDirectory(prefix="qcar_env-sweep-") as folder:
        tune.Tuner(
            tune.with_resources(given, {"cpu": 1}),
            param_space={"number": tune.grid_search(list(range(len(trials))))},
            tune_config=tune.TuneConfig(scheduler=scheduler, reuse_actors=True),
            run_config=tune.RunConfig(
                storage_path=folder,  # of Tune's own state; ours is the run folders
                callbacks=[_Told(trials, out, tell)],
                failure_config=tune.FailureConfig(max_failures=LOST),
                verbose=0,
            ),
        ).fit()


def _train(config: dict[str, Any], trials: Sequence[Trial], out: Path) -> None:
    trial = trials[config["number"]]
    count = 0

    def report(progress: Progress) -> None:
        nonlocal count
        count += 1
        tune.report({"evaluation": count, **dataclasses.asdict(progress)})

    try:
        row = trial_runs.run_trial(trial, out, report)
    except Exception as error:  # Tune would try again what fails again
        row = trial_runs.failed(trial, error)
    tune.report(
        {"evaluation": EVALUATIONS + 2, "rho": row.rho, "row": json.dumps(dataclasses.asdict(row))}
    )


class _Told(tune.Callback):
    """Tells the row of each trial when it is over."""

    def __init__(self, trials: Sequence[Trial], out: Path, tell: Tell) -> None:
        self._trials, self._out, self._tell = trials, out, tell

    def on_trial_complete(self, iteration: int, trials: Any, trial: Any, **info: Any) -> None:
        which = self._trials[trial.config["number"]]
        last: dict[str, Any] = trial.last_result or {}
        try:
            if "row" in last:
                row = Row(**json.loads(last["row"]))
            else:
                row = trial_runs.finished(which, self._out) or trial_runs.stop(
                    which, self._out, last
                )
        except (OSError, KeyError) as error:
            row = trial_runs.failed(which, error)
        self._tell(row)

    def on_trial_error(self, iteration: int, trials: Any, trial: Any, **info: Any) -> None:
        which = self._trials[trial.config["number"]]
        lost = trial.get_error() or RuntimeError("it ended without a word")
        self._tell(trial_runs.finished(which, self._out) or trial_runs.failed(which, lost))
