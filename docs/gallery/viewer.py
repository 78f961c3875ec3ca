# SPDX-License-Identifier: Apache-2.0
"""Pictures of the viewer, in a browser that draws by the processor."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image, ImageChops

from gallery.browser import Tab, tab
from gallery.run import Source, saved
from skymoor.results.viewer import Page

SIZE = (1200, 760)
PORT = 8791
DRAWN_S = 12.0  # at least, until all is drawn without a graphics card
STEADY = 3  # equal pictures one after the other
WARNING = "document.querySelector('.mantine-Notification-closeButton')?.click()"


@contextmanager
def _shown(source: Source) -> Iterator[tuple[Page, Tab]]:
    """The run with everything loaded."""
    page = Page(source.result, PORT)
    try:
        for line in page.load():
            print(line)
        with tab() as browser:
            browser.resize(*SIZE)
            browser.open(page.address)
            browser.until("document.querySelectorAll('canvas').length > 0")
            time.sleep(DRAWN_S)
            browser.run(WARNING)  # that there is no graphics card
            yield page, browser
    finally:
        page.stop()


def _settled(browser: Tab) -> Image.Image:
    """The picture once nothing moves in it any more: layers come one by one, and fade in."""
    before, same = browser.picture(), 0
    while same < STEADY:
        time.sleep(DRAWN_S / 2)
        now = browser.picture()
        same = same + 1 if ImageChops.difference(before, now).getbbox() is None else 0
        before = now
    return before


def _set(page: Page, label: str, value: object) -> None:
    """As if somebody had used the switch of that label."""
    handles = page._server.gui._gui_input_handle_from_uuid.values()
    next(one for one in handles if getattr(one, "label", None) == label).value = value


def viewer(source: Source, path: Path) -> None:
    """The model by its confidence, and the cameras with their ellipsoids relative to the reference, enlarged."""
    with _shown(source) as (page, browser):
        _set(page, "satellite", value=False)
        _set(page, "colours", "confidence")
        _set(page, "ellipsoids (90 %)", "relative to the reference")
        _set(page, "enlarged", 4)
        saved(_settled(browser), path, 1100)


def viewer_measure(source: Source, path: Path) -> None:
    """A distance between two clicks, and the photo of a camera."""
    with _shown(source) as (page, browser):
        _set(page, "camera", source.result.registered_cameras[0].image)
        _set(page, "distance", value=True)
        time.sleep(2)
        for x, y in ((0.28, 0.55), (0.42, 0.72)):
            browser.click(x * SIZE[0], y * SIZE[1])
            time.sleep(3)
        saved(_settled(browser), path, 1100)
