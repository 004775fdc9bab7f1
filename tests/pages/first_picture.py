"""Seconds until the viewer shows a body: PYTHONPATH=tests python tests/pages/first_picture.py PAGE.html [TIMES].

The page is made by `twistcap view result.h5 --save PAGE.html`. It is opened in a headless Chromium, which draws in
software, at 1280 x 800 and 3840 x 2160 px; the median of so many times (3).
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median

from support.browser import Browser, end
from support.pages_shared import shows_a_body


def seconds(page: Path, size: tuple[int, int]) -> float:
    with Browser(size) as browser:
        return browser.first_picture(page.resolve().as_uri(), shows_a_body)


def main() -> None:
    page, times = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 3
    for size in ((1280, 800), (3840, 2160)):
        print(f"{size[0]} x {size[1]} px: {median(seconds(page, size) for _ in range(times)):.1f} s")
    end()


if __name__ == "__main__":
    main()
