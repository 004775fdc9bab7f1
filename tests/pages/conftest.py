"""The browser of a worker ends with its tests."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from support import browser


@pytest.fixture(scope="session", autouse=True)
def one_browser() -> Generator[None]:
    yield
    browser.end()
