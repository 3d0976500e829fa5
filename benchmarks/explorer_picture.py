"""The picture that opens the README: the demo's loop by hand on the explorer's page.

    python -m benchmarks.explorer_picture        # writes docs/images/explorer.webp

It starts `residyn explore demo`, does with Chromium what a hand would do, and keeps what is seen.
"""

import argparse
import base64
import io
import subprocess
import sys
from pathlib import Path

from PIL import Image

from tests.chromium import driver, until

OUT = Path(__file__).parents[1] / "docs" / "images" / "explorer.webp"
SIZE = 1120, 760  # pixels of the window
WIDTH = 840  # of the picture
LABEL = "coulomb_friction:elbow"


class Film:
    """Frames of a page, and how long each is shown."""

    def __init__(self, browser):
        self.browser, self.frames, self.times = browser, [], []

    def keep(self, milliseconds: int) -> None:
        """What is seen now."""
        shot = self.browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})
        image = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
        size = WIDTH, round(image.height * WIDTH / image.width)
        self.frames.append(image.resize(size, Image.Resampling.LANCZOS))
        self.times.append(milliseconds)

    def save(self, path: Path) -> None:
        """As one animated picture."""
        first, *rest = self.frames
        first.save(
            path,
            save_all=True,
            append_images=rest,
            duration=self.times,
            loop=0,
            quality=80,
            method=6,
        )


def main() -> None:
    """Do the loop and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT)
    out = parser.parse_args().out
    command = [sys.executable, "-m", "residyn", "explore", "demo", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        browser = driver(*SIZE)
        try:
            browser.get(server.stdout.readline().strip())
            film = Film(browser)
            _loop(browser, film)
            film.save(out)
        finally:
            browser.quit()
            server.kill()
    print(f"{out}: {len(film.frames)} pictures, {out.stat().st_size / 1000:.0f} kB")


def _loop(browser, film: Film) -> None:
    def find(selector: str):
        return browser.find_elements("css selector", selector)

    def chip():
        return next(c for c in find(".chip") if c.get_attribute("data-effect") == LABEL)

    until(lambda: find(".chip"), 300)
    until(lambda: not find(".searching") and "Most probable" in find(".verdict")[0].text, 300)
    browser.execute_script("document.documentElement.style.scrollbarWidth = 'none'")
    film.keep(2600)
    browser.execute_script("arguments[0].focus({focusVisible: true})", chip())
    film.keep(900)
    browser.execute_script("arguments[0].click()", chip())
    for _ in range(6):
        film.keep(120)
    until(lambda: find(".status.refitted"), 300)
    until(lambda: "..." not in find(".status")[0].text, 300)
    browser.execute_script("document.activeElement.blur()")
    film.keep(3200)
    for panel in (1, 2):
        browser.execute_script(
            "document.querySelectorAll('.explorer > .panel')[arguments[0]].scrollIntoView()",
            panel - 1,
        )
        film.keep(2200)


if __name__ == "__main__":
    main()
