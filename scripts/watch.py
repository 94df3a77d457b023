"""Watch policies drive side by side, on the screen or in a file.

    python scripts/watch.py --policy cnvc --vs none
    python scripts/watch.py --policy cnvc --vs none lnvc --out results/watch/three.gif
    python scripts/watch.py --policy runs/sac-paper-seed0 --vs none cnvc

All cars meet the same road from the same start. By default they swing as without control, and the
policies begin to act after half a second.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents import load as agents
from baselines import catalogue
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation import storage
from qcar_env.evaluation.policy import Policy
from qcar_env.physics import linear
from qcar_env.plots.style import Line, line
from qcar_env.scenarios import SCENARIOS, Scenario, scenario as find_scenario
from qcar_env.validation import known, non_negative, positive

Frame = NDArray[np.uint8]
SUFFIXES = (".mp4", ".gif")
GIF_COLOURS = 64
LARGEST = 4096  # [px] side of a car's frame
RATES = (0.01, 1000.0)  # [1/s] frames a second that both kinds of file can say
TUNED = "-tuned"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Film:
    """What is filmed.

    Parameters
    ----------
    policies : tuple of str
        Names, from left to right.
    scenario : Scenario
        What is crossed.
    force_scale : float
        Force limit over the scenario's own [-].
    duration : float
        Simulated time [s].
    start : {"steady", "rest"}
        Begin in the steady motion without control, or at rest.
    wait : float
        Time before the policies begin to act [s].
    slow : float
        Seconds of film for a simulated second [-].
    fps : float
        Frames a second wanted; the film gets the nearest rate with whole control intervals.
    size : tuple of int
        Width and height of each car's frame [px].

    Raises
    ------
    ValueError
        If a number is out of range, or a steady start is asked for on a road that ends.
    """

    policies: tuple[str, ...]
    scenario: Scenario
    force_scale: float
    duration: float
    start: str
    wait: float
    slow: float
    fps: float
    size: tuple[int, int]

    def __post_init__(self) -> None:
        """Check every number."""
        positive("force scale", self.force_scale)
        positive("duration", self.duration, "s")
        non_negative("wait", self.wait, "s")
        positive("slow", self.slow)
        positive("fps", self.fps, "1/s")
        known("start", self.start, ("steady", "rest"))
        if max(self.size) > LARGEST:
            raise ValueError(
                f"size must be at most {LARGEST} px wide and high, got {self.size[0]} x "
                f"{self.size[1]}; give a smaller one"
            )
        slowest, fastest = RATES
        if self.length < 2 or not slowest <= self.rate <= fastest:
            raise ValueError(
                f"film must have two frames or more, and {slowest:g} to {fastest:g} of them a "
                f"second, got {self.length} at {self.rate:.3g} a second; change duration, fps or "
                "slow"
            )
        if self.start == "steady" and self.scenario.road.profile != "harmonic":
            raise ValueError(
                f"a steady start needs an endless road, got scenario {self.scenario.name!r}; "
                "use --start rest"
            )

    @property
    def stride(self) -> int:
        """Control intervals from frame to frame."""
        return max(1, round(1.0 / (self.fps * self.slow * self.scenario.dt)))

    @property
    def rate(self) -> float:
        """Frames a second at which the film has the wanted speed."""
        return 1.0 / (self.stride * self.scenario.dt * self.slow)

    @property
    def length(self) -> int:
        """Number of frames."""
        return round(self.duration / self.scenario.dt) // self.stride + 1


def main(argv: Sequence[str] | None = None) -> int:
    """Show or write the film; return the exit status."""
    arguments = _parse(argv)
    try:
        film = _film(arguments)
        out = arguments.out
        if out is None and not _has_display():
            out = Path("results/watch") / ("-vs-".join(film.policies) + ".mp4")
        if out is None:
            show(film)
        else:
            write(film, out)
            print(
                f"written to {out}: {film.length / film.rate:.1f} s, "
                f"{film.slow:g} times slower than real time, {out.stat().st_size / 1e6:.1f} MB"
            )
    except (ValueError, RuntimeError) as error:  # the latter: what a policy needs is absent
        print(f"watch: {error}", file=sys.stderr)
        return 2
    return 0


def frames(film: Film) -> Iterator[Frame]:
    """Run all cars and yield their frames side by side, arrays (height, n * width, 3)."""
    from qcar_env.envs.rendering import Painter

    note = "" if film.slow == 1.0 else f"{film.slow:g} x slow motion"
    painters = [Painter(film.size) for _ in film.policies]
    drives = [_drive(name, film) for name in film.policies]
    for envs in zip(*drives, strict=True):
        row = []
        for name, painter, env in zip(film.policies, painters, envs, strict=True):
            style = look(name)
            picture = dataclasses.replace(
                env.picture(), name=style.label, colour=style.color, note=note
            )
            row.append(painter.draw(picture))
        yield np.concatenate(row, axis=1)


def show(film: Film) -> None:
    """Play the film on the screen until it ends or its window is closed."""
    from qcar_env.envs.rendering import Window

    window = Window(" vs ".join(film.policies))
    try:
        for frame in frames(film):
            if not window.show(frame, film.rate):
                break
    finally:
        window.close()


def write(film: Film, out: Path) -> None:
    """Write the film as MP4 (H.264) or GIF.

    Raises
    ------
    ValueError
        If the file's name says neither.
    """
    known("film format", out.suffix, SUFFIXES)
    storage.check_file(out)
    with storage.replacing(out) as temporary:
        if out.suffix == ".gif":
            _write_gif(film, temporary)
        else:
            _write_mp4(film, temporary)


def _write_mp4(film: Film, path: Path) -> None:
    import imageio.v2 as imageio

    with imageio.get_writer(
        path, format="FFMPEG", fps=film.rate, codec="libx264", quality=7, macro_block_size=2
    ) as writer:
        for number, frame in enumerate(frames(film), start=1):
            writer.append_data(frame)
            _progress(number, film.length)


def _write_gif(film: Film, path: Path) -> None:
    """Write one palette for all frames and no dither, so that what rests costs nothing."""
    from PIL import Image

    pictures = []
    for number, frame in enumerate(frames(film), start=1):
        pictures.append(Image.fromarray(frame))
        _progress(number, film.length)
    samples = pictures[:: max(1, len(pictures) // 6)]
    together = Image.fromarray(np.concatenate([np.asarray(each) for each in samples]))
    palette = together.quantize(GIF_COLOURS, method=Image.Quantize.MEDIANCUT)
    indexed = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    indexed[0].save(
        path, save_all=True, append_images=indexed[1:], duration=1000.0 / film.rate, loop=0
    )


def _drive(name: str, film: Film) -> Iterator[QuarterCarHumpEnv]:
    """Run one car and yield its environment once a frame."""
    scenario = dataclasses.replace(film.scenario, randomisation=None)
    policy = find_policy(name, scenario, film.force_scale)
    env = QuarterCarHumpEnv(
        scenario,
        observe=getattr(policy, "reads", "full"),
        observe_limit=getattr(policy, "observe_limit", False),
        force_scale=film.force_scale,
        duration=film.duration + 1.0,
    )
    state = np.zeros(4)
    if film.start == "steady":
        state = linear.steady_state(scenario.car, scenario.road, scenario.force).state(0.0)
    observation, _ = env.reset(seed=0, options={"state": state, "phase": 0.0})
    rest = np.zeros(scenario.actuator.size, dtype=np.float32)
    memory = None
    over = False
    yield env
    begin = round(film.wait / scenario.dt)
    for k in range((film.length - 1) * film.stride):
        action = rest
        if k >= begin and not over:
            actions, memory = policy.predict(
                observation[np.newaxis], state=memory, episode_start=np.array([k == begin])
            )
            action = np.asarray(actions)[0]
        if not over:  # a car that left its travel limit stays where it did
            observation, _, terminated, _, _ = env.step(action)
            over = terminated
        if (k + 1) % film.stride == 0:
            yield env


def find_policy(name: str, scenario: Scenario, force_scale: float) -> Policy:
    """Return a policy by name: a baseline, a tuned one, a shipped agent, or a run folder.

    Parameters
    ----------
    name : str
        As ``cnvc``, ``lnvc-tuned``, ``sac-paper`` or ``runs/sac-paper-seed0``.
    scenario : Scenario
        What it acts in.
    force_scale : float
        Force limit over the scenario's own [-].

    Raises
    ------
    ValueError
        If there is none; the message gives the nearest name and the list.
    """
    limited = scenario.with_force_scale(force_scale)
    baseline = name.removesuffix(TUNED)
    if name in catalogue.everything():
        return catalogue.make(name, limited)
    if name.endswith(TUNED) and baseline in catalogue.everything():
        return catalogue.make_tuned(
            baseline, _tuned_on(baseline, force_scale), force_scale, limited
        )
    if Path(name).is_dir() or name in agents.names():
        return agents.load(name)
    known("policy", name, policies())
    raise AssertionError  # `known` has raised


def policies() -> tuple[str, ...]:
    """Return the names of all policies."""
    tuned = dict.fromkeys(f"{name}{TUNED}" for name, _, _ in catalogue.tuned())
    return (*catalogue.everything(), *tuned, *agents.names())


def look(name: str) -> Line:
    """Return colour and label of a policy: a tuned law has its law's, all agents have one."""
    if name.endswith(TUNED):
        style = line(name.removesuffix(TUNED))
        return style._replace(label=f"{style.label}, tuned")
    if name in catalogue.everything():
        return line(name)
    return line("learned")._replace(label=Path(name).name)


def _tuned_on(baseline: str, force_scale: float) -> str:
    """Return the track on which a baseline was tuned at a force limit."""
    tracks = [
        track
        for name, track, scale in catalogue.tuned()
        if name == baseline and scale == force_scale
    ]
    return min(tracks, key=lambda track: track != "budget", default="budget")


def _film(arguments: argparse.Namespace) -> Film:
    scenario = find_scenario(arguments.scenario)
    harmonic = scenario.road.profile == "harmonic"
    width, height = arguments.size
    return Film(
        policies=(arguments.policy, *arguments.vs),
        scenario=scenario,
        force_scale=arguments.force_scale,
        duration=scenario.duration if arguments.duration is None else arguments.duration,
        start=arguments.start or ("steady" if harmonic else "rest"),
        wait=(0.5 if harmonic else 0.0) if arguments.wait is None else arguments.wait,
        slow=arguments.slow,
        fps=arguments.fps,
        size=(width, height),
    )


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--policy",
        default="cnvc",
        help=f"who drives: {', '.join(policies())}, or a run folder of scripts/train.py "
        "(default: cnvc)",
    )
    parser.add_argument(
        "--vs", nargs="*", default=["none"], metavar="POLICY", help="beside whom (default: none)"
    )
    parser.add_argument(
        "--scenario", default="paper", help=f"{', '.join(SCENARIOS)} (default: paper)"
    )
    parser.add_argument(
        "--force-scale", type=float, default=1.0, help="force limit over the scenario's [-]"
    )
    parser.add_argument(
        "--duration", type=float, help="simulated time [s] (default: the scenario's)"
    )
    parser.add_argument(
        "--start",
        choices=("steady", "rest"),
        help="begin in the steady motion without control, or at rest (default: steady on an "
        "endless road)",
    )
    parser.add_argument(
        "--wait",
        type=float,
        help="time before the policies act [s] (default: 0.5 on an endless road, else 0)",
    )
    parser.add_argument(
        "--slow", type=float, default=4.0, help="slow motion: film over real time [-] (default: 4)"
    )
    parser.add_argument("--fps", type=float, default=25.0, help="frames a second (default: 25)")
    parser.add_argument(
        "--size",
        type=int,
        nargs=2,
        default=(640, 480),
        metavar=("WIDTH", "HEIGHT"),
        help="of each car's frame [px] (default: 640 480)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="file ending in .mp4 or .gif (default: the screen; without a display a file in "
        "results/watch)",
    )
    return parser.parse_args(argv)


def _has_display() -> bool:
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _progress(number: int, length: int) -> None:
    if sys.stderr.isatty() and (number % 20 == 0 or number == length):
        end = "\n" if number == length else ""
        print(f"\r... frame {number} of {length}", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
