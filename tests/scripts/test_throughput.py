"""The measurement: its operation count, its ratios and its command."""

import pytest

from qcar_env.commands import throughput
from qcar_env.evaluation.throughput import closed_loops, environments, timing
from qcar_env.physics.car import REST
from qcar_env.physics.motion import Phasor, Phasors, turning, turning_step
from qcar_env.physics.rk4 import step_fractions
from qcar_env.scenarios import PAPER_CAR


class Counted:
    """A number that notes every distinct operation that is done on it."""

    done: dict

    def __init__(self, key):
        self.key = key

    def _do(self, sign, other):
        key = (sign, self.key, other.key)
        return Counted.done.setdefault(key, Counted(len(Counted.done)))

    def __add__(self, other):
        return self._do("+", other)

    def __sub__(self, other):
        return self._do("-", other)

    def __mul__(self, other):
        return self._do("*", other)


def count_operations():
    """Count the sums and products of a step that the one before has not, each distinct one once."""
    Counted.done = {}

    def new(name, like):
        if isinstance(like, tuple):
            entries = (new(f"{name}.{i}", each) for i, each in enumerate(like))
            return type(like)(*entries)
        return Counted(name)

    car = PAPER_CAR.functions
    on_road = car.road_input(0.0, 0.0, PAPER_CAR.numbers)
    turned = new("turning", turning(on_road, on_road, 0.0, 1.0, 1.0, 1.0))
    x, step = new("x", REST), new("step", step_fractions(1.0))
    phasors = new("phasors", Phasors(Phasor(0.0, 0.0), Phasor(0.0, 0.0)))
    fixed = Counted("u1"), Counted("u2"), new("car", PAPER_CAR.numbers)
    counts = []
    for _ in range(2):
        x, phasors = turning_step(car.rate, x, phasors, turned, step, *fixed)
        counts.append(len(Counted.done))
    return counts[1] - counts[0]


def test_the_operations_of_a_step_are_counted_from_the_source():
    assert count_operations() == closed_loops.OPERATIONS


def test_ratios_are_taken_round_by_round():
    fast = timing.Timing(name="fast", seconds=(1.0, 2.0, 1.0, 1.0))
    slow = timing.Timing(name="slow", seconds=(3.0, 6.0, 3.0, 3.0))
    assert fast.times_faster_than(slow) == (3.0, 3.0, 3.0)


def test_candidates_are_timed_in_every_round():
    calls = []
    work = timing.Candidate(name="sum", run=lambda n: calls.append(sum(range(2000 * n))), steps=2)
    (found,) = timing.interleave([work], 4)
    assert len(found.seconds) == 4
    assert 0.0 < found.median < 1e-3


@pytest.mark.parametrize(
    ("flag", "value", "message"),
    [
        ("--rounds", "1", "rounds must be at least 3, got 1"),
        ("--threads", "0", "threads must be at least 1, got 0"),
        ("--num-envs", "0", "num-envs must be at least 1, got 0"),
        ("--out", __file__, "--out must be a folder that can be written to, got "),
    ],
)
def test_a_wrong_number_is_refused(capsys, flag, value, message):
    assert throughput.main([flag, value]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_its_result(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(timing, "SLICE", 0.001)
    monkeypatch.setattr(environments, "PROCESSES", 1)
    assert throughput.main(["--rounds", "3", "--num-envs", "1", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "throughput.json").exists()
    assert "CartPoleVectorEnv 1" in capsys.readouterr().out
