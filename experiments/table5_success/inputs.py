"""What a row needs beside its arenas: policy, depth network, detector, range errors; and their hashes."""

import hashlib
import json
import subprocess
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from eldenet.compose import compose
from eldenet.navigate import NavigateSettings
from eldenet.navigation.cameras import camera, objects
from eldenet.navigation.noisy_ranges import NoisyRanges, errors_file
from eldenet.navigation.provenance import TRAINING_VERSION
from eldenet.navigation.sensors import Centers, Ranges, Sensor
from eldenet.navigation.training import comparable
from eldenet.system.files import read_json
from eldenet.weights import located

TRUTH = "truth"  # the renderer's own depth; the simulator's own detections
CAMERAS = ("camera", "objects")


def check_inputs(args: Namespace, sensors: Sequence[str]) -> None:
    """Check at the start that all inputs of the sensors are given and exist.

    Raises:
        ValueError: one is not given, or does not exist.
    """
    for sensor in sensors:
        kind, at, light = sensor.partition("@")
        if at and kind not in CAMERAS:
            raise ValueError(f"--sensors {sensor}: light is for {' and '.join(CAMERAS)} only")
        if at and not (light.replace(".", "", 1).isdigit() and float(light) > 0):
            raise ValueError(f"--sensors {sensor}: give the light as a number above 0, such as {kind}@0.1")
        if kind in CAMERAS:
            depth_files(args.depth)
        if kind == "objects":
            detector_files(args.detector)
        if kind == "noisy" and not errors_file(args.errors).is_file():
            raise ValueError(
                f"--errors {args.errors}: no such file; give one of fit_range_errors.py, or packaged"
            )


def depth_files(source: str | None) -> list[Path]:
    """Return weights and settings of the depth network; none for "truth"."""
    if source == TRUTH:
        return []
    if source is None:
        raise ValueError(f"--depth is missing: give a depth network (folder or file), or {TRUTH}")
    for path in (Path(source) / "model", located(source)):
        if (path / "model.safetensors").is_file():
            return sorted(file for file in path.iterdir() if file.is_file())
    if Path(source).is_file():
        weights = Path(source).with_suffix(".bin")  # beside an .xml
        return [Path(source), *([weights] if weights.is_file() else [])]
    raise ValueError(
        f"--depth {source}: no model folder or exported file; download a network of a Hub first, as its "
        "hash is stored with the rows"
    )


def detector_files(source: str | None) -> list[Path]:
    """Return the detector's file; none for "truth"."""
    if source == TRUTH:
        return []
    if source is None:
        raise ValueError(f"--detector is missing: give an .onnx file, or {TRUTH} for an ideal detector")
    if not Path(source).is_file():
        raise ValueError(f"--detector {source}: no such file; give an .onnx file, or {TRUTH}")
    return [Path(source)]


def digest(files: Sequence[Path]) -> str | None:
    """Return the SHA-256 over names and contents; None for no files."""
    if not files:
        return None
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode() + file.read_bytes())
    return total.hexdigest()


def input_hashes(sensor: str, args: Namespace) -> dict[str, str | None]:
    """Return the hash of each input of a sensor; None for what it does not use. Stored rows have theirs."""
    if args.stored:
        return {}
    kind = sensor.partition("@")[0]
    return {
        "depth": digest(depth_files(args.depth)) if kind in CAMERAS else None,
        "detector": digest(detector_files(args.detector)) if kind == "objects" else None,
        "errors": digest([errors_file(args.errors)]) if kind == "noisy" else None,
    }


def fed_by(sensor: str, args: Namespace) -> str:
    """Return the line below a heading: the inputs of the sensor, and where the goal's position came from."""
    names = {"depth": args.depth, "detector": args.detector, "errors": args.errors}
    kind = sensor.partition("@")[0]
    used = {"camera": ["depth"], "objects": ["depth", "detector"], "noisy": ["errors"]}.get(kind, [])
    hashes = input_hashes(sensor, args)
    parts = [f"{name} `{names[name]}`" + (f" (SHA-256 {hashes[name][:12]})" if hashes.get(name) else "")
             for name in used]  # fmt: skip
    parts += [f"goal `{args.goal}`" + (" (odometry is exact here)" if kind in ("ranges", "centers") else "")]
    return "Fed by: " + ", ".join(parts) + "."


def make_sensor(sensor: str, args: Namespace) -> Sensor:
    """Build a sensor by its name in the table."""
    kind, _, light = sensor.partition("@")
    if kind == "ranges":
        return Ranges()
    if kind == "centers":
        return Centers()
    if kind == "noisy":
        return NoisyRanges(errors=args.errors)
    depth = None if args.depth == TRUTH else args.depth
    if kind == "camera":
        return camera(depth, light=float(light or 1.0))
    detector = None if args.detector == TRUTH else args.detector
    return objects(depth, detector=detector, light=float(light or 1.0))


def trained_policy(folder: Path, options: Sequence[str]) -> Path:
    """Return the policy in ``folder``, trained now if there is none.

    Args:
        folder: of the training.
        options: of ``python -m eldenet.navigate mode=train``.

    Raises:
        ValueError: the folder holds a training with other settings or of another version.
    """
    policy, note = folder / "policy.safetensors", folder / "training.json"
    if not policy.is_file():
        command = [sys.executable, "-m", "eldenet.navigate", "mode=train", *options, f"output={folder}"]
        subprocess.run(command, check=True)
    if not note.is_file():
        raise ValueError(f"{folder} holds a policy without training.json, so its settings are unknown")
    made = read_json(note)
    asked = json.loads(json.dumps(comparable(asdict(compose(NavigateSettings, ["mode=train", *options])))))
    there = {"goal": "known"} | comparable(made["config"])
    others = [name for name in asked if there.get(name) != asked[name]]
    if others:
        raise ValueError(f"{folder} was trained with another {', '.join(others)}: delete it, or give --runs")
    if made.get("version") != TRAINING_VERSION:
        raise ValueError(
            f"{folder} was trained by version {made.get('version', 'unknown')} of the training, now "
            f"{TRAINING_VERSION}: delete it, or give --runs"
        )
    return policy
