"""A Chromium without a window, driven through its own debugging protocol: no driver and no further
package."""

import itertools
import json
import shutil
import subprocess
import time
from contextlib import contextmanager

import pytest
from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
START_s, ANSWER_s = 60.0, 60.0  # a busy machine takes long
WINDOW = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}
# --no-sandbox: root has none; pages are the tests' own
FLAGS = "--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --remote-debugging-port=0"
# nothing but the page is fetched
SILENT = "--no-first-run --disable-background-networking --disable-component-update --disable-sync"
SILENT += " --disable-quic"


class Page:
    """One open page.

    Attributes:
        complaints: messages of the console since the page was opened: errors, warnings,
            exceptions, loads that failed or were refused.
    """

    def __init__(self, socket):
        self.complaints = []
        self._socket, self._numbers, self._session = socket, itertools.count(1), {}
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._session = {"sessionId": session}
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        """Return the browser's answer to one method; complaints that come before it are kept."""
        number = next(self._numbers)
        self._socket.send(
            json.dumps({"id": number, "method": method, "params": params} | self._session)
        )
        while True:
            said = json.loads(self._socket.recv(ANSWER_s))
            if said.get("id") == number:
                assert "error" not in said, f"{method}: {said['error']}"
                return said["result"]
            self._hear(said)

    def _hear(self, said):
        method, params = said["method"], said["params"]
        level = params.get("entry", params).get("level") or params.get("type")
        if level in ("error", "warning") or method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(params))

    def open(self, path):
        """Show a file in a window of 1280 × 800 pixels, and wait until all of it is there."""
        self.complaints.clear()
        url = path.resolve().as_uri()
        self.call("Emulation.setDeviceMetricsOverride", **WINDOW)
        self.call("Page.navigate", url=url)
        end = time.monotonic() + ANSWER_s
        while self.read("location.href + document.readyState") != f"{url}complete":
            assert time.monotonic() < end, f"{path} doesn't load"
            time.sleep(0.05)

    def read(self, expression):
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def press(self, key, times=1):
        for kind in ("keyDown", "keyUp") * times:
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def click(self, selector, share=0.5):
        box = f"document.querySelector('{selector}').getBoundingClientRect()"
        self.read(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
        x, y = self.read(f"[{box}.left + {share} * {box}.width, {box}.top + {box}.height / 2]")
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


@contextmanager
def open_browser(profile):
    """Start a browser whose files all lie in ``profile``, an empty folder; end it afterwards."""
    executable = next(filter(None, map(shutil.which, NAMES)), None)
    if executable is None:
        pytest.skip("no Chromium on this machine: the page isn't tried in a browser")
    flags = [*FLAGS.split(), *SILENT.split(), f"--user-data-dir={profile}"]
    words = [executable, *flags, "about:blank"]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            port, place = _address(process, profile / "DevToolsActivePort")
            with connect(f"ws://127.0.0.1:{port}{place}", max_size=None, proxy=None) as socket:
                yield Page(socket)
        finally:
            process.terminate()


def _address(process, file):
    """Return port and path of the protocol, which the browser writes when it is ready."""
    end = time.monotonic() + START_s
    while not file.is_file() or len(lines := file.read_text().split()) < 2:
        assert process.poll() is None and time.monotonic() < end, "the browser doesn't start"
        time.sleep(0.05)
    return lines
