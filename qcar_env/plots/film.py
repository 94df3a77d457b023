"""Films: several policies drive side by side, on the screen or in a file.

All cars meet the same road from the same start.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.rendering import Painter, Window
from qcar_env.evaluation import storage
from qcar_env.evaluation.entry import Entry
from qcar_env.evaluation.policy import shown_to
from qcar_env.physics import linear
from qcar_env.plots.style import Line, line
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.scenario import MOST_INTERVALS
from qcar_env.validation import known, non_negative, positive

Frame = NDArray[np.uint8]
Progress = Callable[[int, int], None]  # frame, of how many
SUFFIXES = (".mp4", ".gif")
GIF_COLOURS = 64
LARGEST = 4096  # [px] side of a car's frame
MOST_FRAMES = 1_000_000  # of a film, chosen here: eleven hours at 25 a second
HALF = "ffmpeg wrote no whole film; is there space on the disk?"
RATES = (0.01, 1000.0)  # [1/s] frames a second that both kinds of file can say


@dataclass(frozen=True, kw_only=True)
class Film:
    """What is filmed.

    Raises
    ------
    ValueError
        If a number is out of range, or a steady start is asked for on a road that ends.
    """

    entries: tuple[Entry, ...]  # who drives, from left to right
    scenario: Scenario  # what is crossed
    force_scale: float  # force limit over the scenario's own [-]
    duration: float  # simulated time [s]
    start: str  # "steady": in the steady motion without control, or at "rest"
    wait: float  # time before the policies begin to act [s]
    slow: float  # seconds of film for a simulated second [-]
    fps: float  # frames a second wanted; the nearest rate with whole control intervals is taken
    size: tuple[int, int]  # width and height of each car's frame [px]

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
        if not 2 <= self.length <= MOST_FRAMES or not slowest <= self.rate <= fastest:
            raise ValueError(
                f"film must have 2 to {MOST_FRAMES} frames, and {slowest:g} to {fastest:g} of them "
                f"a second, got {self.length} at {self.rate:.3g} a second; change duration, fps or "
                "slow"
            )
        if self.start == "steady" and not self.scenario.excitation.harmonic:
            raise ValueError(
                f"a steady start needs an endless road, got scenario {self.scenario.name!r}; "
                "use --start rest"
            )

    @property
    def stride(self) -> int:
        """Control intervals from frame to frame."""
        frames = self.fps * self.slow * self.scenario.dt  # in a control interval
        return max(1, round(1.0 / max(frames, 1.0 / MOST_INTERVALS)))

    @property
    def rate(self) -> float:
        """Frames a second at which the film has the wanted speed."""
        return 1.0 / (self.stride * self.scenario.dt * self.slow)

    @property
    def length(self) -> int:
        """Number of frames."""
        intervals = round(min(self.duration / self.scenario.dt, MOST_INTERVALS))
        return intervals // self.stride + 1


def frames(film: Film, progress: Progress = lambda number, length: None) -> Iterator[Frame]:
    """Run all cars and yield their frames side by side, arrays (height, n * width, 3).

    After each one `progress` is told its number, and how many there are.
    """
    note = "" if film.slow == 1.0 else f"{film.slow:g} x slow motion"
    painters = [Painter(film.size) for _ in film.entries]
    drives = [drive(each, film) for each in film.entries]
    for number, envs in enumerate(zip(*drives, strict=True), start=1):
        row: list[Frame] = []
        for style, painter, env in zip(map(look, film.entries), painters, envs, strict=True):
            named = {"name": style.label, "colour": style.color, "note": note}
            row.append(painter.draw(dataclasses.replace(env.picture(), **named)))
        yield np.concatenate(row, axis=1)
        progress(number, film.length)


def show(film: Film) -> None:
    """Play the film on the screen until it ends or its window is closed."""
    window = Window(" vs ".join(each.name for each in film.entries))
    try:
        for frame in frames(film):
            if not window.show(frame, film.rate):
                break
    finally:
        window.close()


def write(film: Film, out: Path, progress: Progress = lambda number, length: None) -> None:
    """Write the film as MP4 (H.264) or GIF, and report after each frame.

    Raises
    ------
    ValueError
        If the file's name says neither.
    """
    known("film format", out.suffix, SUFFIXES)
    storage.check_file(out)
    with storage.replacing(out) as temporary:
        (_write_gif if out.suffix == ".gif" else _write_mp4)(film, temporary, progress)


def _write_mp4(film: Film, path: Path, progress: Progress) -> None:
    """Write the film and read it again: ffmpeg writes a part without a word on a full disk."""
    imageio: Any = importlib.import_module("imageio.v2")
    ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    given: dict[str, Any] = {"codec": "libx264", "quality": 7, "macro_block_size": 2}
    try:
        with imageio.get_writer(
            path, format="FFMPEG", fps=film.rate, ffmpeg_log_level="quiet", **given
        ) as writer:
            for frame in frames(film, progress):
                writer.append_data(frame)
    except OSError as error:  # of imageio its words are the whole log of ffmpeg
        raise (OSError(HALF) if "FFMPEG" in str(error) else error) from None
    try:
        ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:
        raise OSError(HALF) from None


def _write_gif(film: Film, path: Path, progress: Progress) -> None:
    """Write one palette for all frames and no dither, so that what rests costs nothing."""
    pictures = [Image.fromarray(frame) for frame in frames(film, progress)]
    samples = pictures[:: max(1, len(pictures) // 6)]
    together = Image.fromarray(np.concatenate([np.asarray(each) for each in samples]))
    palette = together.quantize(GIF_COLOURS, method=Image.Quantize.MEDIANCUT)
    indexed = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    indexed[0].save(
        path, save_all=True, append_images=indexed[1:], duration=1000.0 / film.rate, loop=0
    )


def drive(entry: Entry, film: Film) -> Iterator[QuarterCarHumpEnv]:
    """Run one car and yield its environment once a frame."""
    scenario = dataclasses.replace(film.scenario, randomisation=())
    policy = entry.make(scenario.with_force_scale(film.force_scale), None, film.force_scale)
    reads, limit = shown_to(policy, "full")
    env = QuarterCarHumpEnv(
        scenario,
        observe=reads,
        observe_limit=limit,
        force_scale=film.force_scale,
        duration=film.duration + 1.0,
    )
    state = np.zeros(4)
    if film.start == "steady":
        state = linear.steady_state(scenario.car, scenario.excitation, scenario.force).state(0.0)
    observation, _ = env.reset(seed=0, options={"state": state, "phase": 0.0})
    rest = np.zeros(scenario.actuator.size, dtype=np.float32)
    memory: Any = None
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


def look(entry: Entry) -> Line:
    """Return colour and label of an entry: a tuned law has its law's, all agents have one."""
    if entry.kind == "published":
        return line(entry.name)
    if entry.kind == "tuned":
        style = line(entry.name.removesuffix(" (tuned)"))
        return style._replace(label=f"{style.label}, tuned")
    return line("learned")._replace(label=entry.title)
