"""The page in a real browser: its depth is Python's, nothing leaves the machine, and phones can use it."""

import base64
import http.client
import shutil
import socket
import struct
import threading
import time
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.data

import eldenet
from eldenet.compose import compose
from eldenet.data.paths import default_cache
from eldenet.demo import (
    HEADERS,
    DemoSettings,
    PageHandler,
    build_page,
    install_runtime,
    open_server,
    page_facts,
)
from eldenet.deploy import runtimes
from eldenet.deploy.predictor import DepthPredictor
from eldenet.results.run_log import RunLog
from eldenet.visualization import color_depth

TOLERANCE = 1e-3  # [m]
PHONE = {"width": 390, "height": 844}
LOOSE_FRAME = 6.0  # mean difference of a webcam's frame, which is YUV on its way, in gray levels
# depth [m] at every pixel of the frame that the page shows, and that frame
READ = """async () => {
    const { metersAt, state } = await import("./app.js");
    const { data, width, height } = state.frame;
    const depth = new Float32Array(width * height);
    for (let place = 0; place < depth.length; place++) {
        depth[place] = metersAt(place % width, Math.floor(place / width));
    }
    const text = (array) => {
        const bytes = new Uint8Array(array.buffer);
        let letters = "";
        for (let start = 0; start < bytes.length; start += 8192) {
            letters += String.fromCharCode(...bytes.subarray(start, start + 8192));
        }
        return btoa(letters);
    };
    return { depth: text(depth), pixels: text(data), width, height };
}"""
FRAMES = "import('./app.js').then(({ state }) => state.frames)"


@pytest.fixture(scope="module")
def page_folder(tmp_path_factory) -> Path:
    """The built page; skips where something of it is missing."""
    pytest.importorskip("onnxruntime")
    if shutil.which("npm") is None:
        pytest.skip("needs npm (Node.js)")
    folder = tmp_path_factory.mktemp("page")
    fetched = default_cache() / "demo" / "runtime"
    try:
        install_runtime(fetched, RunLog(folder))
    except ValueError as error:  # without a network
        pytest.skip(str(error))
    shutil.copytree(fetched, folder / "runtime")
    build_page(
        eldenet.load("eldenet_indoor"),
        compose(DemoSettings, []),
        folder,
        RunLog(folder),
    )
    return folder


@pytest.fixture(scope="module")
def address(page_folder):
    server = open_server(page_folder, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://localhost:{server.server_port}/"
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def predictor(page_folder) -> DepthPredictor:
    return DepthPredictor(runtimes.load(page_folder / "network.onnx", "onnxruntime"), steady=False)


@pytest.fixture(scope="module")
def chromium():
    """Starts Chromium with further arguments."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright (pip) and chromium (apt)"
    )
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("needs chromium")
    with playwright.sync_playwright() as started:

        def launch(*arguments: str):
            return started.chromium.launch(executable_path=found, args=["--no-sandbox", *arguments])

        yield launch


@pytest.fixture(scope="module")
def browser(chromium):
    with chromium() as launched:
        yield launched


@pytest.fixture
def page(browser, address):
    with browser.new_context() as context:
        yield opened(context.new_page(), address)


def opened(page, address):
    """The page once its example has a depth; it fails on an error and on a request to elsewhere."""
    page.asked, page.wrong = [], []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("pageerror", lambda error: page.wrong.append(str(error)))
    page.goto(address)
    page.wait_for_selector(".pin:not([hidden])", timeout=60_000)
    return page


def read(page) -> tuple[np.ndarray, np.ndarray]:
    """Frame ``(H, W, 3)`` uint8 and depth ``(H, W)`` [m] that the page shows."""
    found = page.evaluate(READ)
    size = found["height"], found["width"]
    frame = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8).reshape(*size, 4)[..., :3]
    depth = np.frombuffer(base64.b64decode(found["depth"]), np.float32).reshape(size)
    return np.ascontiguousarray(frame), depth


def wait_until(page, expression: str) -> None:
    """Wait for a JavaScript value that is true; Playwright's own wait needs eval, which the page forbids."""
    end = time.monotonic() + 30
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"{expression} stays false: {page.inner_text('#status')}"
        page.wait_for_timeout(50)


def looks_again(page, act: Callable[[], None]) -> None:
    """Act, and wait for the next frame of a network that sees the lens."""
    page.evaluate("import('./app.js').then(({ state }) => { state.frames = 0; })")
    act()
    wait_until(page, f"{FRAMES}.then((frames) => frames > 0)")


def give(page, path: Path, picture: np.ndarray) -> None:
    cv2.imwrite(str(path), picture[..., ::-1])
    page.set_input_files("#file", path)
    height, width = picture.shape[:2]
    page.wait_for_selector(f"#photo[width='{width}'][height='{height}']", timeout=30_000)


@pytest.mark.parametrize(
    "crop",
    [np.s_[:], np.s_[:384, :512], np.s_[:, 100:400], np.s_[:150, :200]],
    ids=["wider", "twice the size", "portrait", "smaller"],
)
def test_a_photo_has_the_depth_that_python_gives(page, predictor, tmp_path, crop):
    photo = np.ascontiguousarray(skimage.data.astronaut()[crop])
    give(page, tmp_path / "photo.png", photo)
    frame, depth = read(page)
    np.testing.assert_array_equal(frame, photo)
    np.testing.assert_allclose(depth, predictor(photo), rtol=0, atol=TOLERANCE)
    assert page.wrong == []


def test_the_focal_slider_scales_meters_as_intrinsics_do(page, predictor, tmp_path):
    photo = skimage.data.coffee()
    give(page, tmp_path / "photo.png", photo)
    looks_again(page, lambda: page.fill("#focal", "1.2"))
    _, depth = read(page)
    expected = predictor(photo, intrinsics=[1.2 * 600, 1.2 * 600, 300, 200])
    np.testing.assert_allclose(depth, expected, rtol=0, atol=TOLERANCE)
    assert "fx 720 px, 45° wide" in page.inner_text("#focal-value")
    looks_again(page, lambda: page.click("#reset"))
    np.testing.assert_allclose(read(page)[1], predictor(photo), rtol=0, atol=TOLERANCE)


def test_the_cursor_shows_meters_and_the_legend_its_scale(page, predictor, tmp_path):
    photo = skimage.data.coffee()
    give(page, tmp_path / "photo.png", photo)
    box = page.locator("#depth").bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.251, box["y"] + box["height"] * 0.501)
    meters, _, place = page.inner_text("#readout").partition(" m at column ")
    column, row = (int(number) for number in place.split(", row "))
    assert abs(column - 0.251 * 600) <= 2
    assert abs(row - 0.501 * 400) <= 2
    depth = predictor(photo)
    assert float(meters) == pytest.approx(depth[row, column], abs=TOLERANCE)
    near, far = np.percentile(depth, (2, 98))
    labels = [float(label.removesuffix(" m")) for label in page.locator("#ticks span").all_inner_texts()]
    assert len(labels) >= 3
    assert near - 0.05 <= min(labels) < max(labels) <= far + 0.05


def test_a_webcam_has_the_depth_that_python_gives(chromium, address, predictor, tmp_path):
    scene = cv2.resize(skimage.data.coffee()[:, :533], (640, 480), interpolation=cv2.INTER_AREA)
    film = tmp_path / "webcam.y4m"
    planes = cv2.cvtColor(scene, cv2.COLOR_RGB2YUV_I420).tobytes()
    film.write_bytes(b"YUV4MPEG2 W640 H480 F30:1 Ip A1:1 C420jpeg\n" + (b"FRAME\n" + planes) * 3)
    fake = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
    with chromium(*fake, f"--use-file-for-fake-video-capture={film}") as browser:
        page = opened(browser.new_page(), address)
        page.click("#webcam")
        page.wait_for_selector("#photo[width='640']", timeout=30_000)
        page.click("#stop")
        page.wait_for_timeout(300)
        frame, depth = read(page)
    assert frame.shape == scene.shape
    assert np.abs(frame.astype(float) - scene).mean() < LOOSE_FRAME
    np.testing.assert_allclose(depth, predictor(frame), rtol=0, atol=TOLERANCE)


def test_a_video_plays(page, tmp_path):
    film = tmp_path / "film.webm"
    import av

    with av.open(str(film), "w") as container:
        stream = container.add_stream("libvpx", rate=10, options={"deadline": "realtime"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        small = cv2.resize(skimage.data.coffee(), (320, 240))
        for _ in range(10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(small, format="rgb24")))
        container.mux(stream.encode())
    page.set_input_files("#file", film)
    page.wait_for_selector("#photo[width='320']", timeout=30_000)
    wait_until(page, f"{FRAMES}.then((frames) => frames > 3)")
    assert read(page)[0].shape == (240, 320, 3)
    page.click("#stop")


def test_nothing_leaves_the_machine_and_threads_are_allowed(page, address, tmp_path):
    give(page, tmp_path / "photo.png", skimage.data.astronaut())
    assert [url for url in page.asked if not url.startswith((address, "blob:", "data:"))] == []
    assert page.evaluate("crossOriginIsolated")
    refused = page.evaluate("fetch('https://example.org').then(() => 'sent', () => 'refused')")
    assert refused == "refused"  # by the page's own policy, before anything is sent


class OwnPage(PageHandler):
    """Serves every file with the headers of the demo, which has no own.html."""

    send_head = SimpleHTTPRequestHandler.send_head


def test_the_page_of_the_documentation_gives_what_python_gives(browser, page_folder, predictor):
    text = (Path(__file__).parents[2] / "docs" / "demo.md").read_text()
    (page_folder / "own.html").write_text(text.partition("```html\n")[2].partition("```")[0])
    frame = cv2.imread(str(page_folder / "example.jpg"))[..., ::-1]
    depth = predictor(np.ascontiguousarray(frame), focal=440)
    server = ThreadingHTTPServer(("localhost", 0), partial(OwnPage, directory=str(page_folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with server, browser.new_context() as context:
        page = context.new_page()
        page.goto(f"http://localhost:{server.server_port}/own.html")
        page.wait_for_selector("text=/^\\d+\\.\\d+ m$/", timeout=60_000)
        found = float(page.inner_text("#answer").removesuffix(" m"))
        server.shutdown()
    assert found == pytest.approx(depth[depth.shape[0] // 2, depth.shape[1] // 2], abs=TOLERANCE)


def test_what_is_no_picture_gets_one_line(page, tmp_path):
    (tmp_path / "notes.txt").write_text("no picture")
    page.set_input_files("#file", tmp_path / "notes.txt")
    page.wait_for_selector("#status.wrong")
    assert page.inner_text("#status").startswith("notes.txt is no picture that this browser reads")


def test_a_phone_sees_all_of_it(browser, address):
    with browser.new_context(viewport=PHONE, has_touch=True, is_mobile=True) as context:
        page = opened(context.new_page(), address)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        photo, depth = (page.locator(name).bounding_box() for name in ("#photo", "#depth"))
        assert depth["y"] >= photo["y"] + photo["height"]
        assert photo["width"] >= 0.9 * PHONE["width"]
        before = page.inner_text("#readout")
        page.locator("#depth").tap(position={"x": 40, "y": 40})
        assert page.inner_text("#readout") != before


# --- without a browser ---


def test_the_page_gets_the_colors_of_the_package():
    facts = page_facts(eldenet.load("eldenet_indoor"), "eldenet_indoor", (192, 256))
    depth = np.linspace(0.2, 9.8, 400, dtype=np.float64)[None]
    places = (255 * np.clip(1 - (depth - 1) / 7, 0, 1)).astype(int)
    np.testing.assert_array_equal(np.array(facts["colors"])[places], color_depth(depth, 1.0, 8.0))


def test_the_server_allows_threads_and_names_the_types(tmp_path):
    (tmp_path / "worker.js").write_text("")
    server = open_server(tmp_path, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port)
    connection.request("GET", "/worker.js")
    answer = connection.getresponse()
    assert {name: answer.headers[name] for name in HEADERS} == HEADERS
    assert answer.headers["Content-Type"] == "text/javascript"
    with pytest.raises(ValueError, match="give another"):
        open_server(tmp_path, server.server_port)
    server.shutdown()
    server.server_close()


def answered(server, request: bytes) -> bytes:
    """The first line that the server answers."""
    with socket.create_connection(server.server_address[:2], timeout=10) as connection:
        connection.sendall(request)
        return connection.makefile("rb").readline().strip()


def test_the_server_gives_the_pages_own_files_to_this_machine_alone(tmp_path, capfd, monkeypatch):
    folder, secret = tmp_path / "page", tmp_path / "secret"
    (folder / "runtime").mkdir(parents=True)
    secret.write_text("secret")
    for name in ("index.html", "network.json", "notes.txt"):
        (folder / name).write_text(name)
    (folder / "app.js").symlink_to(secret)
    (folder / "runtime/package.json").symlink_to(secret)
    with open_server(folder, 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()

        def status(path: str, host: str = "localhost", method: str = "GET") -> int:
            request = f"{method} {path} HTTP/1.0\r\nHost: {host}:{server.server_port}\r\n\r\n"
            return int(answered(server, request.encode()).split()[1])

        assert [status(path) for path in ("/", "/index.html", "/network.json?x=1")] == [200, 200, 200]
        assert status("/", "127.0.0.1") == status("/", method="HEAD") == 200
        assert status("/", "evil.example") == status("/network.json", "localhost.evil.example") == 403
        for path in ("/notes.txt", "/runtime/", "/runtime", "/app.js", "/runtime/package.json", "/../secret",
                     "/%2e%2e/secret", "//etc/passwd", "/index.html/", "/network.onnx"):  # fmt: skip
            assert status(path) == 404, path
        monkeypatch.setattr(PageHandler, "timeout", 0.2)
        assert answered(server, b"GET / HTTP/1.0\r\n") == b""  # it never ends its request
        with socket.create_connection(server.server_address[:2]) as leaving:
            leaving.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            leaving.sendall(b"GET / HTTP/1.0\r\n")
        server.shutdown()
    assert capfd.readouterr().err == ""


def test_without_npm_one_line_says_what_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ValueError, match="npm fetches: install Node"):
        install_runtime(tmp_path, RunLog(tmp_path))
    assert list(tmp_path.iterdir()) == []
