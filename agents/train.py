"""Train an agent from its recipe, in a run folder that explains itself and can be resumed.

A run folder holds

    recipe.json        the recipe and the seed        command.txt    the command that made it
    versions.json      of everything that decides     progress.csv   amplitudes while it learns
    checkpoint.pt      all that training needs to go on (tensors and plain values, no pickled code)
    policy.onnx        the policy, when it is done    result.json    its score and its cost
    learning_curve.png progress as a figure           tensorboard/   the same, and losses

Training runs on one torch thread, its schedules follow environment steps and never the clock:
the same recipe and seed give the same policy on the same machine.
"""

from __future__ import annotations

import dataclasses
import io
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from qcar_env.agents import scoring
from qcar_env.agents.export import export_checked
from qcar_env.agents.recipes import Recipe, as_dict
from qcar_env.agents.scoring import score_all
from qcar_env.agents.trainer import ActorPolicy, Trainer
from qcar_env.envs.episode import observed
from qcar_env.evaluation import storage
from qcar_env.evaluation.agent import Agent
from qcar_env.evaluation.tracks import Episode, episodes
from qcar_env.validation import positive, whole

LIVE = 40.0  # [s] of a live evaluation: steady, the slow mode is at 2e-4 of its size
LIVE_EPISODES = 8  # in a live evaluation where scenarios vary
EVALUATIONS = 10  # live evaluations in a training
FORMAT = 3  # of run folders and checkpoints; a folder of another one is not resumed
DECIDING = ("qcar_env", "numpy", "torch", "stable-baselines3")  # versions that must agree


@dataclass(frozen=True, kw_only=True)
class Progress:
    """One live evaluation."""

    steps: int  # environment steps so far
    wall: float  # training time so far, evaluations aside [s]
    cpu: float  # the same on the processor [s]
    x1: float  # relative amplitude of the wheel, mean over limits and episodes [-]
    x2: float  # of the body [-]
    rho: float  # mean of the larger one [-]

    @property
    def reductions(self) -> tuple[float, float]:
        """How far the amplitudes lie below the uncontrolled ones [dB]."""
        return _db(self.x1), _db(self.x2)


@dataclass(frozen=True, kw_only=True)
class References:
    """What live progress is shown beside: means over the same episodes."""

    cnvc: tuple[float, float]  # [-]
    optimum: float  # rho [-]


@dataclass(frozen=True, kw_only=True)
class Result:
    """A finished training."""

    folder: Path
    steps: int
    wall: float  # [s]
    cpu: float  # [s]
    validation: dict[str, dict[str, float]]  # by force limit
    history: tuple[Progress, ...]


Report = Callable[[Progress, References], None]


def make_trainer(recipe: Recipe, seed: int, tensorboard: str | None = None) -> Trainer:
    """Return the trainer of a recipe."""
    if recipe.algorithm == "cma":
        from qcar_env.agents.search import SearchTrainer

        return SearchTrainer(recipe, seed)
    if recipe.algorithm == "gradient":
        from qcar_env.agents.gradient import GradientTrainer

        return GradientTrainer(recipe, seed)
    from qcar_env.agents.sb3 import SB3Trainer

    return SB3Trainer(recipe, seed, tensorboard)


def train(
    recipe: Recipe,
    seed: int,
    folder: Path,
    *,
    resume: bool = False,
    force: bool = False,
    target_db: float | None = None,
    tensorboard: bool = False,
    report: Report | None = None,
    command: str | None = None,
) -> Result:
    """Train an agent.

    Parameters
    ----------
    recipe : Recipe
        How.
    seed : int
        Of everything that is drawn.
    folder : Path
        The run folder.
    resume : bool
        Go on from the folder's checkpoint.
    force : bool
        Replace a folder that holds a run.
    target_db : float, optional
        Stop when both amplitudes are this far below the uncontrolled ones [dB].
    tensorboard : bool
        Write TensorBoard files (PPO, SAC, TD3: with SB3's own losses).
    report : callable, optional
        Called after each live evaluation.
    command : str, optional
        What is written into command.txt; the command line of this process if left out.

    Returns
    -------
    Result

    Raises
    ------
    ValueError
        If the folder holds a run and neither `resume` nor `force` is given, or what is to be
        resumed is absent, damaged, or from another recipe or version.
    """
    whole("seed", seed, least=0)
    if target_db is not None:
        positive("target", target_db, "dB")
    torch.set_num_threads(1)
    snapshot = _open(
        folder, recipe, seed, resume=resume, force=force, command=command or storage.command()
    )
    logs = str(folder / "tensorboard") if tensorboard else None
    trainer = make_trainer(recipe, seed, logs)
    if snapshot is not None:
        trainer.restore(snapshot["trainer"])
    run = _Run(recipe, folder, trainer, target_db, report, logs)
    if snapshot is not None:
        run.clock.spent_wall, run.clock.spent_cpu = snapshot["wall"], snapshot["cpu"]
        run.history = [Progress(**row) for row in snapshot["history"]]
    run.clock.start()
    trainer.learn(run.hook)
    run.clock.stop()
    run.evaluate()
    run.checkpoint()
    size = len(observed(recipe.track.observe, recipe.observe_limit))
    export_checked(trainer.actor(), size, folder / "policy.onnx")
    found = score_all(Agent(folder), recipe, "validation")
    result = Result(
        folder=folder,
        steps=trainer.steps,
        wall=run.clock.spent_wall,
        cpu=run.clock.spent_cpu,
        validation=found,
        history=tuple(run.history),
    )
    storage.write_json(
        folder / "result.json",
        {
            "recipe": recipe.name,
            "seed": seed,
            "steps": result.steps,
            "wall_s": result.wall,
            "cpu_s": result.cpu,
            "validation": found,
        },
    )
    return result


def check_new(folder: Path, *, force: bool = False) -> None:
    """Raise ValueError where a training cannot begin in a folder (`force`: see `train`)."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"a run needs a folder, got the file {folder}; give another --out")
    if folder.exists() and any(folder.iterdir()) and not force:
        raise ValueError(
            f"{folder} is not empty; resume it with --resume, replace its run with --force, "
            "or give another --out"
        )


def references(recipe: Recipe) -> References:
    """Return CNVC's relative amplitudes and the optimum over the live episodes of a recipe."""
    live = live_episodes(recipe)
    cnvc = [
        scoring.reference("cnvc", recipe.track, scale, drawn).relative.mean(axis=0)
        for scale, drawn in live.items()
    ]
    best = [scoring.optimum(each.scenario) for drawn in live.values() for each in drawn]
    x1, x2 = np.mean(cnvc, axis=0).tolist()
    return References(cnvc=(x1, x2), optimum=float(np.mean(best)))


def live_episodes(recipe: Recipe) -> dict[float, tuple[Episode, ...]]:
    """Return the episodes of a live evaluation by force limit: one from rest, or some draws."""
    count = LIVE_EPISODES if recipe.track.nominal.randomisation else 1
    return {
        scale: episodes(recipe.track, "validation", force_scale=scale, count=count)
        for scale in recipe.force_scales
    }


class _Clock:
    """Time spent on training, evaluations and checkpoints aside."""

    def __init__(self) -> None:
        self.spent_wall = self.spent_cpu = 0.0
        self._wall = self._cpu = 0.0

    def start(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def stop(self) -> None:
        self.spent_wall += time.perf_counter() - self._wall
        self.spent_cpu += time.process_time() - self._cpu
        self.start()


class _Run:
    """What happens between the iterations of a training."""

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        trainer: Trainer,
        target_db: float | None,
        report: Report | None,
        logs: str | None,
    ) -> None:
        self.recipe, self.folder, self.trainer = recipe, folder, trainer
        self.clock = _Clock()
        self.history: list[Progress] = []
        self._target = target_db
        self._report = report
        self._references = references(recipe)
        self._writer: Any = None
        if logs is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(logs)

    def hook(self) -> bool:
        """Evaluate and save where it is time; return whether to go on."""
        due = self.recipe.steps / EVALUATIONS * len(self.history)
        if self.trainer.steps < due:
            return True
        self.clock.stop()
        self.evaluate()
        self.checkpoint()
        self.clock.start()
        latest = self.history[-1]
        return self._target is None or min(latest.reductions) < self._target

    def evaluate(self) -> None:
        """Add a live evaluation to the history."""
        recipe = self.recipe
        if self.history and self.history[-1].steps == self.trainer.steps:
            return
        policy = ActorPolicy(self.trainer.actor())
        found = [
            scoring.run(
                policy, recipe.track, drawn, observe_limit=recipe.observe_limit, duration=LIVE
            )
            for drawn in live_episodes(recipe).values()
        ]
        relative = np.mean([each.relative.mean(axis=0) for each in found], axis=0)
        latest = Progress(
            steps=self.trainer.steps,
            wall=self.clock.spent_wall,
            cpu=self.clock.spent_cpu,
            x1=float(relative[0]),
            x2=float(relative[1]),
            rho=float(np.mean([each.rho.mean() for each in found])),
        )
        self.history.append(latest)
        storage.write_csv(
            self.folder / "progress.csv", [dataclasses.asdict(each) for each in self.history]
        )
        if self._writer is not None:
            for name in ("x1", "x2", "rho"):
                self._writer.add_scalar(f"relative/{name}", getattr(latest, name), latest.steps)
            self._writer.flush()
        if self._report is not None:
            self._report(latest, self._references)

    def checkpoint(self) -> None:
        """Save all that training needs to go on, whole or not at all."""
        content = {
            "format": FORMAT,
            "trainer": self.trainer.snapshot(),
            "wall": self.clock.spent_wall,
            "cpu": self.clock.spent_cpu,
            "history": [dataclasses.asdict(each) for each in self.history],
        }
        packed = io.BytesIO()  # torch's own writing tells no full disk
        torch.save(content, packed)
        with storage.replacing(self.folder / "checkpoint.pt") as path:
            path.write_bytes(packed.getbuffer())


def _open(
    folder: Path, recipe: Recipe, seed: int, *, resume: bool, force: bool, command: str
) -> dict[str, Any] | None:
    """Prepare a run folder; return the snapshot that it is resumed from."""
    described = json.loads(
        json.dumps(
            {
                **as_dict(recipe),
                "seed": seed,
                "format": FORMAT,
                "observe": recipe.track.observe,
                "observe_limit": recipe.observe_limit,
                "force_scales": recipe.force_scales,
                "track": {"name": recipe.track.name, "version": recipe.track.version},
            }
        )
    )
    if resume:
        return _checkpoint(folder, described)
    check_new(folder, force=force)
    for name in ("policy.onnx", "result.json", "checkpoint.pt", "progress.csv"):
        (folder / name).unlink(missing_ok=True)
    storage.write_json(folder / "recipe.json", described)
    storage.write_json(folder / "versions.json", storage.versions())
    storage.write_text(folder / "command.txt", command + "\n")
    return None


def _checkpoint(folder: Path, described: dict[str, Any]) -> dict[str, Any]:
    try:
        before = json.loads((folder / "recipe.json").read_text(encoding="utf-8"))
        made_with = json.loads((folder / "versions.json").read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(
            f"{folder} is no run folder that can be resumed ({error}); start it again with --force"
        ) from None
    if before.get("format") != FORMAT:
        raise ValueError(
            f"{folder} was written in format {before.get('format')}, this version reads {FORMAT}; "
            "start it again with --force, or resume it with the version that made it"
        )
    here = storage.versions()
    for name in DECIDING:
        if made_with.get(name) != here.get(name):
            raise ValueError(
                f"{folder} was made with {name} {made_with.get(name)}, here is {here.get(name)}; "
                "resume it with the versions of its versions.json, or start again with --force"
            )
    if before != described:
        changed = sorted(key for key in described if before.get(key) != described[key])
        raise ValueError(
            f"{folder} was made with another recipe (different: {', '.join(changed)}); "
            "resume it with the version that made it, or start again with --force"
        )
    path = folder / "checkpoint.pt"
    try:
        content = torch.load(path, weights_only=True)
    except FileNotFoundError:
        raise ValueError(f"no checkpoint in {folder}; start it again with --force") from None
    except Exception as error:
        raise ValueError(
            f"{path} is damaged or cut off ({type(error).__name__}); start again with --force"
        ) from error
    return content


def resumed_recipe(folder: Path) -> tuple[str, str, int, int]:
    """Return algorithm, task, seed and steps of a run folder.

    Raises
    ------
    ValueError
        If it is none.
    """
    try:
        found = json.loads((folder / "recipe.json").read_text(encoding="utf-8"))
        return found["algorithm"], found["task"], int(found["seed"]), int(found["steps"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{folder} is no run folder ({type(error).__name__}: {error}); "
            "give one that qcar train made"
        ) from None


def _db(relative: float) -> float:
    return -20.0 * float(np.log10(max(relative, 1e-12)))
