"""Networks as files for other runtimes: ONNX and OpenVINO IR, with metadata."""

import json
import logging
import math
import sys
import tempfile
import threading
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet import __version__
from eldenet.deploy.sealing import SEAL, sealed
from eldenet.geometry import same_aspect, size_of_aspect
from eldenet.system.checks import check_size
from eldenet.system.errors import reading
from eldenet.system.files import parse_json, part_file

if TYPE_CHECKING:
    from torch import Tensor, nn

    from eldenet.model import DepthNet

NEWEST_OPSET = 18  # the exporter's own; older ones are written by torch's older exporter
OLDEST_OPSET = 11  # bilinear resizing by half pixels, as torch does it, begins here
METADATA_PREFIX = "eldenet."
EXPORT_AGAIN = "export it again (eldenet export)"
_ONE_AT_A_TIME = threading.RLock()  # stdout and the log level belong to the process


def describe(
    model: "DepthNet",
    name: str,
    size: tuple[int, int],
    *,
    camera_size: tuple[int, int] | None = None,
    license: str | None = None,
) -> dict[str, str]:
    """Metadata of an exported file: model, units, license, input, and what the weights were trained on.

    Args:
        model: the exported network.
        name: of the model.
        size: ``(height, width)`` that the network sees [px].
        camera_size: ``(height, width)`` of the frames that the file takes [px]; None: it takes images.
        license: of the weights; None: the one in the model's ``info``.
    """
    from eldenet.evaluation.cost import count_macs, count_params

    height, width = camera_size or size
    canonical = model.canonical_px is not None
    takes = "uint8 RGB frame (B, H, W, 3)" if camera_size else "float RGB image (B, 3, H, W) in [0, 1]"
    return {
        "eldenet_version": __version__,
        "model": name,
        "output": (
            "canonical depth (B, 1, H, W); meters = depth x fx [px of the network's image] / "
            "(canonical_focal x canonical_width)"
            if canonical
            else "depth (B, 1, H, W) in meters"
        ),
        "units": "canonical meters" if canonical else "meters",
        "distribution": json.dumps(model.distribution),
        "min_depth": str(model.head.min_depth),
        "max_depth": str(model.head.max_depth),
        **canonical_camera(model),
        "license": license or str(model.info.get("license", "not stated")),
        "input": f"{takes}, H = {height}, W = {width}; normalization is inside",
        "input_size": json.dumps(list(size)),
        "whole_frame_size": json.dumps(model.info.get("whole_frame_size")),
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


def write_onnx(
    model: "DepthNet",
    path: str | Path,
    size: tuple[int, int],
    *,
    batch: int | None = None,
    opset: int = NEWEST_OPSET,
    camera_size: tuple[int, int] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write an ONNX file of fp32 weights; the network is folded first (:func:`eldenet.deploy.fold.fold`).

    Args:
        model: is not changed.
        path: of the file, ``.onnx``.
        size: ``(height, width)`` that the network sees [px]; fixed.
        batch: fixed number of images; None: any number.
        opset: 18, or an older one (11 to 17) for old boards.
        camera_size: ``(height, width)`` of uint8 frames [px]: the graph takes these and resizes itself.
        metadata: from :func:`describe`.

    Raises:
        ValueError: the opset, batch or size is out of range, frames would be stretched to ``size``, or the
            opset cannot express this network.
    """
    import onnx
    import torch

    from eldenet.deploy.camera_net import CameraNet
    from eldenet.deploy.fold import fold
    from eldenet.deploy.sigma_net import SigmaNet

    if not OLDEST_OPSET <= opset <= NEWEST_OPSET:
        raise ValueError(f"opset={opset}: choose {OLDEST_OPSET} to {NEWEST_OPSET}")
    if (batch is not None and batch < 1) or min(size) < 1:
        raise ValueError(f"batch={batch}, size={list(size)}: give numbers above 0, or batch=null")
    path = Path(path)
    network: nn.Module = fold(model).cpu()
    outputs = ["depth"]
    if model.distribution is not None:
        network, outputs = SigmaNet(network), ["depth", "sigma"]  # type: ignore[arg-type]
    name, example = "image", torch.rand(batch or 2, 3, *size)
    if camera_size is not None:
        check_aspect(size, camera_size, model)
        network = CameraNet(network, camera_size, size)
        name, example = "frame", torch.zeros(batch or 2, *camera_size, 3, dtype=torch.uint8)
    with part_file(path) as unfinished:
        try:
            with quiet(), torch.no_grad():
                _torch_to_onnx(
                    network.eval(),
                    example,
                    unfinished,
                    [name, *outputs],
                    any_batch=batch is None,
                    opset=opset,
                )
        except RuntimeError as error:  # base class of the exporter's errors
            reason = (str(error).splitlines() or [""])[0]
            raise ValueError(f"opset={opset} cannot express this network: {reason}") from error
        set_metadata(unfinished, metadata or {})
        onnx.checker.check_model(str(unfinished))
    return path


def check_aspect(size: tuple[int, int], camera_size: tuple[int, int], model: "DepthNet") -> None:
    """Raise ValueError if frames of a camera would be stretched to the size that the network sees."""
    seen = (camera_size[0], camera_size[1] * (model.info.get("stretch") or 1.0))
    if not same_aspect(size, seen):
        raise ValueError(
            f"size={list(size)} would stretch frames of camera={list(camera_size)}: give size="
            f"{list(size_of_aspect(size, seen))}, or leave it out"
        )


def _torch_to_onnx(
    network: "nn.Module", example: "Tensor", path: Path, ports: list[str], *, any_batch: bool, opset: int
) -> None:
    import torch

    names: dict[str, Any] = {"input_names": ports[:1], "output_names": ports[1:], "opset_version": opset}
    if opset == NEWEST_OPSET:
        shapes = ({0: torch.export.Dim("batch", min=1, max=4096)},) if any_batch else None
        torch.onnx.export(
            network, (example,), str(path), dynamo=True, external_data=False, verbose=False,
            dynamic_shapes=shapes, **names,
        )  # fmt: skip
    else:
        axes = {port: {0: "batch"} for port in ports} if any_batch else None
        torch.onnx.export(network, (example,), str(path), dynamo=False, dynamic_axes=axes, **names)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the log lines, warnings and prints of exporters and quantizers off the terminal.

    Other threads wait: if they left in a different order than they entered, the terminal would stay silent.
    """
    with _ONE_AT_A_TIME:
        disabled = logging.root.manager.disable
        logging.disable(logging.WARNING)
        try:
            with warnings.catch_warnings(), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                warnings.simplefilter("ignore")
                yield
        finally:
            logging.disable(disabled)


def decline_telemetry() -> None:
    """Keep OpenVINO and nncf from sending telemetry in this process; call it before they are imported.

    Each import and each conversion is reported to Google Analytics, unless a file in the user's home folder
    declines. Without ``openvino_telemetry``, an optional package, nothing is sent or stored.
    """
    telemetry = sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
    if telemetry is not None:  # the program has imported OpenVINO itself
        telemetry.main.TelemetrySender.send = lambda *message: None


def set_metadata(path: str | Path, metadata: Mapping[str, str]) -> None:
    """Write metadata into an ONNX file, and a digest of all of it (:mod:`eldenet.deploy.sealing`)."""
    import onnx

    graph = onnx.load(path)
    onnx.helper.set_model_props(graph, {METADATA_PREFIX + key: value for key, value in metadata.items()})
    graph.doc_string = f"ends in its {SEAL}"
    content = sealed(graph.SerializeToString())
    with part_file(Path(path)) as unfinished:
        unfinished.write_bytes(content)


def write_openvino(source: str | Path, path: str | Path, metadata: Mapping[str, str]) -> Path:
    """Convert an ONNX file to OpenVINO IR (``.xml`` + ``.bin``) with fp32 weights."""
    decline_telemetry()
    import openvino

    return save_openvino(openvino.convert_model(str(source)), path, metadata)


def save_openvino(network: object, path: str | Path, metadata: Mapping[str, str]) -> Path:
    """Write an OpenVINO network as ``.xml`` + ``.bin`` with its metadata and a digest of both."""
    import openvino

    for key, value in metadata.items():
        network.set_rt_info(value, ["eldenet", key])  # type: ignore[attr-defined]
    path = Path(path)
    with tempfile.TemporaryDirectory() as temporary:  # OpenVINO does not say why it cannot write
        draft = Path(temporary) / path.name
        try:
            openvino.save_model(network, str(draft), compress_to_fp16=False)
        except RuntimeError as error:
            raise OSError(f"OpenVINO could not write to {temporary}: is that disk full? ({error})") from error
        content, weights = draft.read_bytes(), draft.with_suffix(".bin").read_bytes()
    with part_file(path) as unfinished, part_file(path.with_suffix(".bin")) as unfinished_weights:
        unfinished_weights.write_bytes(weights)
        unfinished.write_bytes(sealed(content, weights))
    return path


def read_metadata(path: str | Path) -> dict[str, str]:
    """Metadata that :func:`describe` made for this file; empty for other files.

    Raises:
        ValueError: the file or its metadata is damaged.
    """
    if Path(path).suffix == ".onnx":
        import onnx

        with reading(path, "ONNX file", EXPORT_AGAIN):
            graph = onnx.load(path, load_external_data=False)
        return checked(path, without_prefix({prop.key: prop.value for prop in graph.metadata_props}))
    import xml.etree.ElementTree as ElementTree

    with reading(path, "OpenVINO file", EXPORT_AGAIN):
        node = ElementTree.parse(path).getroot().find("rt_info/eldenet")
        found = {} if node is None else {child.tag: child.attrib["value"] for child in node}
    return checked(path, found)


def checked(path: str | Path, metadata: dict[str, str]) -> dict[str, str]:
    """Return the metadata of a file after checking that its sizes are sizes and its figures are numbers.

    Raises:
        ValueError: they are not; the message names the file.
    """
    with reading(path, "exported network", EXPORT_AGAIN):
        for name in ("input_size", "whole_frame_size", "camera_size"):
            check_size(name, metadata_value(metadata, name))
        for name in ("stretch", "canonical_focal", "canonical_width", "params", "gmacs"):
            value = metadata_value(metadata, name)
            if value is not None and not (type(value) in (int, float) and 0 < value < math.inf):
                raise ValueError(f"{name} is {value!r}, but must be null or a number above 0")
    return metadata


def metadata_value(metadata: Mapping[str, str], name: str) -> Any:
    """Return the value of an entry that :func:`describe` wrote as JSON; None: there is no such entry.

    Raises:
        ValueError: it is not JSON.
    """
    return parse_json(metadata.get(name, "null"), name)


def without_prefix(properties: Mapping[str, str]) -> dict[str, str]:
    """Our own properties of an ONNX file, without their prefix."""
    ours = {key: value for key, value in properties.items() if key.startswith(METADATA_PREFIX)}
    return {key.removeprefix(METADATA_PREFIX): value for key, value in ours.items()}


def count_operations(path: str | Path) -> Counter[str]:
    """Number of each operation in an ONNX or OpenVINO file, without constants."""
    if Path(path).suffix == ".onnx":
        import onnx

        kinds = [node.op_type for node in onnx.load(path, load_external_data=False).graph.node]
    else:
        import xml.etree.ElementTree as ElementTree

        kinds = [layer.attrib["type"] for layer in ElementTree.parse(path).getroot().iter("layer")]
    return Counter(kind for kind in kinds if kind not in ("Constant", "Const", "Parameter", "Result"))


def map_errors(depth: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Largest and median difference of two maps, in meters and relative to the reference."""
    meters = np.abs(depth.astype(np.float64) - reference)
    relative = meters / np.abs(reference)
    return {
        "max_m": float(meters.max()),
        "median_m": float(np.median(meters)),
        "max_relative": float(relative.max()),
        "median_relative": float(np.median(relative)),
    }
