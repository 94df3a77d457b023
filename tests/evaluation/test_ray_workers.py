"""Tasks on a cluster of several raylets on this machine."""

import os
import sys
import time
from functools import partial

import numpy as np
import pytest

from qcar_env.evaluation import ray_workers, workers
from qcar_env.evaluation.workers import WorkerDiedError

# what Ray itself warns of is not ours
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def raylets():
    """A head without cores and two raylets of one core each."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    here = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        here.add_node(num_cpus=1)
    with ray_workers.cluster(here.address):
        yield here
    ray.shutdown()
    here.shutdown()


def bits(seed, large):
    return np.random.default_rng(seed).standard_normal(5).tobytes() + large[:3].tobytes()


def ends():
    os._exit(3)


def waits(seconds, value):
    time.sleep(seconds)
    return value


def found(done):
    return {index: (result, error) for index, result, error in done}


def test_a_cluster_gives_the_bits_of_processes_here(raylets):
    large = np.arange(1e5)
    tasks = [partial(bits, seed, large) for seed in range(6)]
    there = found(ray_workers.each_done(tasks))
    assert there == found(workers.each_done(tasks, 2))
    assert sorted(there) == list(range(6))


def test_errors_stay_with_their_tasks(raylets):
    tasks = [partial(int, "x"), partial(sys.exit, 4), partial(pow, 2, 3), partial(ends), lambda: 0]
    results = found(ray_workers.each_done(tasks[:4]))
    assert isinstance(results[0][1], ValueError)
    assert isinstance(results[1][1], SystemExit)
    assert results[2] == (8, None)
    assert isinstance(results[3][1], WorkerDiedError)


def test_a_raylet_that_is_lost_loses_no_task(raylets):
    extra = raylets.add_node(num_cpus=1)
    done = ray_workers.each_done([partial(waits, 1.0, each) for each in range(9)])
    first = next(done)
    raylets.remove_node(extra, allow_graceful=False)
    rest = list(done)
    assert sorted(index for index, *_ in [first, *rest]) == list(range(9))
    assert all(result == index and error is None for index, result, error in [first, *rest])


def test_an_address_where_nothing_answers_is_refused_at_once():
    pytest.importorskip("ray")
    begin = time.monotonic()
    with (
        pytest.raises(ValueError, match=r"no Ray cluster answers at '127\.0\.0\.1:9'"),
        ray_workers.cluster("127.0.0.1:9"),
    ):
        pass
    assert time.monotonic() - begin < 2.0 * ray_workers.REACHED


def test_without_ray_it_is_said_how_to_install_it(monkeypatch):
    monkeypatch.setattr(ray_workers.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'qcar_env\[cluster\]'"):
        ray_workers.check_installed()
