"""A Chromium that is installed, driven by playwright."""

import importlib.util
import shutil
from contextlib import contextmanager

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS = ("--no-sandbox", "--disable-background-networking", "--no-first-run", "--disable-component-update",
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # fmt: skip  # WebGL without a card


def found():
    paths = (shutil.which(name) for name in _NAMES)
    return next(filter(None, paths), None) if importlib.util.find_spec("playwright") else None


@contextmanager
def started():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found(), args=list(_OPTIONS))
        try:
            yield browser
        finally:
            browser.close()
