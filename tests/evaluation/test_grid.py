import json
from functools import partial
from pathlib import Path

import numpy as np
from hypothesis import given, strategies as st

from qcar_env.evaluation import grid
from qcar_env.evaluation.grid import Cell
from qcar_env.evaluation.workers import WorkerDiedError


def here(tasks):
    """Run tasks in this process."""
    for index, task in enumerate(tasks):
        yield index, task(), None


def never(tasks):
    assert not tasks
    yield from ()


def draw(seed):
    return np.random.default_rng(seed).standard_normal(3).tolist()


def fail():
    raise OSError("no fuel")


def cells(count, **changed):
    return [
        Cell(config={"row": 1}, seed=each, work=partial(draw, each), intervals=10)
        for each in range(count)
    ]


def test_a_result_keeps_every_bit_and_what_is_not_finite(tmp_path):
    values = [*draw(3), np.inf, -0.0, 5e-324]
    cell = Cell(config={}, seed=0, work=partial(list, values), intervals=1)
    assert grid.run([cell], tmp_path, here) == {}
    assert np.array(grid.read(tmp_path, cell.key)).tobytes() == np.array(values).tobytes()


def test_what_has_a_file_is_not_run_again_and_a_damaged_file_is(tmp_path):
    assert grid.run(cells(4), tmp_path, here) == {}
    assert grid.run(cells(4), tmp_path, never) == {}
    broken = next(tmp_path.glob("*/*.json"))
    broken.write_text(broken.read_text()[:-5])
    ran = []

    def note(tasks):
        ran.extend(tasks)
        yield from here(tasks)

    assert grid.run(cells(4), tmp_path, note) == {}
    assert len(ran) == 1
    assert json.loads(broken.read_text())["result"]


def test_a_cell_twice_is_run_once(tmp_path):
    counted = []
    grid.run([*cells(2), *cells(2)], tmp_path, here, progress=lambda *each: counted.append(each))
    assert counted == [(0, 2), (2, 2)]


def test_what_fails_stays_with_its_cell(tmp_path):
    bad = Cell(config={"bad": 1}, seed=0, work=fail, intervals=10)
    found = grid.run([bad, *cells(2)], tmp_path, here)
    assert list(found) == [bad.key]
    assert str(found[bad.key]) == "no fuel"
    assert all(grid.read(tmp_path, each.key) for each in cells(2))


def test_a_lost_worker_loses_its_chunk_alone(tmp_path):
    def lossy(tasks):
        yield 0, None, WorkerDiedError("gone")
        yield 1, tasks[1](), None

    found = grid.run(cells(4), tmp_path, lossy, intervals=20)
    assert sorted(found) == sorted(each.key for each in cells(4)[:2])
    assert grid.run(cells(4), tmp_path, here) == {}


def test_a_result_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / cells(1)[0].key[:2]).write_text("no folder")
    found = grid.run(cells(1), tmp_path, here)
    assert isinstance(found[cells(1)[0].key], OSError)


@given(
    costs=st.lists(st.integers(1, 100), max_size=30),
    room=st.integers(1, 150),
)
def test_chunks_hold_each_cell_once_in_order_and_no_more_than_they_may(costs, room):
    made = [
        Cell(config={}, seed=i, work=partial(draw, i), intervals=each)
        for i, each in enumerate(costs)
    ]
    found = grid.chunks(made, room)
    assert [each for part in found for each in part] == made
    for part in found:
        assert part
        assert len(part) == 1 or sum(each.intervals for each in part) <= room


def test_a_key_hangs_on_configuration_and_seed():
    def key(config, seed):
        return Cell(config=config, seed=seed, work=partial(draw, 0), intervals=1).key

    assert key({"a": 1, "b": 2}, 0) == key({"b": 2, "a": 1}, 0)
    assert len({key({"a": 1}, 0), key({"a": 1}, 1), key({"a": 2}, 0), key({"a": 1}, None)}) == 4
    assert Path(key({"a": 1}, 0)).name == key({"a": 1}, 0)
