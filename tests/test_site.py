"""The site builds without a warning, its links lead somewhere, and its demo gives depth."""

import functools
import http.server
import os
import shutil
import subprocess
import sys
import threading
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
ELSEWHERE = ("http:", "https:", "//")
pytestmark = [pytest.mark.docs, pytest.mark.timeout(900)]


class Links(HTMLParser):
    """What a page links to, what it loads, and the anchors that it has."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.anchors.add(values.get("id") or "")
        if tag == "a":
            self.links.append(values.get("href") or "")
        elif tag == "link" and values.get("rel") not in ("canonical", "prev", "next"):
            self.loads.append(values.get("href") or "")
        elif tag in ("img", "script", "iframe") and values.get("src"):
            self.loads.append(values["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    pytest.importorskip("onnx")
    if shutil.which("npm") is None:
        pytest.skip("needs npm (Node.js)")
    folder = tmp_path_factory.mktemp("site")
    words = ["-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        [sys.executable, *words],
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    if "npm could not fetch" in done.stderr:  # without a network
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    return folder


def test_links_lead_to_files_and_anchors_and_nothing_is_loaded_from_elsewhere(site):
    pages = {page: Links(page) for page in site.rglob("*.html") if page.name != "404.html"}
    assert len(pages) > 50
    for page, found in pages.items():
        assert [each for each in found.loads if each.startswith(ELSEWHERE)] == []
        for link in (*found.links, *found.loads):
            parts = urlsplit(link)
            if parts.scheme or not link:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            assert target.is_file(), f"{page.relative_to(site)}: {link}"
            if parts.fragment and target in pages:
                anchors = pages[target].anchors
                assert unquote(parts.fragment) in anchors, f"{page.relative_to(site)}: {link}"


def test_the_reference_and_the_notebook_are_pages(site):
    page = (site / "api" / "deploy" / "index.html").read_text()
    assert 'id="eldenet.deploy.predictor.DepthPredictor"' in page
    assert ":class:" not in page
    text = (site / "notebooks" / "quickstart" / "index.html").read_text()
    assert "The table's second row" in text


def test_the_button_starts_the_demo_in_the_page(site):
    playwright = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs chromium")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://localhost:{server.server_port}/"
    asked: list[str] = []
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.goto(address)
        assert not [url for url in asked if "try/" in url]  # 17 MB are for those who want them
        page.click(".demo a")
        pin = page.frame_locator(".demo iframe").locator("#label")
        pin.wait_for(timeout=120_000)
        assert pin.inner_text().endswith(" m")
        browser.close()
    server.shutdown()
    server.server_close()
    assert [url for url in asked if not url.startswith((address, "blob:", "data:"))] == []
