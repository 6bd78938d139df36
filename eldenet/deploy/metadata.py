"""What an exported file says about its network, and the digest by which a changed bit is noticed.

Both are metadata, which other programs ignore: properties of an ONNX file, runtime information of an OpenVINO
file.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet import __version__
from eldenet.system.digests import digest_of
from eldenet.system.errors import reading
from eldenet.system.onnx_files import EXPORT_AGAIN, read_graph

if TYPE_CHECKING:
    from eldenet.model import DepthNet

PREFIX = "eldenet."
UNTRAINED_SIZE = (224, 224)  # [px] of a file whose network was trained at no single size
DIGEST, PRODUCER = "digest", "eldenet"
_NO_DIGEST = "0" * 64
BLANK = f"sha256-of-all:{_NO_DIGEST}"
"""Value of the entry ``DIGEST`` until :func:`sealed` fills it in."""
# OpenVINO keeps the entries of the ONNX file that it converted, also its digest, as "eldenet.digest"
_SEAL = re.compile(rb'(?:eldenet\.digest..|<digest value=")sha256-of-all:([0-9a-f]{64})', re.DOTALL)
# what shows that a file had a digest: the producer at the start of an ONNX file, or a part of the entry
_SEALED = re.compile(rb'\A.{0,8}eldenet|<digest value|(?<!eldenet\.digest value=")sha256-of-all:', re.DOTALL)


def describe(
    model: "DepthNet",
    name: str,
    size: tuple[int, int],
    *,
    camera_size: tuple[int, int] | None = None,
    fov: float | None = None,
    license: str | None = None,
) -> dict[str, str]:
    """Metadata of an exported file: model, units, license, input, and what the weights were trained on.

    Args:
        size: ``(height, width)`` that the network sees [px].
        camera_size: ``(height, width)`` of the frames that the file takes [px]; None: it takes images.
        fov: horizontal field of view of the one camera that the file is for [degrees]; None: any.
        license: of the weights; None: the one in the model's ``info``.
    """
    from eldenet.evaluation.cost import count_macs, count_params
    from eldenet.model import size_of_frames

    height, width = camera_size or size
    scaled = model.canonical_px is not None and not model.sees_rays and fov is None
    seen = f"the frame x {size[1]} / {width}" if camera_size else "the network's image"
    takes = "uint8 RGB frame (B, H, W, 3)" if camera_size else "float RGB image (B, 3, H, W) in [0, 1]"
    return {
        "eldenet_version": __version__,
        "model": name,
        "output": (
            f"canonical depth (B, 1, H, W); meters = depth x fx [px of {seen}] / "
            "(canonical_focal x canonical_width)"
            if scaled
            else "depth (B, 1, H, W) in meters"
        ),
        "units": "canonical meters" if scaled else "meters",
        "distribution": json.dumps(model.distribution),
        "min_depth": str(model.head.min_depth),
        "max_depth": str(model.head.max_depth),
        **(canonical_camera(model) if fov is None else {}),
        "fov": json.dumps(fov),
        "license": license or str(model.info.get("license", "not stated")),
        "input": f"{takes}, H = {height}, W = {width}; normalization is inside"
        + "; focal (B,): fx [px of that image], 0 = the canonical camera's"
        * (model.sees_rays and fov is None),
        "input_size": json.dumps(list(size)),
        "whole_frame_size": json.dumps(model.info.get("whole_frame_size")),
        "trained_size": json.dumps(size_of_frames(model.info)),
        "stretch": json.dumps(model.info.get("stretch")),
        "camera_size": json.dumps(list(camera_size) if camera_size else None),
        "mean": json.dumps([round(value, 6) for value in model.mean.flatten().tolist()]),
        "std": json.dumps([round(value, 6) for value in model.std.flatten().tolist()]),
        "data": str(model.info.get("data", "not stated" if model.info else "none: freshly initialized")),
        "protocol": str(model.info.get("protocol", "not stated")),
        "precision": "fp32",
        "params": str(count_params(model)),
        "gmacs": f"{count_macs(model, size) / 1e9:.6g}",
    }


def canonical_camera(model: "DepthNet") -> dict[str, str]:
    """Return ``canonical_focal`` [widths] and ``canonical_width`` [px] as metadata; "null" without."""
    return {name: json.dumps(model.config[name]) for name in ("canonical_focal", "canonical_width")}


def read_metadata(path: str | Path) -> dict[str, str]:
    """Metadata that :func:`describe` made for this file; empty for other files.

    Raises:
        ValueError: the file is damaged.
    """
    if Path(path).suffix == ".onnx":
        return own_metadata({prop.key: prop.value for prop in read_graph(path).metadata_props})
    import xml.etree.ElementTree as ElementTree

    with reading(path, "OpenVINO file", EXPORT_AGAIN):
        node = ElementTree.parse(path).getroot().find("rt_info/eldenet")
        found = {} if node is None else {child.tag: child.attrib["value"] for child in node}
    return {key: value for key, value in found.items() if key != DIGEST}


def own_metadata(properties: Mapping[str, str]) -> dict[str, str]:
    """Our own properties of an ONNX file, without their prefix and the digest."""
    ours = {key.removeprefix(PREFIX): value for key, value in properties.items() if key.startswith(PREFIX)}
    return {key: value for key, value in ours.items() if key != DIGEST}


def sealed(content: bytes, weights: bytes = b"") -> bytes:
    """Return a file's content with its digest in place of :data:`BLANK`; ``weights``: of an ``.xml``."""
    digest = digest_of(content, weights)
    return content.replace(BLANK.encode(), BLANK.replace(_NO_DIGEST, digest).encode())


def check_seal(path: Path) -> bool:
    """Check an exported file against its digest; return whether it has one.

    Files of other programs have none, and those of earlier versions of eldenet count as theirs.

    Raises:
        ValueError: the file, or the ``.bin`` beside it, is damaged.
    """
    content, weights = path.read_bytes(), path.with_suffix(".bin")
    is_onnx = path.suffix == ".onnx"
    if not is_onnx and not weights.is_file():
        raise ValueError(
            f"{path} needs {weights.name}, which holds its weights: keep both in the same folder"
        )
    found = _SEAL.search(content)
    if found is None and not _SEALED.search(content):
        return False
    blank = content if found is None else content.replace(found[1], _NO_DIGEST.encode())
    if found is None or found[1].decode() != digest_of(blank, b"" if is_onnx else weights.read_bytes()):
        files = path.name if is_onnx else f"{path.name} or {weights.name}"
        raise ValueError(
            f"{path} does not match its digest: {files} is damaged or was changed after the export; "
            f"{EXPORT_AGAIN}"
        )
    return True


def files_of(path: Path) -> list[Path]:
    """An exported file, and that of its weights where they are apart."""
    return [path, path.with_suffix(".bin")] if path.suffix == ".xml" else [path]


def is_whole(path: Path) -> bool:
    """Whether an exported file is there and matches its digest."""
    try:
        return path.is_file() and check_seal(path)
    except ValueError:
        return False
