"""What MkDocs does not do by itself: pages from outside ``docs/``, the reference, the notebook and the demo.

The pages are written for GitHub. A link to a file elsewhere in the repository brings that file into the site.
"""

import base64
import functools
import json
import os
import posixpath
import re
import shutil
import tempfile
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
ALWAYS = ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "experiments/README.md")
NOTEBOOK = DOCS / "notebooks" / "quickstart.ipynb"
DEMO = "try"  # the folder of the demo in the site
DEMO_PLACE = "<!-- the demo -->"
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
CODE = re.compile(r"(```.*?```|`[^`\n]+`)", re.S)
ROLE = re.compile(r":(?:class|func|meth|mod|attr|data):<code>(?:~[\w.]*\.)?([^<]*)</code>")

REFERENCE = {
    "models": (
        "Models",
        "Networks by name, and the two classes that every network is made of.",
        (
            "eldenet.zoo.load",
            "eldenet.weights.list_models",
            "eldenet.weights.list_weights",
            "eldenet.model.DepthNet",
            "eldenet.model.EncoderDecoder",
            "eldenet.uncertainty.DepthEstimate",
        ),
    ),
    "deploy": (
        "Prediction and runtimes",
        "Frames in, meters out, under torch or as an exported file.",
        (
            "eldenet.deploy.estimation.estimate",
            "eldenet.deploy.estimation.PictureDepth",
            "eldenet.deploy.predictor.DepthPredictor",
            "eldenet.deploy.runtimes.load",
            "eldenet.deploy.runtimes.Runtime",
            "eldenet.deploy.stream.DepthStream",
            "eldenet.deploy.onnx_export.write_onnx",
            "eldenet.deploy.metadata.read_metadata",
            "eldenet.visualization.color_depth",
        ),
    ),
    "data": (
        "Data",
        "Frames, samples, and the base class of a data set.",
        (
            "eldenet.types.Frame",
            "eldenet.types.DepthSample",
            "eldenet.data.base.SampleOptions",
            "eldenet.data.base.DepthDataset",
            "eldenet.data.base.FileDataset",
        ),
    ),
    "parts": (
        "Parts of networks",
        "The base classes of your own backbone, decoder, head and loss.",
        (
            "eldenet.types.FeatureInfo",
            "eldenet.backbones.base.Backbone",
            "eldenet.decoders.base.Decoder",
            "eldenet.heads.Head",
            "eldenet.losses.base.Loss",
            "eldenet.losses.base.LossInputs",
            "eldenet.losses.base.masked_mean",
            "eldenet.losses.base.fill_masked",
            "eldenet.losses.base.WeightedTerm",
            "eldenet.losses.base.WeightedSum",
        ),
    ),
    "evaluation": (
        "Training and evaluation",
        "One run, the rules by which depth is scored, and the metrics.",
        (
            "eldenet.train.train",
            "eldenet.training.trainer.Trainer",
            "eldenet.evaluation.protocol.EvalProtocol",
            "eldenet.evaluation.evaluator.evaluate",
            "eldenet.evaluation.metrics.DepthMetrics",
        ),
    ),
    "perception": (
        "Boxes and geometry",
        "3D boxes from an image, its depth and 2D boxes.",
        (
            "eldenet.perception.scene.Perception",
            "eldenet.perception.scene.Scene",
            "eldenet.perception.lifter.BoxLifter",
            "eldenet.perception.onnx_detector.OnnxDetector",
            "eldenet.boxes.Box3D",
            "eldenet.boxes.Boxes3D",
            "eldenet.geometry.PinholeCamera",
            "eldenet.geometry.pinhole",
            "eldenet.geometry.from_corner",
            "eldenet.geometry.to_corner",
        ),
    ),
    "navigation": (
        "Navigation",
        "The simulated arena, and what drives a robot.",
        (
            "eldenet.navigation.policy.Navigator",
            "eldenet.navigation.planners.plan_and_steer.PlanAndSteer",
            "eldenet.navigation.planners.plan_when_stuck.PlanWhenStuck",
            "eldenet.navigation.on_robot.OnRobot",
            "eldenet.navigation.observer.Senses",
            "eldenet.navigation.lidar.Scan",
            "eldenet.navigation.range_filter.RangeFilter",
            "eldenet.navigation.range_scale.RangeScale",
            "eldenet.navigation.localization.Localizer",
            "eldenet.navigation.env.ArenaNavEnv",
            "eldenet.navigation.env.ArenaNavVectorEnv",
        ),
    ),
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add linked files from outside ``docs/``, the reference and the notebook."""
    todo = [REPOSITORY / name for name in ALWAYS] + sorted(DOCS.glob("*.md"))
    seen = set(todo)
    while todo:
        path = todo.pop()
        if path == NOTEBOOK:
            continue
        if files.get_file_from_path(site_name(path)) is None:
            files.append(File.generated(config, site_name(path), abs_src_path=str(path)))
        found = linked_files(path) - seen if path.suffix == ".md" else set()
        seen |= found
        todo += sorted(found)
    for name, text in {**reference_pages(), **notebook_page()}.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links between files of the repository into links between pages; put the demo where it belongs."""
    if DEMO_PLACE in markdown:
        markdown = markdown.replace(DEMO_PLACE, demo_box(posixpath.dirname(page.file.dest_uri) or "."))
    source = page.file.abs_src_path
    if source is None or not Path(source).is_relative_to(REPOSITORY):
        return markdown

    def translated(match: re.Match[str]) -> str:
        target = target_of(match[1], Path(source))
        if target is None:
            return match[0]
        start = posixpath.dirname(page.file.src_uri) or "."
        return f"]({posixpath.relpath(site_name(target), start)}{match[2] or ''})"

    pieces = CODE.split(markdown)  # code stands at the odd places
    return "".join(piece if place % 2 else LINK.sub(translated, piece) for place, piece in enumerate(pieces))


def on_page_content(html: str, **_: object) -> str:
    """Take Sphinx's roles out of docstrings."""
    return ROLE.sub(r"<code>\1</code>", html)


def on_post_build(config: MkDocsConfig) -> None:
    """Copy the demo into the site."""
    shutil.copytree(built_demo(), Path(config.site_dir) / DEMO, dirs_exist_ok=True)


@functools.cache
def built_demo() -> Path:
    """Build the page of ``eldenet demo`` once, however often ``mkdocs serve`` builds the site."""
    from eldenet.data.paths import default_cache
    from eldenet.demo import DemoSettings, demo

    folder = Path(tempfile.mkdtemp(prefix="eldenet-demo-"))
    runtime = default_cache() / "demo" / "runtime"  # there after the first eldenet demo
    if runtime.is_dir():
        shutil.copytree(runtime, folder / "runtime")
    try:
        demo(DemoSettings(output=str(folder), serve=False))
    except (ValueError, ImportError) as error:
        raise PluginError(f"the demo could not be built: {error}") from error
    return folder


def demo_box(folder: str) -> str:
    """Return the demo's button for a page in ``folder`` of the site."""
    fetched = [path for path in built_demo().rglob("*") if path.suffix in (".onnx", ".wasm", ".mjs")]
    return (
        (Path(__file__).parent / "demo.html")
        .read_text()
        .format(
            demo=posixpath.relpath(f"{DEMO}/index.html", folder),
            size=round(sum(path.stat().st_size for path in fetched) / 1e6),
        )
    )


def site_name(path: Path) -> str:
    """Return a file's place among the site's sources: ``docs/`` is their root."""
    if path == REPOSITORY / "README.md":
        return "index.md"
    if path == NOTEBOOK:
        path = NOTEBOOK.with_suffix(".md")
    return path.relative_to(DOCS if path.is_relative_to(DOCS) else REPOSITORY).as_posix()


def target_of(link: str, page: Path) -> Path | None:
    """Return the file of the repository that a link leads to, or None."""
    path = Path(os.path.normpath(page.parent / link))
    return path if path.is_file() and path.is_relative_to(REPOSITORY) else None


def linked_files(page: Path) -> set[Path]:
    """Return the files of the repository that a page links to."""
    targets = {target_of(match[1], page) for match in LINK.finditer(CODE.sub("", page.read_text()))}
    return {target for target in targets if target is not None and target != REPOSITORY / "README.md"}


def reference_pages() -> dict[str, str]:
    """Return the pages of the reference; mkdocstrings fills them from the docstrings."""
    lines = [f"- [{title}]({name}.md): {about}" for name, (title, about, _) in REFERENCE.items()]
    pages = {"api/index.md": "# Reference\n\nFrom the docstrings.\n\n" + "\n".join(lines)}
    for name, (title, about, members) in REFERENCE.items():
        pages[f"api/{name}.md"] = f"# {title}\n\n{about}\n\n" + "\n\n".join(f"::: {each}" for each in members)
    return pages


def notebook_page() -> dict[str, str | bytes]:
    """Return the notebook as a page, with the pictures among its outputs."""
    name = f"notebooks/{NOTEBOOK.stem}"
    files: dict[str, str | bytes] = {}
    parts = []
    for place, cell in enumerate(json.loads(NOTEBOOK.read_text())["cells"]):
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```{'bash' if text.startswith('%%bash') else 'python'}\n{text}\n```")
        outputs = cell["outputs"]
        if printed := "".join("".join(output.get("text", "")) for output in outputs):
            parts.append(f"```text\n{printed.rstrip()}\n```")
        for picture in (output["data"]["image/jpeg"] for output in outputs if "data" in output):
            files[f"{name}-{place}.jpg"] = base64.b64decode(picture)
            parts.append(f"![Output of this cell]({NOTEBOOK.stem}-{place}.jpg)")
    parts.append(f"[Download this notebook]({NOTEBOOK.name})")
    return {f"{name}.md": "\n\n".join(parts), **files}
