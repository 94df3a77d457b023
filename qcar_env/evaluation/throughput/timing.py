"""Time things against each other, so that a busy machine slows all of them alike.

All candidates run in one process in interleaved rounds; ratios are taken within a round. The clock
is the thread's own processor time. For what is shared out to several threads it is that of the
thread which takes longest, so that a processor shared with other programs does not count as ours;
for what uses threads of its own, or other processes, the wall's, or this process's on the processor
if shorter.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

SLICE = 0.03  # [s] that a candidate runs in a round


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Something that is timed."""

    name: str
    run: Callable[[int], None]  # does so many calls
    steps: int  # environment steps of one call
    alone: bool = True  # whether it is one thread, whose own time on the processor is measured
    spent: Callable[[], float] | None = None  # time [s] of the calls since it was asked last


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Seconds a step in every round."""

    name: str
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median time of a step [s]."""
        return statistics.median(self.seconds)

    def times_faster_than(self, other: Timing) -> tuple[float, float, float]:
        """Return median and quartiles of the ratio of the other's time to ours, round by round."""
        ratios = sorted(b / a for a, b in zip(self.seconds, other.seconds, strict=True))
        low, middle, high = statistics.quantiles(ratios, n=4)
        return middle, low, high


def interleave(candidates: Sequence[Candidate], rounds: int) -> list[Timing]:
    """Time candidates in turn, each for about `SLICE` in every round."""
    calls: list[int] = []
    for each in candidates:
        each.run(1)  # compiles
        count = 1
        while (spent := _time(each, count)) < SLICE / 4.0:
            count *= 2
        calls.append(max(1, round(count * SLICE / spent)))
    seconds: list[list[float]] = [[] for _ in candidates]
    for k in range(rounds):
        order = range(len(candidates)) if k % 2 == 0 else range(len(candidates) - 1, -1, -1)
        for i in order:
            seconds[i].append(_time(candidates[i], calls[i]) / calls[i] / candidates[i].steps)
    return [
        Timing(name=each.name, seconds=tuple(spent))
        for each, spent in zip(candidates, seconds, strict=True)
    ]


def shared_out(name: str, part: Callable[[int], Any], threads: int, *, steps: int) -> Candidate:
    """Let each thread do its part; a call takes as long as the slowest."""
    pool = ThreadPoolExecutor(threads)  # as for several threads, so for one
    longest = [0.0]

    def timed(i: int) -> float:
        started = time.thread_time()
        part(i)
        return time.thread_time() - started

    def run(calls: int) -> None:
        for _ in range(calls):
            longest[0] += max(pool.map(timed, range(threads)))

    def spent() -> float:
        found, longest[0] = longest[0], 0.0
        return found

    return Candidate(name=name, run=run, steps=steps, spent=spent)


def fresh(code: str) -> float:
    """Return the time that `code` takes in a new interpreter, beyond starting it; best of five."""

    def once(text: str) -> float:
        started = time.perf_counter()
        subprocess.run([sys.executable, "-c", text], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - started

    once(code)  # fills the caches
    return min(once(code) for _ in range(5)) - min(once("pass") for _ in range(5))


def _time(candidate: Candidate, calls: int) -> float:
    if candidate.spent is not None:
        candidate.spent()
        candidate.run(calls)
        return candidate.spent()
    clocks = (time.thread_time,) if candidate.alone else (time.perf_counter, time.process_time)
    started = [clock() for clock in clocks]
    candidate.run(calls)
    spent = [clock() - before for clock, before in zip(clocks, started, strict=True)]
    return max(min(spent), 1e-9)
