"""Frames show what happens: where things are, which way forces point, at which amplitude."""

import dataclasses
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import qcar_env  # noqa: F401 - registers the environment
from qcar_env.envs.picture import forces, largest_forces, sizes
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.parts.actuator import LaggedSemiActiveDamper, LaggedSuspensionActuator
from qcar_env.physics import linear
from qcar_env.physics.signals import signal
from qcar_env.physics.state import State
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.shapes import SquareBar
from qcar_env.scenarios import SCENARIOS, scenario

rendering = pytest.importorskip("qcar_env.envs.rendering")
imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")

BLUE = (0, 114, 178)
EXTERNAL = (176, 122, 20)


def picture(name="paper", x1=0.0, x2=0.0, action=None, time=0.0, **changes):
    base = scenario(name)
    rest = State(0.0, 0.0, 0.0, 0.0)
    kind, numbers = type(base.actuator), base.actuator.numbers
    command = kind.command((0.0, 0.0) if action is None else action, numbers)
    return rendering.Picture(
        name="CNVC",
        colour="#0072B2",
        nominal=base,
        episode=base,
        time=time,
        elapsed=0.0,
        state=State(x1, x2, 0.0, 0.0),
        force=forces(base.actuator, command, (), rest),
        **changes,
    )


def rows_of(frame, colour, columns):
    """Rows of the scene, above the chart and left of the readings, that hold a colour."""
    found = np.all(frame[60:340, columns] == colour, axis=2).any(axis=1)
    return 60 + np.flatnonzero(found)


def frames_of(path, width, height):
    """Decode a film: array (frames, height, width, 3)."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path)]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, dtype=np.uint8).reshape(-1, height, width, 3)


BODY = slice(230, 290)  # columns of the body's middle, beside every arrow
BODY_FORCE = slice(190, 200)  # columns of the arrow on the body
WHEEL_FORCE = slice(188, 201)


def test_a_frame_is_an_array_of_the_callers_own():
    painter = rendering.Painter()
    first = painter.draw(picture())
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    kept = first.copy()
    painter.draw(picture(x2=1.0))
    np.testing.assert_array_equal(first, kept)


def test_equal_pictures_give_equal_frames():
    frames = [rendering.Painter().draw(picture(x1=0.3, x2=-0.2)) for _ in range(2)]
    np.testing.assert_array_equal(*frames)


@pytest.mark.parametrize("name", ["paper", "mathworks-hump"])
@pytest.mark.parametrize("share", [-0.8, 0.5])
def test_the_body_is_drawn_as_high_as_it_is(name, share):
    x2 = share * scenario(name).reference_amplitudes[1]
    painter = rendering.Painter()
    at_rest = rows_of(painter.draw(picture(name)), BLUE, BODY)
    moved = rows_of(painter.draw(picture(name, x2=x2)), BLUE, BODY)
    expected = sizes(scenario(name)).displacement * x2
    assert at_rest[0] - moved[0] == pytest.approx(expected, abs=1.0)  # a whole pixel


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_uncontrolled_motion_and_the_hump_can_be_seen(name):
    base = scenario(name)
    found = sizes(base)
    a1, a2 = base.reference_amplitudes
    assert 15.0 < found.displacement * max(a1, a2) < 60.0  # px, of 480
    assert found.displacement * found.road * base.excitation.h >= 12.99  # rounding
    assert 15.0 < found.displacement * found.bar <= 60.0


def test_the_tyre_ends_on_the_road():
    painter = rendering.Painter()
    base = scenario("paper")
    quarter = 0.25 * 2.0 * np.pi / base.excitation.omega
    for when, height in ((0.0, 0.0), (quarter, base.road.h), (3 * quarter, -base.road.h)):
        frame = painter.draw(picture(time=when))
        column = frame[:, 256]  # under the axle
        tyre = np.flatnonzero(np.all(column == (52, 56, 62), axis=1))
        found = sizes(base)
        road = 0.645 * 480 - height * found.displacement * found.road
        assert tyre[-1] == pytest.approx(road, abs=2.0)  # the outlines are a pixel wide


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_force_arrows_point_where_forces_push(sign):
    painter = rendering.Painter()
    none = rows_of(painter.draw(picture()), BLUE, BODY_FORCE)
    pushed = rows_of(painter.draw(picture(action=(0.0, sign))), BLUE, BODY_FORCE)
    above, below = none[0] - pushed[0], pushed[-1] - none[-1]
    assert (above if sign > 0 else below) == pytest.approx(46.0, abs=3.0)
    assert (below if sign > 0 else above) == 0


def test_a_suspension_actuator_pushes_the_wheel_down_when_it_lifts_the_body():
    frame = rendering.Painter().draw(picture("mathworks-hump", action=(1.0,)))
    hub = 0.645 * 480 - 46.0
    wheel = [row for row in rows_of(frame, BLUE, WHEEL_FORCE) if row > hub - 60]
    assert min(wheel) >= hub - 2.0
    assert max(wheel) == pytest.approx(hub + 46.0, abs=3.0)


def test_the_external_force_is_shown_where_there_is_one():
    painter = rendering.Painter()
    assert np.all(painter.draw(picture()) == EXTERNAL, axis=2).any()
    assert not np.all(painter.draw(picture("mathworks-hump")) == EXTERNAL, axis=2).any()


def test_the_chart_shows_amplitudes_over_the_uncontrolled_ones():
    base = scenario("paper")
    steady = linear.steady_state(base.car, base.excitation, base.force)
    for t in np.linspace(0.0, 0.1, 5):
        shown = dataclasses.replace(picture(), state=State(*steady.state(t)))
        assert shown.levels == pytest.approx((1.0, 1.0), rel=1e-9)


def test_the_chart_remembers_an_episode_and_forgets_it_at_the_next():
    painter = rendering.Painter()
    fresh = painter.draw(picture(x2=0.1))
    for k in range(1, 100):
        last = painter.draw(dataclasses.replace(picture(x2=0.1 + 0.01 * k), elapsed=0.01 * k))
    assert np.any(last[350:450, 400:600] != fresh[350:450, 400:600])
    np.testing.assert_array_equal(painter.draw(picture(x2=0.1)), fresh)


def test_every_scenario_can_be_rendered_without_a_display(find, every_name, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    env = gym.make("QuarterCarHump-v0", scenario=find(every_name), render_mode="rgb_array")
    env.reset(seed=1)
    before = env.render()
    for _ in range(20):
        env.step(env.action_space.sample())
    assert np.any(env.render() != before)
    env.close()


def test_human_mode_shows_each_step(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = QuarterCarHumpEnv(render_mode="human")
    shown = []
    monkeypatch.setattr(rendering.Window, "show", lambda self, frame, fps: shown.append(fps))
    env.reset(seed=0)
    env.step(np.zeros(2))
    assert env.render() is None
    assert shown == [pytest.approx(200.0)] * 3
    env.close()


def test_a_window_opens_and_closes(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = rendering.Window()
    assert window.show(np.zeros((180, 240, 3), dtype=np.uint8), fps=1000.0)
    window.close()
    window.close()


def test_record_video_writes_what_happened(tmp_path):
    env = gym.make("QuarterCarHump-v0", render_mode="rgb_array", duration=0.1)
    env = gym.wrappers.RecordVideo(env, str(tmp_path / "film"), fps=25)
    env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        over = terminated or truncated
    env.close()
    (path,) = (tmp_path / "film").glob("*.mp4")
    assert frames_of(path, 640, 480).shape == (21, 480, 640, 3)  # the start and 0.1 s at 200 Hz


def test_the_rate_of_the_frames_is_that_of_the_steps():
    env = QuarterCarHumpEnv(render_mode="rgb_array")
    assert env.metadata["render_fps"] * env.dt == pytest.approx(1.0)


def test_render_without_a_mode_warns_and_returns_nothing():
    env = QuarterCarHumpEnv()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


def test_render_before_reset_says_so():
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        QuarterCarHumpEnv(render_mode="rgb_array").render()


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="did you mean 'rgb_array'"):
        QuarterCarHumpEnv(render_mode="rgb_aray")


def test_a_frame_too_small_to_read_is_refused():
    with pytest.raises(ValueError, match=r"frame width .* at least 240, got 100"):
        rendering.Painter((100, 400))


def test_pygame_is_imported_only_to_render():
    code = (
        "import sys, gymnasium, qcar_env\n"
        "env = gymnasium.make('QuarterCarHump-v0')\n"
        "env.reset(seed=0); env.step(env.action_space.sample())\n"
        "assert 'pygame' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_absent_pygame_is_named_with_the_remedy(monkeypatch):
    import qcar_env.envs

    monkeypatch.setitem(sys.modules, "pygame", None)
    for name in ("drawing", "rendering"):
        monkeypatch.delitem(sys.modules, f"qcar_env.envs.{name}")
        monkeypatch.delattr(qcar_env.envs, name)
    env = QuarterCarHumpEnv(render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r"qcar_env\[render\]"):
        env.render()


@pytest.mark.parametrize("name", ["paper-randomised", "mathworks-train"])
def test_chosen_cars_of_a_batch_look_as_they_would_alone(name):
    batch = gym.make_vec(
        "QuarterCarHump-v0",
        num_envs=3,
        scenario=name,
        render_mode="rgb_array",
        render_cars=(2, 0),
    )
    batch.reset(seed=5)
    alone = QuarterCarHumpEnv(name, render_mode="rgb_array")
    alone.caption = ("car 2", "#0072B2")
    alone.reset(seed=7)  # car i of a batch seeded with s is a single environment seeded with s + i
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.uniform(-1.0, 1.0, batch.action_space.shape).astype(np.float32)
        batch.step(actions)
        alone.step(actions[2])
    frames = batch.render()
    assert len(frames) == 2
    expected = alone.render()
    # The roads agree to rounding, so an edge of the picture may differ by a shade.
    assert np.abs(frames[0].astype(int) - expected).mean() < 0.01
    assert np.any(frames[1] != frames[0])


def test_record_video_of_a_batch(tmp_path):
    batch = gym.make_vec("QuarterCarHump-v0", num_envs=2, render_mode="rgb_array", duration=0.05)
    batch = gym.wrappers.vector.RecordVideo(
        batch, str(tmp_path / "film"), video_aspect_ratio=(2, 1), fps=25
    )
    batch.reset(seed=0)
    for _ in range(12):
        batch.step(batch.action_space.sample())
    batch.close()
    assert list((tmp_path / "film").glob("*.mp4"))


def test_a_car_that_is_not_in_the_batch_cannot_be_drawn():
    with pytest.raises(ValueError, match="one of 0 to 3, got 4"):
        gym.make_vec("QuarterCarHump-v0", num_envs=4, render_mode="rgb_array", render_cars=(4,))


# Any road, any actuator --------------------------------------------------------------------------


def test_a_road_from_a_table_is_read_at_the_cars_distance():
    base = scenario("mathworks-hump")
    rough = dataclasses.replace(
        base, road=ISO8608.of_class("C", L=100.0, seed=1, start=0.0), speed=20.0
    )
    painter = rendering.Painter()
    shown = dataclasses.replace(picture("mathworks-hump"), nominal=rough, episode=rough)
    frames = [painter.draw(dataclasses.replace(shown, time=t)) for t in (0.5, 1.0)]
    assert np.any(frames[0] != frames[1])
    found = sizes(rough)
    for t, frame in zip((0.5, 1.0), frames, strict=True):
        tyre = np.flatnonzero(np.all(frame[:, 256] == (52, 56, 62), axis=1))
        height = float(rough.excitation.height(t))
        road = 0.645 * 480 - height * found.displacement * found.road
        assert tyre[-1] == pytest.approx(road, abs=2.0)  # the outlines are a pixel wide


def test_a_kerb_is_drawn_upright():
    base = scenario("mathworks-hump")
    bar = dataclasses.replace(base, road=SquareBar(h=0.1, L=3.0, start=1.0))
    shown = dataclasses.replace(picture("mathworks-hump"), nominal=bar, episode=bar)
    frame = rendering.Painter().draw(shown)
    left = 256 + sizes(bar).along * 1.0  # where the bar begins, of the axle at 256
    just_before, just_after = (
        int(np.flatnonzero(np.all(frame[:340, round(x)] == (88, 93, 100), axis=1))[0])
        for x in (left - 2.0, left + 2.0)
    )
    height = 0.1 * sizes(bar).displacement * sizes(bar).road
    assert just_before - just_after == pytest.approx(height, abs=1.5)


def test_the_force_that_is_drawn_is_the_one_that_acts_and_not_the_one_asked_for():
    base = scenario("mathworks-hump")
    for actuator in (
        LaggedSuspensionActuator(limit=(1500.0,), lag=0.02),
        LaggedSemiActiveDamper(c_min=100.0, c_max=3000.0, lag=0.01),
    ):
        mine = dataclasses.replace(base, actuator=actuator)
        start = {"state": (0.0, 0.01, 0.3, 0.0)}
        env = QuarterCarHumpEnv(mine)
        many = gym.make_vec("QuarterCarHump-v0", num_envs=2, scenario=mine).unwrapped
        env.reset(seed=0, options=start)
        many.reset(seed=0, options=start)
        for _ in range(3):
            force = env.step(np.ones(1, np.float32))[-1]["force"]
            many.step(np.ones((2, 1), np.float32))
        for shown in (env.picture(), many._picture(1, "", "#000000")):
            assert shown.force == pytest.approx((-force[0], force[0]), rel=1e-12)
            assert 0.0 < abs(shown.shares[1]) < 1.0


def test_the_arrow_of_a_semi_active_damper_has_a_scale_of_its_own():
    damper = LaggedSemiActiveDamper(c_min=100.0, c_max=3000.0, lag=0.01)
    mine = dataclasses.replace(scenario("mathworks-hump"), actuator=damper)
    scale = mine.reference.scale(signal("travel_rate"), mine)
    assert largest_forces(mine) == (3000.0 * scale, 3000.0 * scale)
