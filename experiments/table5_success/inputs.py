"""What feeds a row beside its arenas: policy, depth network, detector, errors; told by their hashes."""

import hashlib
import json
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eldenet.config import compose, plain
from eldenet.navigation.cameras import camera, objects
from eldenet.navigation.noisy_ranges import NoisyRanges, errors_file
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.navigation.training import PROGRESS
from eldenet.navigation.versions import training_hash
from eldenet.results.run_record import write_json
from eldenet.zoo import located

TRUTH = "truth"  # the renderer's own depth; the simulator's own detections
CAMERAS = ("camera", "objects")
SETTINGS = ("seed", "sensor", "observer", "learner", "training", "time_limit")  # of a training


def check_inputs(given: Namespace, sensors: Sequence[str]) -> None:
    """Look at start whether all that the sensors need is there.

    Raises:
        ValueError: it was not said, or is not there.
    """
    for sensor in sensors:
        kind, at, light = sensor.partition("@")
        if at and kind not in CAMERAS:
            raise ValueError(f"--sensors {sensor}: light is for {' and '.join(CAMERAS)} alone")
        if at and not (light.replace(".", "", 1).isdigit() and float(light) > 0):
            raise ValueError(f"--sensors {sensor}: give the light as a number above 0, such as {kind}@0.1")
        if kind in CAMERAS:
            depth_files(given.depth)
        if kind == "objects":
            detector_files(given.detector)
        if kind == "noisy" and not errors_file(given.errors).is_file():
            raise ValueError(f"--errors {given.errors}: no such file; give one of mode=measure, or packaged")


def depth_files(source: str | None) -> list[Path]:
    """Weights and settings of the depth network; none for "truth"."""
    if source == TRUTH:
        return []
    if source is None:
        raise ValueError(f"--depth: say what feeds the camera: a network's folder or file, or {TRUTH}")
    for path in (Path(source) / "model", located(source)):
        if (path / "model.safetensors").is_file():
            return sorted(file for file in path.iterdir() if file.is_file())
    if Path(source).is_file():
        weights = Path(source).with_suffix(".bin")  # beside an .xml
        return [Path(source), *([weights] if weights.is_file() else [])]
    raise ValueError(
        f"--depth {source}: no model folder and no exported file; a network of a Hub must be downloaded "
        "first, so that its hash can be told"
    )


def detector_files(source: str | None) -> list[Path]:
    """The detector's file; none for "truth"."""
    if source == TRUTH:
        return []
    if source is None:
        raise ValueError(f"--detector: say what finds objects: an .onnx file, or {TRUTH} for an ideal one")
    if not Path(source).is_file():
        raise ValueError(f"--detector {source}: no such file; give an .onnx file, or {TRUTH}")
    return [Path(source)]


def digest(files: Sequence[Path]) -> str | None:
    """SHA-256 over names and contents; None of no files."""
    if not files:
        return None
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode() + file.read_bytes())
    return total.hexdigest()


def input_hashes(sensor: str, given: Namespace) -> dict[str, str | None]:
    """Of all that feeds a sensor."""
    kind = sensor.partition("@")[0]
    return {
        "depth": digest(depth_files(given.depth)) if kind in CAMERAS else None,
        "detector": digest(detector_files(given.detector)) if kind == "objects" else None,
        "errors": digest([errors_file(given.errors)]) if kind == "noisy" else None,
    }


def fed_by(sensor: str, given: Namespace) -> str:
    """One line under a heading: what fed the sensor, and where the goal came from."""
    names = {"depth": given.depth, "detector": given.detector, "errors": given.errors}
    kind = sensor.partition("@")[0]
    used = {"camera": ["depth"], "objects": ["depth", "detector"], "noisy": ["errors"]}.get(kind, [])
    hashes = input_hashes(sensor, given)
    parts = [f"{name} `{names[name]}`" + (f" (SHA-256 {hashes[name][:12]})" if hashes[name] else "")
             for name in used]  # fmt: skip
    parts += [f"goal `{given.goal}`" + (" (odometry is exact here)" if kind == "ranges" else "")]
    return "Fed by: " + ", ".join(parts) + "."


def make_sensor(sensor: str, given: Namespace) -> Sensor:
    """By its name in the table."""
    kind, _, light = sensor.partition("@")
    if kind == "ranges":
        return Ranges()
    if kind == "noisy":
        return NoisyRanges(errors=given.errors)
    depth = None if given.depth == TRUTH else given.depth
    if kind == "camera":
        return camera(depth, light=float(light or 1.0))
    detector = None
    if given.detector != TRUTH:
        from eldenet.perception.onnx_detector import OnnxDetector

        detector = OnnxDetector(given.detector)
    return objects(depth, detector=detector, light=float(light or 1.0))


def training_of(
    folder: Path, options: Sequence[str], *, any_sources: bool = False, recheck: bool = False
) -> Path:
    """The policy that ``options`` train; it is trained now if it was not yet.

    Args:
        folder: of the run.
        options: of ``python -m eldenet.navigate mode=train``.
        any_sources: take a training that other sources made.
        recheck: take it if its first leg comes out the same with these, and note so beside it.

    Raises:
        ValueError: the folder holds a training of other settings or other sources.
    """
    policy, note = folder / "policy.safetensors", folder / "training.json"
    if not policy.is_file():
        command = [sys.executable, "-m", "eldenet.navigate", "mode=train", *options, f"run_dir={folder}"]
        subprocess.run(command, check=True)
    if not note.is_file():
        raise ValueError(f"{folder} holds a policy without training.json: nobody knows how it was trained")
    made = json.loads(note.read_text())
    config = compose("navigate", ["mode=train", *options])
    asked = {name: plain(config[name]) for name in SETTINGS} | {"goal": str(config.goal)}
    asked = json.loads(json.dumps(asked))
    there = {"goal": "known"} | made["config"]
    others = [name for name in asked if there.get(name) != asked[name]]
    if others:
        raise ValueError(f"{folder} was trained with another {', '.join(others)}: delete it, or give --runs")
    if made.get("version") == 1 or made.get("sources") == training_hash() or any_sources:
        return policy
    if recheck and first_leg(options) == made["legs"][0]:
        again = {"steps": made["legs"][0]["steps"], "made_by": made.get("sources")}
        rechecked = [*made.get("rechecked", []), again]
        write_json(note, made | {"sources": training_hash(), "rechecked": rechecked})
        print(f"{folder.name}: the first leg of its training came out the same, kept", flush=True)
        return policy
    raise ValueError(
        f"{folder} was trained by other sources than these: delete it, give --runs, --recheck to see whether "
        "these begin the same training alike, or --any-sources to take it nevertheless (the results say so)"
    )


def first_leg(options: Sequence[str]) -> dict[str, Any]:
    """What the validation after a training's first leg says; the training ends there."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "eldenet.navigate", "mode=train", *options, f"run_dir={folder}/run"]
        progress, log = Path(folder) / "run" / PROGRESS, Path(folder) / "log.txt"
        with log.open("w") as file, subprocess.Popen(command, stdout=file, stderr=file) as process:
            while process.poll() is None and not progress.is_file():
                time.sleep(0.2)
            process.kill()
        if not progress.is_file():
            raise ValueError(f"{' '.join(command)} failed:\n{log.read_text()[-2000:]}")
        return dict(json.loads(progress.read_text())["legs"][0])
