"""The HTML report in a real browser: no errors, pickers that work, nothing broken to the eye."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import io
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest

from qcar_env.control import LAWS as LAWS_BY_NAME
from qcar_env.evaluation.benchmark import Outcome
from qcar_env.evaluation.bounds import Bound
from qcar_env.evaluation.comparison import PERIODS, Comparison
from qcar_env.evaluation.outcome import outcome
from qcar_env.evaluation.rollouts import Rollout
from qcar_env.evaluation.score import History, Row
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.plots.benchmark import LOOKS
from qcar_env.report.benchmark import benchmark
from qcar_env.report.comparison import comparison
from qcar_env.report.page import write
from qcar_env.scenarios import scenario

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)


def chromium() -> str | None:
    """Return the browser's path, or None where there is none."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


class Browser:
    """Headless Chromium, driven through its DevTools protocol."""

    def __init__(self, profile: Path) -> None:
        websocket = pytest.importorskip("websocket")
        program = chromium()
        assert program is not None
        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = self._port(profile)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            page = next(each for each in json.load(answer) if each["type"] == "page")
        self._socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=60)
        self._number = itertools.count(1)
        self.errors: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def _port(self, profile: Path) -> int:
        path = profile / "DevToolsActivePort"
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            with contextlib.suppress(FileNotFoundError, IndexError, ValueError):
                return int(path.read_text().splitlines()[0])
            assert self._process.poll() is None, "the browser ended at its start"
            time.sleep(0.05)
        raise TimeoutError("the browser did not open its port within 60 s")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and wait for its answer."""
        number = next(self._number)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv())
            self._note(message)
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def _note(self, message: dict[str, Any]) -> None:
        method, parameters = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning"):
            self.errors.append(str([each.get("value") for each in parameters["args"]]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
            self.errors.append(parameters["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])

    def open(self, path: Path, *, size: tuple[int, int], scheme: str = "light") -> None:
        """Open a file in a window of a size [px], with the light or the dark scheme."""
        self.errors.clear()
        self.requests.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=size[0] < 600,
        )
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        found = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression: str, seconds: float = 30.0) -> None:
        """Wait until a JavaScript expression is true."""
        deadline = time.monotonic() + seconds
        while not self.evaluate(expression):
            assert time.monotonic() < deadline, f"not true within {seconds} s: {expression}"
            time.sleep(0.02)

    def press(self, key: str, code: int) -> None:
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": "\r"} if key == "Enter" and kind == "keyDown" else {}
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **text
            )

    def screenshot(self, *, whole: bool = False) -> bytes:
        """Return a PNG of what is seen, or of the whole page."""
        found = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        return base64.b64decode(found["data"])

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait(timeout=20)


@contextlib.contextmanager
def browsing() -> Iterator[Browser]:
    """Give a browser with a fresh profile."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(Path(profile))
        try:
            yield browser
        finally:
            browser.close()


pytestmark = pytest.mark.skipif(
    chromium() is None, reason="no Chromium on this machine: apt-get install chromium"
)

LAWS = ("none", "cnvc", "lnvc", "ndf")
REFERENCE = Path(__file__).parent / "data" / "report.png"


def motion(amplitude: float) -> Rollout:
    """A car that swings by `amplitude` [m] at the paper's frequency, from rest."""
    base = scenario("paper")
    t = base.dt * np.arange(1, 2401)
    x = amplitude * (1.0 - np.exp(-t)) * np.sin(55.0 * t)
    v = np.gradient(x, t)
    force = np.column_stack([-3.0 * amplitude * v, -0.3 * v])
    return Rollout(
        t=t,
        x1=x,
        x2=1.4 * x,
        v1=v,
        v2=1.4 * v,
        force=force,
        reward=-np.abs(x),
        terminated=False,
        scenario=base,
        before=(float(x[0]), 1.4 * float(x[0]), float(v[0]), 1.4 * float(v[0])),
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of motions that are known."""
    base = scenario("paper")
    rollouts = {name: motion(1.1 / 2**number) for number, name in enumerate(LAWS)}
    outcomes = [outcome(name, each, periods=PERIODS) for name, each in rollouts.items()]
    found = Comparison(
        scenario=base,
        outcomes=tuple(outcomes),
        rollouts=rollouts,
        laws={name: LAWS_BY_NAME[name]() for name in LAWS},
        duration=12.0,
    )
    provenance = {"command": "qcar compare --report", "note": "</script> & <b>"}
    content = comparison(found, provenance)
    return write(tmp_path_factory.mktemp("report") / "report.html", content)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as found:
        yield found


READY = "document.documentElement.dataset.ready === 'true'"
DRAWN = "[...document.querySelectorAll('.chart')].every(each => each.dataset.drawn === 'true')"
WIDE, PHONE = (1280, 900), (390, 844)


def show(browser: Browser, path: Path, size: tuple[int, int] = WIDE, scheme: str = "light") -> None:
    """Open the report in a window as high as the page, so that every chart is drawn."""
    browser.open(path, size=size, scheme=scheme)
    browser.wait(READY)
    height = browser.evaluate("document.documentElement.scrollHeight")
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=size[0],
        height=height,
        deviceScaleFactor=1,
        mobile=size[0] < 600,
    )
    browser.wait(DRAWN)


def pixels(png: bytes) -> np.ndarray:
    return imageio.imread(io.BytesIO(png))[..., :3].astype(float)


def traces(browser: Browser, chart: str) -> list[str]:
    """Names of the traces of a chart that stand in its legend."""
    found = browser.evaluate(
        f"document.getElementById('{chart}').data.filter(each => each.showlegend)"
        ".map(each => each.name)"
    )
    return sorted(found)


@pytest.mark.parametrize(
    ("size", "scheme"), [(WIDE, "light"), (WIDE, "dark"), (PHONE, "light"), (PHONE, "dark")]
)
def test_it_opens_offline_without_an_error_and_fits_the_window(browser, path, size, scheme):
    show(browser, path, size, scheme)
    assert browser.errors == []
    own = [each for each in browser.requests if not each.startswith(("file:", "data:", "blob:"))]
    assert own == []
    assert browser.evaluate("document.documentElement.scrollWidth") <= size[0]
    dark = pixels(browser.screenshot())[:, :4].mean() < 128.0
    assert dark == (scheme == "dark")


def test_every_chart_has_ink_and_every_text_is_inside_its_chart(browser, path):
    show(browser, path)
    boxes = browser.evaluate(
        "[...document.querySelectorAll('.chart')].map(each => {"
        "const box = each.getBoundingClientRect();"
        "const inside = [...each.querySelectorAll('text')].every(text => {"
        "const t = text.getBoundingClientRect();"
        "return t.width === 0 || (t.left >= box.left - 1 && t.right <= box.right + 1"
        " && t.top >= box.top - 1 && t.bottom <= box.bottom + 1)});"
        "return [box.left, box.top, box.right, box.bottom, inside]})"
    )
    image = pixels(browser.screenshot())
    assert len(boxes) == 5
    for left, top, right, bottom, inside in boxes:
        area = image[int(top) : int(bottom), int(left) : int(right)]
        background = np.median(area.reshape(-1, 3), axis=0)
        ink = (np.abs(area - background).max(axis=2) > 60.0).mean()
        assert 0.004 < ink < 0.4
        assert inside


def test_it_looks_as_it_did(browser, path):
    show(browser, path)
    image = pixels(browser.screenshot())[:2000]
    # Means over tiles of 40 pixels: fonts may differ between machines, the layout may not.
    tiles = image.reshape(50, 40, 32, 40, 3).mean(axis=(1, 3))
    if os.environ.get("RENEW_REFERENCE"):  # after a wanted change; look at the page first
        imageio.imwrite(REFERENCE, tiles.round().astype(np.uint8))
    expected = imageio.imread(REFERENCE)[..., :3].astype(float)
    assert np.abs(tiles - expected).mean() < 6.0  # of 255; an absent chart is 10 and more


def test_it_is_interactive_within_two_seconds(browser, path):
    assert path.stat().st_size < 8e6
    best = np.inf
    for _ in range(3):  # other processes share the machine
        browser.open(path, size=WIDE)
        browser.wait(READY)
        browser.wait(
            "document.getElementById('motion').dataset.drawn === 'true' || scrollTo(0, 900)"
        )
        best = min(best, browser.evaluate("performance.now()"))
    assert best < 2000.0


def test_the_picker_shows_and_hides_policies(browser, path):
    show(browser, path)
    assert traces(browser, "motion") == ["CNVC", "LNVC", "NDF", "no control"]
    browser.evaluate("document.querySelector('#policies input[value=CNVC]').click()")
    for chart in ("motion", "phase"):
        assert traces(browser, chart) == ["LNVC", "NDF", "no control"]
    browser.evaluate("document.querySelector('#policies button[data-all=\"\"]').click()")
    assert traces(browser, "motion") == []
    browser.evaluate("document.querySelector('#policies button[data-all=true]').click()")
    assert traces(browser, "motion") == ["CNVC", "LNVC", "NDF", "no control"]
    assert browser.errors == []


def test_the_parts_of_a_history_are_the_rollouts(browser, path):
    show(browser, path)
    rollout = motion(1.1)
    for part, window in (("first", slice(0, 600)), ("last", slice(-116, None))):
        browser.evaluate(
            f"(() => {{const part = document.getElementById('part'); part.value = '{part}';"
            "part.dispatchEvent(new Event('change'))})()"
        )
        found = browser.evaluate(
            "document.getElementById('motion').data.filter(each => each.name === 'no control')"
            ".map(each => [Array.from(each.x), Array.from(each.y)])"
        )
        assert len(found) == 4  # x1, x2, and two forces
        columns = (rollout.x1, rollout.x2, rollout.force[:, 0], rollout.force[:, 1])
        for (t, y), column in zip(found, columns, strict=True):
            np.testing.assert_allclose(t, rollout.t[window], atol=1e-4)
            np.testing.assert_allclose(y, column[window], rtol=1e-6, atol=1e-6)  # 32 bits


def test_phase_planes_can_show_force_against_velocity(browser, path):
    show(browser, path)
    browser.evaluate(
        "(() => {const plane = document.getElementById('plane'); plane.value = 'force';"
        "plane.dispatchEvent(new Event('change'))})()"
    )
    title = browser.evaluate("document.getElementById('phase').layout.yaxis.title.text")
    assert title == "force on the wheel [m/s²]"
    assert browser.errors == []


def order(browser: Browser) -> list[str]:
    return browser.evaluate(
        "[...document.querySelector('table').tBodies[0].rows].map(row => row.cells[0].innerText)"
    )


def test_the_leaderboard_sorts_by_mouse_and_by_keyboard(browser, path):
    show(browser, path)
    ranked = ["NDF", "LNVC", "CNVC", "no control"]
    assert order(browser) == ranked
    head = "document.querySelectorAll('table')[0].tHead.rows[0].cells[1]"
    browser.evaluate(f"{head}.querySelector('button').click()")
    browser.evaluate(f"{head}.querySelector('button').click()")
    assert order(browser) == ranked[::-1]
    assert browser.evaluate(f"{head}.getAttribute('aria-sort')") == "descending"
    browser.evaluate("document.querySelectorAll('table')[0].querySelector('th button').focus()")
    browser.press("Enter", 13)
    assert order(browser) == sorted(ranked, key=str.lower)
    browser.press("Tab", 9)
    assert browser.evaluate(f"document.activeElement === {head}.querySelector('button')")


def test_the_theme_can_be_switched_by_keyboard(browser, path):
    show(browser, path)
    browser.evaluate("document.getElementById('theme').focus()")
    browser.press("Enter", 13)
    browser.wait("document.documentElement.dataset.theme === 'dark'")
    paper = browser.evaluate("document.getElementById('motion').layout.paper_bgcolor")
    assert paper == "#14171b"
    colour = browser.evaluate(
        "document.getElementById('motion').data.find(each => each.name === 'no control').line.color"
    )
    assert colour == "#e8eaed"  # black would not be seen


def test_text_is_not_taken_for_markup(browser, path):
    show(browser, path)
    found = browser.evaluate("[...document.querySelectorAll('dd')].map(each => each.innerText)")
    assert "</script> & <b>" in found


@pytest.fixture(scope="module")
def full_size(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark's report as large as the real one: every track, 45 policies."""
    rng = np.random.default_rng(0)
    names = [*LOOKS, *(f"policy {number}" for number in range(36))]
    cases = [(track, scale) for track in TRACKS.values() for scale in track.force_scales]
    rows, histories = [], {}
    numbers = [each.name for each in dataclasses.fields(Row) if each.type == "float"]
    t = 0.005 * np.arange(140)
    for track, scale in cases:
        for name in names:
            values = rng.uniform(0.1, 1.0, track.episodes)
            common = {"policy": name, "kind": "tuned", "reads": "full", "track": track.name}
            for episode, value in enumerate(values):
                rest = dict.fromkeys(numbers, float(value)) | {"force_scale": scale, "drawn": ""}
                rows.append(Row(**common, version=1, episode=episode, terminated=False, **rest))
            x = rng.normal(size=(140, 4))
            histories[(name, track.name, scale)] = History(t=t, x=x, force=x[:, :2])
    bounds = {
        (track.name, scale): (Bound(lower=0.05, upper=0.06),) * track.episodes
        for track, scale in cases
    }
    outcome = Outcome(
        tracks=tuple(TRACKS.values()),
        seed=None,
        rows=tuple(rows),
        histories=histories,
        bounds=bounds,
        failures=(),
    )
    content = benchmark(outcome, {"command": "a test"})
    return write(tmp_path_factory.mktemp("benchmark") / "report.html", content)


def test_the_full_benchmark_is_below_8_mb_and_interactive_within_two_seconds(browser, full_size):
    assert full_size.stat().st_size < 8e6
    best = np.inf
    for _ in range(3):  # other processes share the machine
        browser.open(full_size, size=WIDE)
        browser.wait(READY)
        best = min(best, browser.evaluate("performance.now()"))
    assert best < 2000.0
    show(browser, full_size)
    assert browser.errors == []
    assert browser.evaluate("document.documentElement.scrollWidth") <= WIDE[0]


def test_long_tables_can_be_filtered(browser, full_size):
    show(browser, full_size)
    metrics = f"table{len(TRACKS) + 1}"  # behind those of the tracks
    browser.evaluate(
        f"(() => {{const box = document.querySelector('[data-filter={metrics}]'); box.value = "
        "'cnvc budget 0.5'; box.dispatchEvent(new Event('input'))})()"
    )
    shown = browser.evaluate(
        f"[...document.querySelectorAll('[aria-labelledby={metrics}] tbody tr')]"
        ".filter(row => !row.hidden).map(row => row.innerText.split('\\t').slice(0, 3).join('|'))"
    )
    assert sorted(shown) == ["cnvc (tuned)|budget|0.50", "cnvc|budget|0.50"]


def test_histories_of_one_force_limit_are_shown_at_a_time(browser, full_size):
    show(browser, full_size)
    limits = browser.evaluate(
        "[...document.getElementById('group').options].map(each => each.value)"
    )
    assert limits[0] == "budget, force limit 1"
    count = browser.evaluate("document.getElementById('motion').data.length")
    browser.evaluate(
        "(() => {const group = document.getElementById('group'); group.selectedIndex = 2;"
        "group.dispatchEvent(new Event('change'))})()"
    )
    assert browser.evaluate("document.getElementById('motion').data.length") == count
