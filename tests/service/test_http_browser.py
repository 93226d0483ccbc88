"""The page in a real Chromium: alarms come in, are acknowledged by keyboard, and names stay text."""

import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdd.service.queues import Event
from fdd.service.status import Bands, Series
from tests.service.fake import World, made_up, on_a_port, three_tokens
from tests.service.senders import until

pytestmark = pytest.mark.slow
EVIL = """<script>window.evil=1</script><img src=x onerror="window.evil=1">"""
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--remote-debugging-port=0", "--remote-allow-origins=*", "--hide-scrollbars",
)  # fmt: skip
KEYS = {"Enter": ("\r", 13), "Escape": ("", 27), "Tab": ("", 9), "ArrowDown": ("", 40)}
TOLD = ("Runtime.exceptionThrown", "Log.entryAdded", "Page.javascriptDialogOpening")


class Browser:
    """One page in one Chromium without a window, driven over its DevTools protocol."""

    def __init__(self) -> None:
        if CHROMIUM is None:
            pytest.skip("no Chromium on this machine")
        connect = pytest.importorskip("websockets.sync.client", reason="needs websockets").connect
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={self._folder.name}", "about:blank"]
        self._process = subprocess.Popen(command, **quiet)
        told = Path(self._folder.name) / "DevToolsActivePort"
        until(lambda: told.exists() and told.read_text().count("\n"), 60.0)
        port, path = told.read_text().splitlines()[:2]
        self._line = connect(f"ws://127.0.0.1:{port}{path}", max_size=1 << 26, proxy=None)
        self._number, self._session = 0, ""
        self.said: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.size()

    def size(self, width: int = 1280) -> None:
        """Make the window so wide; below 600 as a phone."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def close(self) -> None:
        self._line.close()
        self._process.terminate()
        self._process.wait(20)
        self._folder.cleanup()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._line.send(json.dumps(message))
        while True:
            heard = json.loads(self._line.recv(timeout=60))
            advice = heard.get("params", {}).get("entry", {}).get("level") in ("verbose", "info")
            if heard.get("method") in TOLD and not advice:
                self.said.append(json.dumps(heard["params"])[:600])
            if heard.get("id") == self._number:
                assert "error" not in heard, heard
                return dict(heard["result"])

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        end = time.monotonic() + seconds
        # While a page loads there may be no document yet.
        asked = f"(() => {{ try {{ return !!({script}) }} catch {{ return false }} }})()"
        while not (found := self.run(asked)):
            says = self.run("document.body?.innerText") or ""
            assert time.monotonic() < end, f"never true: {script}; it says {says[:600]!r}, {self.said}"
            time.sleep(0.1)
        return found

    def press(self, key: str) -> None:
        text, code = KEYS.get(key, (key, ord(key[0].upper())))
        name = key if key in KEYS else f"Key{key.upper()}"
        named = {"key": key, "windowsVirtualKeyCode": code, "code": name}
        self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **named)
        self.call("Input.dispatchKeyEvent", type="keyUp", **named)

    def type(self, text: str) -> None:
        self.call("Input.insertText", text=text)


@pytest.fixture
def world() -> World:
    return made_up()


@pytest.fixture
def server(world):
    with on_a_port(world) as made:
        yield made


@pytest.fixture(scope="module")
def chromium():
    """One for all tests, as it takes seconds to start."""
    made = Browser()
    yield made
    made.close()


@pytest.fixture
def browser(chromium):
    chromium.open("about:blank")
    chromium.wait("location.href === 'about:blank'")
    chromium.said.clear()  # of a server that was ended
    yield chromium
    assert chromium.said == [], "errors in the page"


def text(selector: str) -> str:
    return f"document.querySelector('{selector}')?.innerText"


def test_an_alarm_is_acknowledged_by_keyboard(browser, server, world):
    browser.open(f"{server.address}#/alarms")
    browser.wait(f"{text('#live')} === 'Live' && {text('#badge')} === '2'")
    count = "performance.getEntriesByType('resource').filter((e) => e.name.endsWith('/api/axes')).length"
    # Far from the next time that the page asks by itself: what comes now came by the event.
    browser.run(f"window.asked = {count}")
    browser.wait(f"{count} > window.asked")
    begun = time.monotonic()
    id = world.raise_alarm("F3/rudder", "urgent", fault="check_valve_clogged", family="check_valve")
    browser.wait(f"{text('#badge')} === '3'")
    assert time.monotonic() - begun < 3.0, "by the event, not by asking every five seconds"
    assert "New urgent alarm on F3/rudder" in browser.run(text("#news"))
    assert browser.run("document.querySelector('#news').getAttribute('aria-live')") == "assertive"
    assert browser.run("document.title").startswith("(3)")
    assert browser.run("document.querySelector('[data-alarm]').dataset.alarm") == str(id), "the worst first"
    browser.press("ArrowDown")
    browser.wait(f"document.activeElement.dataset.alarm === '{id}'")
    browser.press("a")
    browser.wait("document.querySelector('dialog')?.open")
    browser.type("Checked on the rig")
    assert world.state_of(id) == "UNACK", "asked for confirmation first"
    browser.press("Enter")
    browser.wait("!document.querySelector('dialog')")
    browser.wait(f"{text('#badge')} === '2'")
    alarm = world.store.alarm(id) or {}
    assert (alarm["state"], alarm["note"]) == ("ACKED", "Checked on the rig")
    assert browser.run("document.activeElement.dataset.alarm") == str(id), "the focus comes back"


def test_search_and_filters(browser, server):
    browser.open(server.address)
    rows = "document.querySelectorAll('.fleet tbody tr').length"
    browser.wait(f"{rows} === 8")
    assert browser.run(text(".fleet tbody tr th a")) == "F7/aileron-R", "worst first"
    browser.press("/")
    browser.wait("document.activeElement.id === 'search'")
    browser.type("rig-2")
    browser.wait(f"{rows} === 2")
    browser.press("Escape")
    browser.wait(f"{rows} === 8")
    silent = "[...document.querySelectorAll('.counts button')].find((b) => b.innerText.includes('Silent'))"
    browser.run(f"{silent}.click()")
    browser.wait(f"{rows} === 1")


def test_each_page_says_what_is_so_and_in_whose_time(browser, server, world):
    status = world.details["F7/aileron-R"].status
    status.silent, status.zone, status.clock, status.last_wall = True, "Asia/Tokyo", 1.7e9, 1.7e9 + 600.0
    nothing = dict.fromkeys(("estimates", "misfits", "probabilities"), Series()) | {"signals": Bands()}
    world.details["F3/rudder"] = world.details["F3/rudder"].model_copy(update=nothing)
    line = {"name": "line", "connected": True, "received": 7, "refused": 1, "last_error": "no time in it"}
    world.health["sources"] = {"line": line}
    browser.open(f"{server.address}#/")
    browser.wait(f"{text('#main')}.includes('no time in it')")
    for state, count in {"unacknowledged": "2", "in alarm": "3", "silent": "2"}.items():
        assert browser.run(text(f'[data-key="count {state}"] b')) == count
    browser.open(f"{server.address}#/axis/F7%2Faileron-R")
    browser.wait(f"{text('#main')}.includes('What was found')")
    said = browser.run(text("#main"))
    assert "Since 2023-11-15 07:20:08 GMT+9, detected 2023-11-15 07:20:24 GMT+9" in said
    assert "2023-11-15 07:23:20" in said and "Silent" in said and "\nnow" not in said
    browser.open(f"{server.address}#/axis/F3%2Frudder")
    browser.wait(f"{text('#main')}.includes('after five seconds of data')")


def test_each_chart_has_a_scale_of_figures_that_differ(browser, server):
    rng = np.random.default_rng(3)
    least = 10.0 ** rng.uniform(-3, 6, 200) * rng.choice([-1, 1], 200)
    drawn = np.stack([least, least + 10.0 ** rng.uniform(-4, 6, 200)], axis=1)
    ranges = [*drawn.tolist(), [0.0, 0.0], [-300.0, 300.0], [99.9, 100.1]]
    browser.open(server.address)
    browser.wait("document.querySelector('.fleet tbody tr')")
    scales = browser.run(f"""(async () => {{
        const {{ chart }} = await import("/page/charts.js");
        const nodes = {ranges}.map((values) => chart(
            {{ title: "x", time: [0, 1], stamp: () => "", rows: [{{ label: "x", values }}] }}));
        document.querySelector("main").replaceChildren(...nodes);
        await new Promise((drawn) => setTimeout(drawn, 500));
        const labels = (node) => [...node.querySelectorAll("svg text")].map((e) => e.textContent);
        return nodes.map((node) => labels(node).filter(Boolean));
    }})()""")
    for values, scale in zip(ranges, scales, strict=True):
        assert 2 <= len(scale) == len({*scale}) <= 6, (values, scale)


def test_everything_fits_the_window_and_is_reached_by_tab_in_sight(browser, server):
    for view in ("", "#/alarms", "#/axis/F7%2Faileron-R", "#/history"):
        browser.open("about:blank")
        browser.open(f"{server.address}{view}")
        browser.wait("document.querySelector('main h1')")
        time.sleep(1.0)
        for width in (390, 1280):
            browser.size(width)
            browser.wait(f"document.documentElement.scrollWidth <= {width}")
        reached = "a[href], button, input, select, [tabindex='0']"
        wanted = browser.run(f"""[...document.querySelectorAll("{reached}")]
            .filter((e) => e.checkVisibility() && !e.disabled).length""")
        seen = set()
        for _ in range(wanted):
            browser.press("Tab")
            at = browser.run("""(() => { const e = document.activeElement;
                const all = [...document.querySelectorAll('*')];
                return [all.indexOf(e), getComputedStyle(e).outlineStyle, e.tagName]; })()""")
            assert at[1] != "none", at
            seen.add(at[0])
        assert len(seen) == wanted, view


def test_markup_in_names_and_notes_runs_nothing(browser, server, world):
    world.details[EVIL] = world.details["F7/rudder"].model_copy(deep=True)
    status = world.details[EVIL].status
    status.name = status.headline = status.unit = EVIL
    world.raise_alarm(EVIL, "urgent", fault=EVIL, family=EVIL, channel=EVIL, note=EVIL)
    with world.store.transaction() as t:
        t.audit(time.time(), EVIL, EVIL, axis=EVIL, note=EVIL)
    for view in ("#/", "#/alarms", "#/history", "#/axis/" + browser.run(f"encodeURIComponent({EVIL!r})")):
        browser.open(f"{server.address}{view}")
        browser.wait(f"document.querySelector('main').innerText.includes({EVIL!r})")
        world.bus.publish(Event("alarm", EVIL, 0.0, {"note": EVIL}))
        time.sleep(0.5)
    assert browser.run("window.evil") is None
    assert browser.run("document.querySelectorAll('main script, main img').length") == 0


def test_a_lost_connection_and_a_store_in_trouble_are_told(browser, world):
    world.health |= {"status": "degraded", "problems": ["fdd.db: the store is locked"]}
    with on_a_port(world) as server:
        browser.open(server.address)
        browser.wait(f"{text('#banner')}?.includes('the store is locked')")
        world.health |= {"status": "ok", "problems": []}
        browser.wait(f"!{text('#banner')}")
    browser.wait(f"{text('#live')} === 'Not live' && {text('#banner')}?.includes('does not answer')")
    browser.said = [line for line in browser.said if "ERR_" not in line]


def test_a_token_is_asked_for_and_view_may_not_act(browser, world):
    tokens, secret = three_tokens()
    with on_a_port(world, tokens=tokens) as server:
        browser.open(server.address)
        browser.wait("document.activeElement.name === 'token'")
        fleet = "document.querySelectorAll('.fleet tbody tr').length === 8"
        for token, then in (("guess", f"{text('.problem')} === 'unknown token'"), (secret["view"], fleet)):
            browser.type(token)
            browser.press("Enter")
            browser.wait(then)
        assert browser.run(text("#who")) == "view-person (view)"
        assert browser.run("document.cookie") == "", "scripts never see it"
        browser.run("location.hash = '#/alarms'")
        browser.wait("document.querySelector('[data-alarm]')")
        assert browser.run("document.querySelectorAll('.actions button').length") == 0
        browser.press("a")
        time.sleep(0.3)
        assert not browser.run("!!document.querySelector('dialog')")
        browser.run("document.querySelector('#logout').click()")
        browser.wait("document.activeElement.name === 'token'")
    browser.said = [line for line in browser.said if '"source": "network"' not in line]
