"""The film has the asked length, speed and size, and shows the asked policies."""

import re
import shutil
import subprocess

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest

from qcar_env import agents
from qcar_env.commands import command, watch
from qcar_env.plots.film import drive, look

SHORT = ["--duration", "0.2", "--wait", "0.05", "--size", "320", "240"]


def parsed(argv):
    return command.parser("watch", "", watch.OPTIONS).parse_args(argv)


def frames_of(path, width, height):
    """Decode a film: array (frames, height, width, 3)."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path)]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, dtype=np.uint8).reshape(-1, height, width, 3)


def test_an_mp4_has_the_length_and_size_that_were_asked_for(tmp_path, capsys):
    path = tmp_path / "film.mp4"
    assert watch.main([*SHORT, "--slow", "10", "--fps", "20", "--out", str(path)]) == 0
    # 0.2 s ten times slower at 20 frames a second, and the start
    assert frames_of(path, 640, 240).shape == (41, 240, 640, 3)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)]  # describes it, then complains
    described = subprocess.run(command, capture_output=True, text=True).stderr
    assert re.search(r" 20 fps", described)
    assert "10 times slower" in capsys.readouterr().out
    assert [each.name for each in tmp_path.iterdir()] == ["film.mp4"]


def test_a_gif_shows_each_policy_in_its_own_colour(tmp_path):
    path = tmp_path / "film.gif"
    arguments = [*SHORT, "--policy", "cnvc", "--vs", "none", "lnvc", "--out", str(path)]
    assert watch.main(arguments) == 0
    frames = imageio.imread(path)
    assert frames.shape[1:] == (240, 960, 3)
    last = frames[-1].astype(int)
    for place, colour in enumerate([(0, 114, 178), (0, 0, 0), (230, 159, 0)]):
        panel = last[30:160, 320 * place : 320 * (place + 1)]
        near = np.abs(panel - colour).max(axis=2) < 12  # a palette of 64 colours
        assert near.sum() > 500


def test_the_policies_wait_and_then_act():
    arguments = parsed([*SHORT, "--policy", "cnvc"])
    film = watch.film_of(arguments)
    actions = [env.picture().force for env in drive(film.entries[0], film)]
    begin = round(film.wait / film.scenario.dt / film.stride)
    assert not np.any(actions[: begin + 1])
    assert np.all(np.any(actions[begin + 1 :], axis=1))


def test_the_cars_meet_the_same_road_from_the_same_start():
    film = watch.film_of(parsed([*SHORT, "--start", "rest"]))
    for a, b in zip(drive(film.entries[0], film), drive(film.entries[1], film), strict=True):
        assert a.time == b.time
        assert a.episode == b.episode
        if a.time == 0.0:
            assert a.state == b.state == (0.0, 0.0, 0.0, 0.0)


def test_the_film_has_the_wanted_speed_at_any_rate():
    for slow, fps in ((1.0, 25.0), (4.0, 24.0), (0.5, 60.0), (100.0, 30.0)):
        film = watch.film_of(parsed([*SHORT, "--slow", str(slow), "--fps", str(fps)]))
        simulated = (film.length - 1) * film.stride * film.scenario.dt
        assert (film.length - 1) / film.rate == pytest.approx(simulated * slow)


def test_without_a_display_a_file_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(watch, "_has_display", lambda: False)
    assert watch.main([*SHORT, "--policy", "pd"]) == 0
    assert (tmp_path / "results" / "watch" / "pd-vs-none.mp4").stat().st_size > 1000


def test_on_a_display_the_film_is_shown_until_the_window_closes(monkeypatch):
    from qcar_env.envs.rendering import Window

    shown = []

    def show(self, frame, fps):
        shown.append(frame.shape)
        return len(shown) < 3

    monkeypatch.setattr(watch, "_has_display", lambda: True)
    monkeypatch.setattr(Window, "show", show)
    assert watch.main([*SHORT]) == 0
    assert shown == [(240, 640, 3)] * 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "cnvcc"], "did you mean 'cnvc'"),
        (["--scenario", "papr"], "did you mean 'paper'"),
        (["--out", "film.avi"], "unknown film format '.avi'"),
        (["--scenario", "paper-hump", "--start", "steady"], "use --start rest"),
        (["--slow", "0"], "slow must be positive"),
        (["--duration", "-1"], "duration must be positive"),
        (["--duration", "0"], "duration must be positive, got 0 s"),
        (["--duration", "1e-9"], "film must have 2 to 1000000 frames"),
        (["--fps", "1e-9"], "film must have 2 to 1000000 frames"),
        (["--slow", "1e9"], "0.01 to 1000 of them a second, got 41 at 2e-07 a second"),
        (["--slow", "1e-320"], "film must have 2 to 1000000 frames"),
        (["--slow", "5e-324", "--fps", "5e-324"], "film must have 2 to 1000000 frames"),
        (["--slow", "1e300", "--fps", "1e300"], "film must have 2 to 1000000 frames"),
        (["--duration", "1e308"], "film must have 2 to 1000000 frames"),
        (["--size", "10", "240"], "frame width"),
        (["--size", "320", "100000000"], "size must be at most 4096 px wide and high, got 320 x"),
    ],
)
def test_bad_input_is_refused_and_writes_nothing(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(watch, "_has_display", lambda: False)
    assert watch.main([*SHORT, *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not [each for each in tmp_path.rglob("*") if each.is_file()]


# imageio leaves its pipe to the garbage collector where ffmpeg is gone
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("duration", ["0.05", "1"])  # ffmpeg writes at the end, or before
def test_a_film_that_the_disk_takes_in_part_is_not_called_written(duration, tmp_path, capfd):
    resource = pytest.importorskip("resource")
    allowed = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, allowed[1]))
    try:
        given = ["--duration", duration, "--wait", "0", "--out", str(tmp_path / "film.mp4")]
        assert watch.main(given) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, allowed)
    printed, said = capfd.readouterr()
    assert said == "watch: ffmpeg wrote no whole film; is there space on the disk?\n"
    assert printed == ""
    assert not list(tmp_path.iterdir())


def test_the_film_of_a_run_folder_is_called_after_the_folder_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(watch, "_has_display", lambda: False)
    shutil.copytree(agents.load.PRETRAINED / "ppo-paper", tmp_path / "runs" / "mine")
    assert watch.main([*SHORT, "--policy", str(tmp_path / "runs" / "mine")]) == 0
    assert list(tmp_path.rglob("*.mp4")) == [tmp_path / "results" / "watch" / "mine-vs-none.mp4"]


def test_tuned_laws_and_agents_drive_too(tmp_path):
    names = watch.policies()
    assert "lnvc-tuned" in names
    assert look(names["lnvc-tuned"]).color == look(names["lnvc"]).color
    for name in ("lnvc-tuned", *(each for each in names if each.startswith(("ppo", "sac")))):
        film = watch.film_of(parsed([*SHORT, "--policy", name, "--start", "rest"]))
        actions = [env.picture().force for env in drive(film.entries[0], film)]
        assert np.any(actions[-1])


def test_a_smaller_force_limit_is_the_agents_to_see():
    film = watch.film_of(parsed([*SHORT, "--force-scale", "0.5"]))
    env = next(drive(film.entries[0], film))
    np.testing.assert_allclose(env.force_limit, 0.5 * np.array(film.scenario.actuator.limit))
    assert env.scenario.actuator.limit == pytest.approx(tuple(env.force_limit))
