"""``python -m eldenet.demo``: the network as a web page that runs in the browser, on this machine alone.

eldenet demo
eldenet demo checkpoint=runs/my-run port=9000
eldenet demo output=site/demo serve=false
"""

import json
import shutil
import subprocess
import sys
import tempfile
import threading
import webbrowser
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import eldenet
from eldenet.cli.entry_point import entry_point
from eldenet.compose import listed
from eldenet.geometry import BORDER_COLOR
from eldenet.system.checks import check_size
from eldenet.system.extras import require
from eldenet.system.files import copy_file, shipped_folder, write_json
from eldenet.weights import find_checkpoint, name_of

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

PAGE = ("index.html", "style.css", "app.js", "worker.js", "depth.js", "colors.js", "example.jpg")
LIST, LOCK = "package.json", "package-lock.json"
RUNTIME = ("ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm", LIST)  # its list last: then it is whole
SERVED = {*PAGE, "network.onnx", "network.json", *(f"runtime/{name}" for name in RUNTIME)}
ADDRESS = "127.0.0.1"
HOSTS = ("localhost", ADDRESS)
# with these a page may share memory between threads
HEADERS = {
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cache-Control": "no-cache",
}


@dataclass(frozen=True)
class DemoSettings:
    """What ``eldenet demo`` reads."""

    checkpoint: str = "eldenet_indoor"  # packaged weights, a run folder, a model folder or a Hub id
    # (height, width) that the network sees [px]; null: the size of its training
    size: list[int] | None = None
    # folder for the page, which any web server can serve; null: demo in the cache folder
    output: str | None = None
    serve: bool = True  # serve it on this machine, with the headers that allow threads
    port: int = 8000  # 0: any free port
    browser: bool = True  # open the browser
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name

    def __post_init__(self) -> None:
        check_size("size", self.size)
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port={self.port}: give a number from 0 (any free port) to 65535")


def demo(s: DemoSettings) -> None:
    """Build the page, then serve it until Ctrl-C.

    Raises:
        ValueError: npm is missing or fails, or the port is taken.
    """
    require("the demo", "onnx", "onnxscript")
    find_checkpoint(s.checkpoint, "checkpoint")
    from eldenet.data.paths import default_cache
    from eldenet.results.run_log import RunLog, untrained_note

    output = default_cache() / "demo" if s.output is None else Path(s.output).expanduser()
    log = RunLog(output)
    model = eldenet.load(s.checkpoint, trusted_modules=listed(s.trusted_modules))
    if find_checkpoint(s.checkpoint).kind == "network":
        log.say(untrained_note(s.checkpoint))
    server = open_server(output, s.port) if s.serve else None  # before minutes are spent
    build_page(model, s, output, log)
    log.say(f"written to {output}: {', '.join(PAGE)}, network.onnx, network.json, runtime")
    if server is not None:
        serve(server, log, browser=s.browser)


def build_page(model: "DepthNet", s: DemoSettings, output: Path, log: "RunLog") -> None:
    """Write the page, the network and its runtime into ``output``.

    Raises:
        ValueError: npm is missing or fails.
    """
    from eldenet.deploy.metadata import UNTRAINED_SIZE, describe
    from eldenet.deploy.onnx_export import write_onnx
    from eldenet.model import size_of_frames

    install_runtime(output / "runtime", log)
    height, width = s.size or size_of_frames(model.info) or UNTRAINED_SIZE
    name = name_of(s.checkpoint, model.info)
    log.say(f"exporting {s.checkpoint} at {height} x {width} ...")
    facts = describe(model, name, (height, width))
    write_onnx(model, output / "network.onnx", (height, width), batch=1, metadata=facts)
    write_json(output / "network.json", page_facts(model, s.checkpoint, (height, width)))
    for file in PAGE:
        copy_file(web_folder() / file, output / file)


def page_facts(model: "DepthNet", checkpoint: str, size: tuple[int, int]) -> dict[str, Any]:
    """Return what the page needs to know: the network's size, its canonical camera, and the 256 colors."""
    from eldenet.model import size_of_frames
    from eldenet.visualization import color_depth

    shares = (np.arange(256) + 0.5) / 255  # as depth between 1 (cool, the first color) and 0
    return {
        "name": Path(checkpoint).name,
        "size": list(size),
        "canonical_px": model.canonical_px,
        "trained_size": list(size_of_frames(model.info) or size),
        "sees_rays": model.sees_rays,
        "stretch": float(model.info.get("stretch") or 1.0),
        "border": list(BORDER_COLOR),
        "license": str(model.info.get("license", "")),
        "colors": color_depth(1 - shares[None], 0.0, 1.0)[0].tolist(),
    }


def web_folder() -> Path:
    """Return the folder of the page: ``web/`` in a checkout, ``eldenet/web`` in a wheel."""
    return shipped_folder("web", LOCK)


def install_runtime(folder: Path, log: "RunLog") -> None:
    """Put onnxruntime-web into ``folder`` in the version of the page's lock file, if it is not there.

    Raises:
        ValueError: npm is missing or fails.
    """
    wanted = json.loads((web_folder() / LIST).read_text())["dependencies"]["onnxruntime-web"]
    there = folder / LIST
    if there.is_file() and json.loads(there.read_text())["version"] == wanted:
        return
    npm = shutil.which("npm")
    if npm is None:
        raise ValueError("the page needs onnxruntime-web, which npm fetches: install Node.js")
    log.say(f"npm fetches onnxruntime-web {wanted}, once ...")
    with tempfile.TemporaryDirectory() as temporary:
        for file in (LIST, LOCK):
            shutil.copyfile(web_folder() / file, Path(temporary) / file)
        words = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"]
        done = subprocess.run(words, cwd=temporary, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ["it gives no reason"])[0]
            raise ValueError(f"npm could not fetch onnxruntime-web {wanted}: {reason}")
        package = Path(temporary) / "node_modules" / "onnxruntime-web"
        for file in RUNTIME:
            copy_file(package / file if file == LIST else package / "dist" / file, folder / file)


class PageHandler(SimpleHTTPRequestHandler):
    """Serves the page's own files, to this machine's browser alone, and logs nothing."""

    timeout = 10  # of a request [s]
    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def send_head(self) -> Any:
        """Refuse other hosts' pages (DNS rebinding), other files, and links out of the folder."""
        host = self.headers.get("Host", "").rpartition(":")[0]
        name = self.path.partition("?")[0].lstrip("/") or PAGE[0]
        folder = Path(self.directory).resolve()
        if host not in HOSTS:
            self.send_error(403, "open the page as localhost")
            return None
        if name not in SERVED or (folder / name).resolve() != folder / name or not (folder / name).is_file():
            self.send_error(404)
            return None
        return super().send_head()

    def end_headers(self) -> None:
        """Add the headers."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, *message: object) -> None:
        """Say nothing."""


class PageServer(ThreadingHTTPServer):
    """Says nothing of a reader that leaves."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Show only errors that are not the connection's."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


def open_server(folder: Path, port: int) -> ThreadingHTTPServer:
    """Open a server of ``folder`` for this machine alone; ``port`` 0 takes a free one.

    Raises:
        ValueError: the port is taken.
    """
    try:
        return PageServer((ADDRESS, port), partial(PageHandler, directory=str(folder)))
    except OSError as error:
        raise ValueError(
            f"port={port}: {error.strerror}; give another port, or 0 for any free one"
        ) from error


def serve(server: ThreadingHTTPServer, log: "RunLog", *, browser: bool) -> None:
    """Serve until Ctrl-C, and open the browser."""
    address = f"http://localhost:{server.server_port}/"
    log.say(f"{address} (Ctrl-C ends it)")
    if browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    with server:
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            log.say("ended")


main = entry_point(DemoSettings)(demo)

if __name__ == "__main__":
    main()
