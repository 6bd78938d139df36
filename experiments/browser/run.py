"""Milliseconds a frame of the demo page in Chromium, fed by a fake webcam; or a screenshot of the page.

A measurement is added to those in the output.
"""

import argparse
import json
import os
import platform
import shutil
import statistics
import tempfile
import threading
from pathlib import Path

import cv2
import skimage.data
from playwright.sync_api import Browser, Playwright, sync_playwright

from eldenet.demo import open_server

FRAMES = 100  # the page keeps the times of as many
STATE = "import('./app.js').then(({ state }) => state)"


def main() -> None:
    """Build the page once, and open it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path, help="folder that eldenet demo serve=false output=... wrote")
    parser.add_argument("--output", type=Path, default=Path("experiments/browser/results.json"))
    parser.add_argument("--screenshot", type=Path, help="write a picture of the page instead")
    given = parser.parse_args()
    server = open_server(given.page, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://localhost:{server.server_port}/"
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = launch(playwright, Path(folder) / "webcam.y4m")
        if given.screenshot:
            screenshot(browser, address, given.screenshot)
        else:
            found = measure(browser, address)
            earlier = json.loads(given.output.read_text()) if given.output.exists() else []
            given.output.write_text(json.dumps([*earlier, found], indent=2) + "\n")
            print(json.dumps(found, indent=2))
        browser.close()
    server.shutdown()


def launch(playwright: Playwright, film: Path) -> Browser:
    """Start Chromium with a webcam of 640 x 480 that shows a table."""
    scene = cv2.resize(skimage.data.coffee()[:, :533], (640, 480), interpolation=cv2.INTER_AREA)
    planes = cv2.cvtColor(scene, cv2.COLOR_RGB2YUV_I420).tobytes()
    film.write_bytes(b"YUV4MPEG2 W640 H480 F60:1 Ip A1:1 C420jpeg\n" + (b"FRAME\n" + planes) * 3)
    fake = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
    arguments = ["--no-sandbox", *fake, f"--use-file-for-fake-video-capture={film}"]
    return playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)


def measure(browser: Browser, address: str) -> dict[str, object]:
    """Return the medians over the last frames of a webcam [ms]."""
    page = browser.new_page()
    page.goto(address)
    page.wait_for_selector(".pin:not([hidden])", timeout=60_000)
    page.click("#webcam")
    while page.evaluate(f"{STATE}.then(({{ frames }}) => frames)") < 1.5 * FRAMES:
        page.wait_for_timeout(500)
    times, threads, size = page.evaluate(
        f"{STATE}.then(({{ times, threads, network }}) => [times, threads, network.size])"
    )
    return {
        "size": size,
        "threads": threads,
        "frames": len(times),
        "p50 of the network [ms]": round(statistics.median(each["inference"] for each in times), 2),
        "fastest [ms]": round(min(each["inference"] for each in times), 2),
        "p50 with the resize [ms]": round(statistics.median(each["whole"] for each in times), 2),
        "chromium": browser.version,
        "processors": os.cpu_count(),
        "load": [round(each, 1) for each in os.getloadavg()],
        "machine": platform.machine(),
    }


def screenshot(browser: Browser, address: str, path: Path) -> None:
    """Write a picture of the page with its example."""
    page = browser.new_page(viewport={"width": 1000, "height": 700}, color_scheme="light")
    page.goto(address)
    page.wait_for_selector(".pin:not([hidden])", timeout=60_000)
    box = page.locator("#depth").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 0.45 * box["height"])
    page.evaluate("document.getElementById('status').hidden = true")  # a figure that no file holds
    page.screenshot(path=path)


if __name__ == "__main__":
    main()
