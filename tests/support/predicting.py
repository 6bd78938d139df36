"""A small trained network and pictures for it, shared by the tests of ``predict``."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import eldenet
from eldenet.compose import compose
from eldenet.deploy.outputs import Results
from eldenet.model import DepthNet
from eldenet.predict import PredictSettings, predict


def photo(height: int = 48, width: int = 64) -> np.ndarray:
    rows, cols = np.mgrid[:height, :width]
    return np.stack([rows * 5 % 256, cols * 4 % 256, (rows + cols) * 2 % 256], -1).astype(np.uint8)


def save(path: Path, picture: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture[..., ::-1])
    return path


def turned_by_exif(path: Path) -> Path:
    """Add the note of a camera that was held upright, a quarter turn, to a JPEG."""
    content = path.read_bytes()
    tiff = b"II*\0\x08\0\0\0\x01\0" + b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0" + b"\0\0\0\0"  # Orientation = 6
    exif = b"Exif\0\0" + tiff
    path.write_bytes(content[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + content[2:])
    return path


def listed(folder: Path) -> list[str]:
    """Names of the files that a person sees in a folder."""
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


def small_model(folder: Path) -> Path:
    torch.manual_seed(0)
    eldenet.load("eldenet_s").save_pretrained(folder, info={"input_size": [32, 64]})
    return folder


def exported(model: DepthNet, path: Path) -> Path:
    from eldenet.deploy.metadata import describe
    from eldenet.deploy.onnx_export import write_onnx

    pytest.importorskip("onnxruntime")
    return write_onnx(model, path, (32, 64), batch=1, opset=17, metadata=describe(model, "small", (32, 64)))


def settings(checkpoint: Path | str, source: Path | str, output: Path, *overrides: str) -> PredictSettings:
    quoted = [f"checkpoint='{checkpoint}'", f"source='{source}'", f"output='{output}'"]
    on_cpu = ["runtime.device=cpu", "runtime.threads=1", "runtime.workers=0"]  # whatever there is
    words = [*quoted, *on_cpu, *overrides]
    return compose(PredictSettings, words)


def run(checkpoint: Path | str, source: Path | str, output: Path, *overrides: str) -> Results:
    return predict(settings(checkpoint, source, output, *overrides))


def read_ply(path: Path) -> np.ndarray:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    vertices = np.frombuffer(body, np.dtype([(name, kinds[kind]) for kind, name in fields]))
    assert f"element vertex {len(vertices)}" in lines
    return vertices
