"""Makes the pictures of the page in `docs/pictures/`, from running services: `python web/tools/pictures.py [URL]`.

The services need a dataset `demos` of the world grid, and a fit of it: `freerein run collect --set task=grid
--set dataset=demos --set count=100`, then `freerein fit segmentation demos --set steps=400 --set augmentation=0`.
"""

import io
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

_FOLDER = Path(__file__).parents[2] / "docs/pictures"
_PATIENCE_MS = 60_000


def main(url: str = "http://127.0.0.1:8100") -> None:
    """Opens every view and photographs it once it has something to show."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name, (path, scheme, prepare) in _VIEWS.items():
            page = browser.new_page(viewport={"width": 1200, "height": 760}, color_scheme=scheme)
            page.set_default_timeout(_PATIENCE_MS)
            page.goto(url + path)
            prepare(page)
            page.wait_for_load_state("networkidle")
            _save(page.screenshot(full_page=name != "segments"), _FOLDER / f"web-{name}.png")
            page.close()
        browser.close()


def _save(screenshot: bytes, path: Path) -> None:
    """Saves a screenshot with 256 colours: a third of the bytes."""
    Image.open(io.BytesIO(screenshot)).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


def _segments(page: Page) -> None:
    page.get_by_role("slider", name="Time").wait_for()


def _policy(page: Page) -> None:
    page.get_by_role("button", name="Give the expert's images").click()
    page.get_by_role("button", name="Act").click()
    page.get_by_text(re.compile(r"Now landmark 3|Holding")).first.wait_for()
    page.get_by_role("button", name=re.compile("Pause|Act")).click(force=True)


def _reward(page: Page) -> None:
    page.get_by_role("img", name="Heatmap of a yellow block").wait_for()


def _runs(page: Page) -> None:
    page.get_by_role("link", name=re.compile("^fit ")).first.click()
    page.get_by_role("img", name=re.compile("train_loss")).wait_for()


def _data(page: Page) -> None:
    page.get_by_role("link", name="Look at its trajectories").first.wait_for()


def _services(page: Page) -> None:
    page.get_by_text("p99").last.wait_for()


_VIEWS: dict[str, tuple[str, str, Callable[[Page], None]]] = {
    "segments": ("/?t=7.5", "light", _segments),
    "policy": ("/?view=policy", "light", _policy),
    "reward": ("/?view=reward&at=17", "light", _reward),
    "runs": ("/?view=runs", "light", _runs),
    "data": ("/?view=data", "dark", _data),
    "services": ("/?view=services", "dark", _services),
}

if __name__ == "__main__":
    main(*sys.argv[1:])
