"""A headless Chromium driven over its debugging pipe (Chrome DevTools Protocol); standard library alone.

All pages of a worker are in one Chromium, which takes a second or more to start; each is in a context of its own, with
its own storage and cache, and is gone at its end.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_FLAGS = (
    "--headless=new --no-sandbox --disable-quic --no-first-run --disable-background-networking"
    " --disable-component-update --disable-sync --hide-scrollbars --use-angle=swiftshader"
    " --enable-unsafe-swiftshader --remote-debugging-pipe"
)


class _Chromium:
    """The process and its pipe; an answer or an event is a message."""

    def __init__(self) -> None:
        self._profile = tempfile.mkdtemp(prefix="twistcap-browser-")
        ours, theirs = os.pipe(), os.pipe()  # what we write and it reads; what it writes and we read
        self._write, self._read, self._buffer, self._count = ours[1], theirs[0], b"", 0
        command = [str(CHROMIUM), *_FLAGS.split(), f"--user-data-dir={self._profile}", "about:blank"]
        # Chromium reads from descriptor 3 and writes to 4.
        moved = f'exec 3<&{ours[0]} 4>&{theirs[1]}; exec "$@"'
        self._process = subprocess.Popen(
            ["bash", "-c", moved, "bash", *command], pass_fds=(ours[0], theirs[1]), start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(ours[0])
        os.close(theirs[1])

    @property
    def lives(self) -> bool:
        return self._process.poll() is None

    def send(self, session: str | None, method: str, parameters: dict[str, Any]) -> int:
        """The number that the answer to a command will have."""
        self._count += 1
        question: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if session is not None:
            question["sessionId"] = session
        os.write(self._write, json.dumps(question).encode() + b"\0")
        return self._count

    def message(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            chunk = os.read(self._read, 1 << 20)
            assert chunk, "the browser has gone"
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait(timeout=20)
        os.close(self._write)
        os.close(self._read)
        shutil.rmtree(self._profile, ignore_errors=True)


_running: list[_Chromium] = []  # one at most


def _chromium() -> _Chromium:
    if _running and not _running[0].lives:
        end()
    if not _running:
        _running.append(_Chromium())
    return _running[0]


def end() -> None:
    """Ends the Chromium of this process, if there is one."""
    while _running:
        _running.pop().end()


class Browser:
    """One page in a context of its own. Use as a context manager."""

    def __init__(self, size: tuple[int, int] = (1300, 900)) -> None:
        self._chromium, self._session, self._answers = _chromium(), None, dict[int, dict[str, Any]]()
        self.problems: list[str] = []
        self._frames: list[tuple[float, dict[str, Any]]] = []  # of the screencast, with their times of arrival
        self._context = self.call("Target.createBrowserContext")["browserContextId"]
        page = self.call(
            "Target.createTarget", url="about:blank", browserContextId=self._context, width=size[0], height=size[1]
        )
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session: str | None = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)  # whichever window was opened last
        self.resize(*size)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command and its answer; what the page complains of meanwhile goes to `problems`."""
        return self._answer(self._chromium.send(self._session, method, parameters))

    def _answer(self, number: int) -> dict[str, Any]:
        while number not in self._answers:
            message = self._chromium.message()
            if "id" in message:
                self._answers[message["id"]] = message
            elif message.get("sessionId") == self._session:
                self._note(message)
        answer = self._answers.pop(number)
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.problems.append(_told(parameters["exceptionDetails"]))
        if message.get("method") == "Page.screencastFrame":
            self._frames.append((time.monotonic(), parameters))
        if message.get("method") == "Network.requestWillBeSent":
            url = parameters["request"]["url"]
            if not url.startswith(("data:", "blob:", "file:", "http://127.0.0.1")):
                self.problems.append(f"asked the network for {url}")

    def open(self, url: str, ready: str = "document.body.dataset.ready === 'yes'") -> None:
        self.call("Page.navigate", url=url)
        self.wait(ready)

    def first_picture(self, url: str, shows: Callable[[bytes], bool], seconds: float = 60.0) -> float:
        """Opens a page. Seconds from then until a picture (JPEG) of it is here that `shows` what is wanted."""
        self.call("Page.startScreencast", format="jpeg", quality=60)
        start = time.monotonic()
        self.call("Page.navigate", url=url)
        while time.monotonic() < start + seconds:
            for arrived, frame in self._frames:
                if shows(base64.b64decode(frame["data"])):
                    self.call("Page.stopScreencast")
                    return arrived - start
                self.call("Page.screencastFrameAck", sessionId=frame["sessionId"])
            self._frames.clear()
            self.run("0")
        raise AssertionError(f"the page never showed it; {self.problems}")

    def run(self, script: str) -> Any:
        """Value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, _told(answer["exceptionDetails"])
        return answer["result"].get("value")

    def wait(self, condition: str, seconds: float = 60.0) -> None:
        """Until an expression is true."""
        end = time.monotonic() + seconds
        while not self.run(f"Boolean(document.body && ({condition}))"):
            assert time.monotonic() < end, f"never came true: {condition}; {self.problems}"
            time.sleep(0.05)

    def drawn(self) -> None:
        """Until all that was asked for so far is drawn: the 3D view draws with the screen's next picture."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def mouse(self, kind: str, x: float, y: float, button: str = "left") -> None:
        held = 1 if kind != "mouseReleased" and button == "left" else 0
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=held, clickCount=1)

    def click(self, x: float, y: float) -> None:
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.mouse("mousePressed", *start)
        for share in (0.25, 0.5, 0.75, 1.0):
            self.mouse("mouseMoved", *(a + share * (b - a) for a, b in zip(start, end, strict=True)))
        self.mouse("mouseReleased", *end)

    def key(self, key: str, code: int = 0, text: str = "", shift: bool = False) -> None:
        """One key pressed and let go, with the code that Windows has for it."""
        self.keys(1, key, code, text, shift)

    def keys(self, times: int, key: str, code: int = 0, text: str = "", shift: bool = False) -> None:
        """One key several times, as fast as the page takes it: a large page is drawn once for many of them."""
        about: dict[str, Any] = {"key": key, "windowsVirtualKeyCode": code, "modifiers": 8 if shift else 0}
        down, up = {"type": "keyDown", **about, **({"text": text} if text else {})}, {"type": "keyUp", **about}
        events = (down, up) * times
        for number in [self._chromium.send(self._session, "Input.dispatchKeyEvent", event) for event in events]:
            self._answer(number)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """All fingers that are down now."""
        fingers = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)

    def prefer(self, scheme: str) -> None:
        """Pretend that the system is dark or light."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def resize(self, width: int, height: int) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def centre(self, selector: str) -> tuple[float, float]:
        """Of an element, in px of the screen."""
        box = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        x, y = self.run(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({box})")
        return x, y

    def screenshot(self, path: Path, size: tuple[int, int] | None = None) -> Path:
        """What is seen once all that was asked for is drawn; only so much of the upper left as `size` says."""
        self.drawn()
        part = {} if size is None else {"clip": {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1}}
        content = self.call("Page.captureScreenshot", format="png", **part)["data"]
        path.write_bytes(base64.b64decode(content))
        return path

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._chromium.lives:
            return
        self._session = None
        self.call("Target.disposeBrowserContext", browserContextId=self._context)


def _told(details: dict[str, Any]) -> str:
    """An exception in a few words: the libraries' data URLs are a megabyte long."""
    text = str(details.get("exception", {}).get("description") or details.get("text"))
    return re.sub(r"data:[\w/;,+=]*", "data:", text)[:500]
