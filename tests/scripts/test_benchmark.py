"""qcar benchmark: results, failures that stay where they happened, and what it refuses."""

import contextlib
import json
import sys
import textwrap
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from qcar_env import agents
from qcar_env.commands import benchmark
from qcar_env.evaluation import storage, tracks
from qcar_env.evaluation.agent import OnnxPolicy
from qcar_env.evaluation.tracks import Track

SHORT = Track(
    name="short",
    version=3,
    title="The worst case, cut short",
    scenario="paper",
    force_scales=(1.0, 0.5),
    episodes=5,
    duration=1.0,
    periods=3,
)
BLIND = Track(
    name="blind",
    version=1,
    title="The same, from the state alone",
    scenario="paper",
    force_scales=(1.0, 0.5),
    observe="feedback",
    episodes=5,
    duration=1.0,
    periods=3,
)

REAL = tracks.TRACKS
DRAWN = Track(
    name="drawn",
    version=1,
    title="Everything drawn, cut short",
    scenario="paper-randomised",
    force_scales=(1.0, 0.25),
    episodes=48,
    duration=10.0,  # in 2 s what is left of a drawn start makes a tail that 48 episodes miss
    periods=3,
)


@pytest.fixture(autouse=True)
def short_tracks(monkeypatch):
    """Episodes of a second: the machinery does not depend on their length."""
    there = {"short": SHORT, "blind": BLIND, "drawn": DRAWN}
    monkeypatch.setattr(tracks, "TRACKS", there)
    monkeypatch.setattr(agents, "entries", lambda: ())


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module with policies of every kind."""
    text = """
        import numpy as np

        class Steady:
            reads = "feedback"
            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                assert observation.shape[1] == 4
                return np.clip(-9.0 * observation[:, 2:4], -1.0, 1.0), state

        class Nan(Steady):
            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                return np.full((len(observation), 2), np.nan), None

        class Midway(Steady):
            def __init__(self):
                self.count = 0
            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                self.count += 1
                if self.count > 50:
                    raise RuntimeError("the engine is out of fuel")
                return np.zeros((len(observation), 2)), None

        class Short(Steady):
            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                if observation.shape[1] != 7:
                    raise ValueError(f"expected 7 entries, got {observation.shape[1]}")

        steady, nan, midway, short = Steady(), Nan(), Midway(), Short()
        number = 3
        dict = dict

        def made(scenario):
            assert scenario.actuator.limit[0] <= 280.0
            return Steady()
    """
    (tmp_path / "bench_policies.py").write_text(textwrap.dedent(text), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "bench_policies", raising=False)
    return "bench_policies"


def run(out, *arguments):
    return benchmark.main(
        ["--jobs", "1", "--no-figures", "--out", str(out), "--tracks", "short", *arguments]
    )


def read(out):
    return json.loads((out / "result.json").read_text(encoding="utf-8"))


def test_results_are_complete_and_a_second_run_is_identical(tmp_path):
    for name in ("a", "b"):
        assert run(tmp_path / name, "--baselines", "none", "cnvc", "lnvc") == 0
    first, second = read(tmp_path / "a"), read(tmp_path / "b")
    assert first["standings"] == second["standings"]
    assert first["rows"] == second["rows"]
    board = [(tmp_path / name / "leaderboard.md").read_text(encoding="utf-8") for name in "ab"]
    assert board[0] == board[1]
    assert "*optimum*" in board[0]
    assert "*optimum at 200 Hz*" in board[0]
    policies = {row["policy"] for row in first["rows"]}
    assert policies == {"none", "cnvc", "lnvc", "cnvc (tuned)", "lnvc (tuned)"}
    assert len(first["rows"]) == 5 * 2 * 5  # policies, limits, episodes
    for row in first["rows"]:
        assert row["rho"] == pytest.approx(max(row["x1"] / 1.1163, row["x2"] / 1.5891), rel=1e-3)
    header = (tmp_path / "a" / "table.csv").read_text(encoding="utf-8").splitlines()
    assert len(header) == 1 + len(first["rows"])
    assert first["tracks"][0]["version"] == 3


def test_other_seeds_move_the_result_within_its_intervals(tmp_path):
    # Of two free draws from one distribution, 83 % of the figures lie within the other's interval
    # of 95 %: P(|z| < 1.96 / sqrt 2). A Latin hypercube varies less than a free draw.
    names = ("cnvc", "lnvc", "skyhook", "lqr")
    found = []
    for seed in range(4):
        seeded = ("--tracks", "drawn", "--baselines", *names, "--seed", str(seed))
        assert run(tmp_path / str(seed), *seeded) == 0
        standings = read(tmp_path / str(seed))["standings"]
        found.append({(s["policy"], s["force_scale"]): s["rho"] for s in standings})
    assert len(found[0]) == 8 * len(DRAWN.force_scales)
    inside = []
    for first, second in permutations(found, 2):
        for key, a in first.items():
            b = second[key]
            assert b["value"] != a["value"]
            assert a["low"] <= b["high"]  # no figure is contradicted
            assert b["low"] <= a["high"]
            inside.append(a["low"] <= b["value"] <= a["high"])
    assert np.mean(inside) > 0.83


def test_a_policy_that_fails_does_not_take_the_others_with_it(tmp_path, mine, capsys):
    specs = [f"{mine}:{name}" for name in ("nan", "midway", "short", "steady", "made")]
    arguments = [word for spec in specs for word in ("--policy", spec)]
    assert run(tmp_path / "out", "--baselines", "cnvc", *arguments) == 1
    result = read(tmp_path / "out")
    assert {row["policy"] for row in result["rows"]} == {
        "cnvc",
        "cnvc (tuned)",
        f"{mine}:steady",
        f"{mine}:made",
    }
    errors = {failure["policy"].split(":")[1]: failure["error"] for failure in result["failures"]}
    assert "action must be finite" in errors["nan"]
    assert "the engine is out of fuel" in errors["midway"]
    assert "expected 7 entries, got 4" in errors["short"]
    said = capsys.readouterr()
    assert "midway failed on short" in said.err
    assert "yours" in (tmp_path / "out" / "leaderboard.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("{mine}:nothing", "no policy '{mine}:nothing': AttributeError: "),
        ("no_such_module_here:policy", "No module named 'no_such_module_here'; give module:object"),
        ("{mine}_broken:policy", "no policy '{mine}_broken:policy': SyntaxError: "),
        ("{mine}:number", "'{mine}:number' is no policy: it has no predict"),
        ("{here}/cut.onnx", "cut.onnx is not an ONNX policy"),
        ("{here}", "no recipe.json in "),
        ("{mine}_leaves:policy", "no policy '{mine}_leaves:policy': SystemExit: 0; give module:"),
    ],
)
def test_what_is_no_policy_is_refused_before_anything_is_run(tmp_path, mine, capsys, spec, message):
    (tmp_path / f"{mine}_broken.py").write_text("import this that", encoding="utf-8")
    (tmp_path / f"{mine}_leaves.py").write_text("import sys; sys.exit(0)", encoding="utf-8")
    (tmp_path / "cut.onnx").write_bytes(b"cut")
    spec = spec.format(mine=mine, here=tmp_path)
    assert run(tmp_path / "out", "--baselines", "none", "--policy", spec) == 2
    said = capsys.readouterr().err
    assert message.format(mine=mine) in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_policy_that_cannot_be_made_is_reported(tmp_path, mine):
    assert run(tmp_path, "--baselines", "none", "--policy", f"{mine}:dict") == 1
    assert all("is not iterable" in failure["error"] for failure in read(tmp_path)["failures"])
    assert {row["policy"] for row in read(tmp_path)["rows"]} == {"none"}


def test_results_are_not_overwritten_without_force(tmp_path, capsys):
    assert run(tmp_path, "--baselines", "none") == 0
    before = (tmp_path / "result.json").read_bytes()
    assert run(tmp_path, "--baselines", "cnvc") == 2
    assert "already holds results; give --force" in capsys.readouterr().err
    assert (tmp_path / "result.json").read_bytes() == before
    assert run(tmp_path, "--baselines", "cnvc", "--force") == 0
    assert {row["kind"] for row in read(tmp_path)["rows"]} == {"published", "tuned"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tracks", "papr"], "unknown track 'papr'"),
        (["--baselines", "cnvcc"], "unknown baseline 'cnvcc'"),
        (["--policy", "nothing"], "--policy must be module:object"),
        (["--policy", "absent.onnx"], "no file absent.onnx"),
        (["--jobs", "0"], "jobs must be at least 1"),
        (["--ray", "--merge"], "--merge runs nothing"),
        (["--address", "127.0.0.1:1"], "give --ray too"),
        (["--seed", "1", "--seeds", "2"], "cannot both be given"),
        (["--seeds", "-2"], "seed must be at least 0"),
        (["--seed", "-1"], "seed must be at least 0, got -1"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_run(tmp_path, capsys, arguments, message):
    assert run(tmp_path / "out", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_named_twice_is_run_once(tmp_path):
    assert run(tmp_path, "--tracks", "short", "short", "--baselines", "none", "none") == 0
    assert len(read(tmp_path)["rows"]) == 10


def test_a_track_for_feedback_takes_no_policy_that_reads_more(tmp_path):
    arguments = ["--tracks", "short", "blind", "--baselines", "lqr", "lqr-feedforward"]
    assert run(tmp_path, *arguments) == 0
    rows = read(tmp_path)["rows"]
    assert {row["policy"] for row in rows if row["track"] == "blind"} == {"lqr", "lqr (tuned)"}
    both = {}
    for row in rows:
        if row["policy"] == "lqr":
            both.setdefault(row["track"], []).append(row["rho"])
    assert both["short"] == both["blind"]  # the same episodes, run once


def test_an_onnx_file_enters(tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper = onnx.helper
    gain = np.zeros((4, 2), dtype=np.float32)
    gain[2, 0] = gain[3, 1] = -5.0
    node = helper.make_node("MatMul", ["observation", "gain"], ["action"])
    graph = helper.make_graph(
        [node],
        "policy",
        [helper.make_tensor_value_info("observation", onnx.TensorProto.FLOAT, ["n", 4])],
        [helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, ["n", 2])],
        [onnx.numpy_helper.from_array(gain, "gain")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path = tmp_path / "linear.onnx"
    onnx.save(model, path)
    assert run(tmp_path / "out", "--baselines", "none", "--policy", str(path)) == 0
    mine = [row for row in read(tmp_path / "out")["rows"] if row["policy"] == "linear"]
    assert len(mine) == 10
    assert {row["reads"] for row in mine} == {"feedback"}
    path.write_bytes(path.read_bytes()[:40])  # cut off
    assert run(tmp_path / "cut", "--baselines", "none", "--policy", str(path)) == 2
    assert not (tmp_path / "cut").exists()


def test_a_network_that_loops_or_reads_other_files_is_refused(tmp_path, capsys):
    """One ran for ever and could not be interrupted; one took its weights from where it was run."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper, FLOAT, BOOL = onnx.helper, onnx.TensorProto.FLOAT, onnx.TensorProto.BOOL
    seen = [helper.make_tensor_value_info("observation", FLOAT, ["n", 4])]
    done = [helper.make_tensor_value_info("action", FLOAT, ["n", 2])]
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["go_on"]),
            helper.make_node("Identity", ["x"], ["x_out"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("k", onnx.TensorProto.INT64, []),
            helper.make_tensor_value_info("go", BOOL, []),
            helper.make_tensor_value_info("x", FLOAT, ["n", 2]),
        ],
        [
            helper.make_tensor_value_info("go_on", BOOL, []),
            helper.make_tensor_value_info("x_out", FLOAT, ["n", 2]),
        ],
    )
    gain = onnx.numpy_helper.from_array(np.zeros((4, 2), np.float32), "gain")
    true = onnx.numpy_helper.from_array(np.array(True), "true")
    product = helper.make_node("MatMul", ["observation", "gain"], ["y"])
    loop = helper.make_node("Loop", ["", "true", "y"], ["action"], body=body)
    graph = helper.make_graph([product, loop], "endless", seen, done, [gain, true])
    given = {"opset_imports": [helper.make_opsetid("", 17)], "ir_version": 8}
    onnx.save(helper.make_model(graph, **given), tmp_path / "endless.onnx")
    plain = helper.make_node("MatMul", ["observation", "gain"], ["action"])
    graph = helper.make_graph([plain], "outside", seen, done, [gain])
    outside = {"save_as_external_data": True, "location": "weights", "size_threshold": 0}
    onnx.save(helper.make_model(graph, **given), tmp_path / "outside.onnx", **outside)
    for name, message in (
        ("endless", "endless.onnx must be a network without a Loop, which could run for ever"),
        ("outside", "outside.onnx must hold its own weights, but they are in another file; save"),
    ):
        arguments = ["--baselines", "none", "--policy", str(tmp_path / f"{name}.onnx")]
        assert run(tmp_path / "out", *arguments) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def linear(onnx):
    """Return a network that is a product with a matrix."""
    helper, FLOAT = onnx.helper, onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "gain"], ["action"])],
        "linear",
        [helper.make_tensor_value_info("observation", FLOAT, ["n", 4])],
        [helper.make_tensor_value_info("action", FLOAT, ["n", 2])],
        [onnx.numpy_helper.from_array(np.zeros((4, 2), np.float32), "gain")],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def test_a_loop_is_found_however_its_name_is_packed_and_in_whatever_holds_it(tmp_path):
    """Protobuf reads a length of 4 as one byte or as several; a function is beside the graph."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    loop = onnx.helper.make_node("Loop", ["", "true", "y"], ["z"], name="node")
    packed = linear(onnx)
    plain = loop.SerializeToString()
    longer = plain.replace(b"\x22\x04Loop", b"\x22\x84\x00Loop")
    assert len(longer) == len(plain) + 1
    node = b"\x0a" + bytes([len(longer)]) + longer  # GraphProto.node
    graph = b"\x3a" + bytes([len(node)]) + node  # ModelProto.graph, which adds to the one before
    (tmp_path / "packed.onnx").write_bytes(packed.SerializeToString() + graph)
    held = linear(onnx)
    domain = [onnx.helper.make_opsetid("", 17)]
    held.functions.append(
        onnx.helper.make_function("mine", "F", ["y"], ["z"], [loop], opset_imports=domain)
    )
    onnx.save(held, tmp_path / "held.onnx")
    for name in ("packed", "held"):
        with pytest.raises(ValueError, match=f"{name}.onnx must be a network without a Loop"):
            OnnxPolicy(tmp_path / f"{name}.onnx")


def test_a_network_whose_notes_name_a_location_enters(tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    model = linear(onnx)
    onnx.helper.set_model_props(model, {"location": "Berlin", "made of": '"\x04Loop'})
    onnx.save(model, tmp_path / "noted.onnx")
    assert OnnxPolicy(tmp_path / "noted.onnx").size == 4


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_policy_that_ends_the_program_ends_its_own_run_alone(tmp_path, mine, capsys, jobs):
    text = """
        import os, sys
        from bench_policies import Steady

        class Quits(Steady):
            def predict(self, *args, **kwargs):
                sys.exit(0)

        class Dies(Steady):
            def predict(self, *args, **kwargs):
                os._exit(0)

        quits, dies = Quits(), Dies()
    """
    (tmp_path / "bench_ends.py").write_text(textwrap.dedent(text), encoding="utf-8")
    ends = ["quits", "dies"] if jobs == "2" else ["quits"]  # in this process nothing can stop it
    arguments = [word for name in ends for word in ("--policy", f"bench_ends:{name}")]
    out = tmp_path / "out"
    given = ["--tracks", "paper", "--no-figures", "--no-agents", "--out", str(out), "--jobs", jobs]
    if jobs == "1":
        given[1] = "short"
    with pytest.MonkeyPatch.context() as patch:
        if jobs == "2":
            patch.setattr(tracks, "TRACKS", REAL)  # worker processes know the real tracks alone
        assert benchmark.main([*given, "--baselines", "cnvc", *arguments]) == 1
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert {row["policy"] for row in found["rows"]} == {"cnvc", "cnvc (tuned)"}
    errors = {each["policy"]: each["error"] for each in found["failures"]}
    assert errors["bench_ends:quits"] == "SystemExit: 0"
    if jobs == "2":
        assert errors["bench_ends:dies"] == "WorkerDiedError: its process ended with 0"


def test_an_error_that_is_no_exception_or_has_no_text_stays_with_its_policy(tmp_path, mine):
    text = """
        import asyncio
        from bench_policies import Steady

        class Mute(Exception):
            def __str__(self):
                raise TypeError

        class Cancelled(Steady):
            def predict(self, *args, **kwargs):
                raise asyncio.CancelledError("later")

        class Says(Steady):
            def predict(self, *args, **kwargs):
                raise Mute

        cancelled, says = Cancelled(), Says()
    """
    (tmp_path / "bench_odd.py").write_text(textwrap.dedent(text), encoding="utf-8")
    policies = ["--policy", "bench_odd:cancelled", "--policy", "bench_odd:says"]
    assert run(tmp_path / "out", "--baselines", "none", *policies) == 1
    errors = {each["policy"]: each["error"] for each in read(tmp_path / "out")["failures"]}
    assert errors == {
        "bench_odd:cancelled": "CancelledError: later",
        "bench_odd:says": "Mute: its message cannot be read",
    }
    assert {row["policy"] for row in read(tmp_path / "out")["rows"]} == {"none"}


def test_figures_and_report_of_an_older_benchmark_do_not_stay_beside_the_new_record(tmp_path):
    for name in ("report.html", "table.parquet", "figures/frontier.png", "notes.md"):
        storage.write_text(tmp_path / name, "old")
    assert run(tmp_path, "--baselines", "none") == 0
    there = {each.name for each in tmp_path.rglob("*") if each.is_file()} - {"table.parquet"}
    assert there == {"leaderboard.md", "table.csv", "result.json", "notes.md"}
    assert not any(each.read_bytes() == b"old" for each in tmp_path.glob("table.*"))


def test_figures_that_cannot_be_drawn_lose_no_results(tmp_path, monkeypatch, capsys):
    def draw(folder, outcome):
        storage.write_text(folder / "frontier.png", "new")
        assert not (folder / "old.png").exists()
        raise ValueError("a formula that is none")

    storage.write_text(tmp_path / "figures" / "old.png", "old")
    monkeypatch.setattr(benchmark, "_draw", draw)
    given = ["--jobs", "1", "--out", str(tmp_path), "--tracks", "short", "--baselines", "none"]
    assert benchmark.main(given) == 2
    assert "benchmark: a formula that is none" in capsys.readouterr().err
    assert len(read(tmp_path)["rows"]) == 10


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_an_output_that_nobody_takes_loses_no_results(tmp_path, monkeypatch, capsys):
    with contextlib.suppress(OSError), open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert run(tmp_path, "--baselines", "none") == 2
    assert "benchmark: No space left on device" in capsys.readouterr().err
    assert len(read(tmp_path)["rows"]) == 10


def test_two_benchmarks_do_not_write_one_folder(tmp_path, capsys):
    with storage.held(tmp_path / "out"):
        assert run(tmp_path / "out", "--baselines", "none") == 2
    assert "is being written by another process" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_two_processes_give_the_result_of_one_and_the_figures(tmp_path, monkeypatch):
    monkeypatch.undo()  # worker processes know the real tracks alone
    arguments = ["--tracks", "budget", "--baselines", "none", "lnvc", "--no-agents"]
    for name, jobs in (("one", "1"), ("two", "2")):
        out = str(tmp_path / name)
        assert benchmark.main([*arguments, "--jobs", jobs, "--out", out]) == 0
    assert read(tmp_path / "one")["rows"] == read(tmp_path / "two")["rows"]
    figures = {each.name for each in (tmp_path / "two" / "figures").iterdir()}
    assert {"frontier_budget.png", "histories_budget_1.pdf"} <= figures
