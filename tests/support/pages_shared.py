"""What the tests of the pages share: a studio session on disk, the command line, and looking at a screenshot."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from support.browser import CHROMIUM, Browser
from twistcap.arrays import AnyArray
from twistcap.body.limbs import named_limbs
from twistcap.cli import main
from twistcap.estimate import Estimate
from twistcap.io.result import ResultWriter
from twistcap.io.synthetic import write_session
from twistcap.pages.server import page_server
from twistcap.studio import StudioConfig, capture

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page with")
FRAMES = 6


def studio_walk(folder: Path) -> Path:
    """A studio session of a few small frames, and its truth as two results, one of which lost two of them."""
    scene = capture(StudioConfig(seed=1, views=3, size=(192, 140), frames=FRAMES))
    write_session(scene, folder, masks=False)
    videos = {name: str(folder / "videos" / f"{name}.mp4") for name in scene.rig.names}
    dof = scene.true_body.dof
    for name, lost in (("one", (2, 3)), ("two", ())):
        (folder / name).mkdir()
        with ResultWriter(folder / name / "result.h5", scene.true_body, scene.rig, {"videos": videos}) as writer:
            for k, pose in enumerate(scene.true_poses):
                doubt = np.where(named_limbs(scene.true_body)["arm_l"], 0.9 if k in lost else 0.1, 0.05)
                estimate = Estimate(k, k / 60, pose, 1e-4 * np.eye(dof), lost=k in lost, probability=doubt.max())
                writer.append(replace(estimate, part_probability=doubt, left_out=(1,) if k in lost[1:] else ()))
    return folder


def run(*arguments: object) -> int:
    """Exit code of a command line."""
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


@contextmanager
def served(text: str, answers: Any) -> Generator[str]:
    """The address at which a page is served meanwhile."""
    server = page_server(text, answers)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.url
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def asked(url: str, path: str = "/", body: str | None = None, **headers: str) -> tuple[int, str]:
    """Status and text of an answer below an address of this machine."""
    address = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=20)
    sent = {"Content-Type": "application/json", **headers}
    connection.request("GET" if body is None else "POST", address.path.rstrip("/") + path, body, sent)
    reply = connection.getresponse()
    return reply.status, reply.read().decode()


def picture(browser: Browser, path: Path) -> AnyArray:
    """A screenshot, RGB."""
    image = cv2.imread(str(browser.screenshot(path)))
    assert image is not None
    return image[..., ::-1].astype(int)


def paper(browser: Browser, path: Path) -> int:
    """Brightness of the page's corner, 0 to 255."""
    corner = cv2.imread(str(browser.screenshot(path, (8, 8))))
    assert corner is not None
    return int(corner[2, 2].max())


def shows_a_body(jpeg: bytes) -> bool:
    """Whether a picture of the viewer has a blue body in its upper half, above the time line and the plots."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    upper = image[: image.shape[0] // 2].astype(int)
    return bool((upper[..., 0] - upper[..., 2] > 60).sum() > 1000)


def has_colour(image: AnyArray, rgb: tuple[int, int, int], tolerance: int = 12, pixels: int = 30) -> bool:
    return bool((np.abs(image - rgb).max(axis=-1) <= tolerance).sum() >= pixels)


CONTROLS = "button:not([disabled]), input:not([disabled]), select, summary"


def unreachable(browser: Browser) -> list[str]:
    """Controls of a page that the tab key never comes to, or that a finger would miss: smaller than 16 px, or out of
    the page."""
    browser.run(f"window.controls = [...document.querySelectorAll('{CONTROLS}')]; window.visited = new Set()")
    browser.run("document.activeElement.blur(); addEventListener('focusin', (event) => visited.add(event.target))")
    browser.keys(int(browser.run("controls.length")) + 12, "Tab", 9)
    small = (
        "(r => Math.min(r.width, r.height) < 16 || r.left < 0 || r.right > innerWidth + 1)(c.getBoundingClientRect())"
    )
    scrolls = "!c.closest('#joints') && "  # the list of joints scrolls to the side on a phone
    missed = f"controls.filter(c => !visited.has(c) || ({scrolls}{small}))"
    return list(browser.run(f"{missed}.map(c => c.outerHTML.slice(0, 80))"))
