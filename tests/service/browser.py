"""A real Chromium without a window, driven over its DevTools protocol."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from tests.service.senders import until

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--remote-debugging-port=0", "--remote-allow-origins=*", "--hide-scrollbars",
)  # fmt: skip
KEYS = {"Enter": ("\r", 13), "Escape": ("", 27), "Tab": ("", 9), "ArrowDown": ("", 40)}
TOLD = ("Runtime.exceptionThrown", "Log.entryAdded", "Page.javascriptDialogOpening")


class Browser:
    """One page in one Chromium."""

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
        """What an expression in the page gives."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        """Until an expression gives something true."""
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
