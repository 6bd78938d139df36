"""Networks as files that other runtimes read: ONNX and OpenVINO IR, with what they mean written inside."""

import json
import logging
import warnings
from collections import Counter
from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet import __version__
from eldenet.deploy.fold import fold
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.model import DepthNet

NEWEST_OPSET = 18  # the exporter's own; older ones are written by torch's older exporter
OLDEST_OPSET = 11  # bilinear resizing by half pixels, as torch does it, begins here
METADATA_PREFIX = "eldenet."


class CameraNet(nn.Module):
    """A camera's frames in, meters at the camera's size out: everything that happens to a frame in one graph.

    Resizing is :func:`eldenet.data.base.resize_frame`'s (area where the frame shrinks, else bilinear) without
    its rounding to whole gray levels, and depth comes back bilinear, as in
    :class:`~eldenet.deploy.predictor.DepthPredictor`.

    Args:
        model: image -> meters.
        camera_size: ``(height, width)`` of the frames [px].
        input_size: ``(height, width)`` that the network sees [px].

    Raises:
        ValueError: one side would shrink and the other grow.
    """

    rows: Tensor
    cols: Tensor

    def __init__(self, model: DepthNet, camera_size: tuple[int, int], input_size: tuple[int, int]) -> None:
        super().__init__()
        pairs = list(zip(camera_size, input_size, strict=True))
        self.shrinks = any(seen < given for given, seen in pairs)
        if self.shrinks and any(seen > given for given, seen in pairs):
            raise ValueError(
                f"camera={list(camera_size)} would shrink one way and grow the other to size="
                f"{list(input_size)}: give sizes that are both smaller or both larger"
            )
        self.model, self.camera_size, self.input_size = model, camera_size, input_size
        whole = [given // seen for given, seen in pairs if given % seen == 0]
        self.blocks = (whole[0], whole[1]) if len(whole) == 2 else None
        rows, cols = (area_weights(given, seen) if self.shrinks else torch.eye(1) for given, seen in pairs)
        self.register_buffer("rows", rows)
        self.register_buffer("cols", cols.T.contiguous())

    def forward(self, frame: Tensor) -> Tensor:
        """``frame (B, H, W, 3)`` uint8 RGB -> depth ``(B, 1, H, W)`` [m]."""
        image = frame.permute(0, 3, 1, 2).float()
        if self.camera_size != self.input_size:
            image = self.resized(image)
        depth = self.model(image / 255.0)
        if self.camera_size != self.input_size:
            depth = F.interpolate(depth, size=self.camera_size, mode="bilinear", align_corners=False)
        return depth

    def resized(self, image: Tensor) -> Tensor:
        """To ``input_size``: averages over areas, or bilinear where the frame grows."""
        if not self.shrinks:
            return F.interpolate(image, size=self.input_size, mode="bilinear", align_corners=False)
        if self.blocks is not None:
            return F.avg_pool2d(image, self.blocks)
        return (self.rows @ image) @ self.cols


def area_weights(given: int, wanted: int) -> Tensor:
    """``(wanted, given)``: how much of each given pixel lies under each wanted one; rows add up to 1."""
    edges = torch.arange(wanted + 1, dtype=torch.float64) * given / wanted
    pixels = torch.arange(given, dtype=torch.float64)
    covered = torch.minimum(edges[1:, None], pixels + 1) - torch.maximum(edges[:-1, None], pixels)
    return (covered.clamp_min(0) * wanted / given).float()


def describe(
    model: DepthNet,
    name: str,
    size: tuple[int, int],
    *,
    camera_size: tuple[int, int] | None = None,
    license: str | None = None,
) -> dict[str, str]:
    """What a file says of itself: model, units, license, input, and what its weights were trained on.

    ``license`` is of the weights; None: what the model's ``info`` says, for nothing is known of its data's.
    """
    height, width = camera_size or size
    takes = "uint8 RGB frame (B, H, W, 3)" if camera_size else "float RGB image (B, 3, H, W) in [0, 1]"
    facts = {
        "eldenet_version": __version__,
        "model": name,
        "output": "depth (B, 1, H, W) in meters",
        "units": "meters",
        "min_depth": str(model.head.min_depth),
        "max_depth": str(model.head.max_depth),
        "license": license or str(model.info.get("license", "not stated")),
        "input": f"{takes}, H = {height}, W = {width}; normalization is inside",
        "input_size": json.dumps(list(size)),
        "whole_frame_size": json.dumps(model.info.get("whole_frame_size")),
        "camera_size": json.dumps(list(camera_size) if camera_size else None),
        "mean": json.dumps([round(value, 6) for value in model.mean.flatten().tolist()]),
        "std": json.dumps([round(value, 6) for value in model.std.flatten().tolist()]),
        "data": str(model.info.get("data", "not stated" if model.info else "none: freshly initialized")),
        "protocol": str(model.info.get("protocol", "not stated")),
        "precision": "fp32",
        "params": str(count_params(model)),
        "gmacs": f"{count_macs(model, size) / 1e9:.6g}",
    }
    return facts


def write_onnx(
    model: DepthNet,
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
        model: in any state; it is not changed.
        path: of the file, ``.onnx``.
        size: ``(height, width)`` that the network sees [px]; fixed.
        batch: fixed number of images; None: any number.
        opset: 18, or an older one (11 to 17) for old boards.
        camera_size: ``(height, width)`` of uint8 frames [px]: the graph takes these and resizes itself.
        metadata: from :func:`describe`.

    Raises:
        ValueError: an opset, batch or size that cannot be, or that this network cannot be written in.
    """
    import onnx

    if not OLDEST_OPSET <= opset <= NEWEST_OPSET:
        raise ValueError(f"opset={opset}: choose {OLDEST_OPSET} to {NEWEST_OPSET}")
    if (batch is not None and batch < 1) or min(size) < 1:
        raise ValueError(f"batch={batch}, size={list(size)}: numbers above 0 are needed, or batch=null")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    network: nn.Module = fold(model).cpu()
    example = torch.rand(batch or 2, 3, *size)
    if camera_size is not None:
        network = CameraNet(network, camera_size, size)  # type: ignore[arg-type]
        example = torch.zeros(batch or 2, *camera_size, 3, dtype=torch.uint8)
    unfinished = path.with_name(f".{path.stem}.part.onnx")
    try:
        _torch_to_onnx(network.eval(), example, unfinished, batch is None, opset, bool(camera_size))
    except RuntimeError as error:  # the exporter's own errors are such
        unfinished.unlink(missing_ok=True)
        reason = (str(error).splitlines() or [""])[0]
        raise ValueError(f"opset={opset} cannot express this network: {reason}") from error
    graph = onnx.load(unfinished)
    onnx.helper.set_model_props(
        graph, {METADATA_PREFIX + key: value for key, value in (metadata or {}).items()}
    )
    onnx.checker.check_model(graph)
    onnx.save(graph, unfinished)
    unfinished.replace(path)
    return path


def _torch_to_onnx(
    network: nn.Module, example: Tensor, path: Path, any_batch: bool, opset: int, takes_frames: bool
) -> None:
    name = "frame" if takes_frames else "image"
    names: dict[str, Any] = {"input_names": [name], "output_names": ["depth"], "opset_version": opset}
    loggers = [logging.getLogger(each) for each in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings(), redirect_stdout(StringIO()), torch.no_grad():
            warnings.simplefilter("ignore")  # of its own parts that it is about to replace
            if opset == NEWEST_OPSET:
                shapes = ({0: torch.export.Dim("batch", min=1, max=4096)},) if any_batch else None
                torch.onnx.export(
                    network, (example,), str(path), dynamo=True, external_data=False, verbose=False,
                    dynamic_shapes=shapes, **names,
                )  # fmt: skip
            else:
                axes = {name: {0: "batch"}, "depth": {0: "batch"}} if any_batch else None
                torch.onnx.export(network, (example,), str(path), dynamo=False, dynamic_axes=axes, **names)
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def write_openvino(source: str | Path, path: str | Path, metadata: Mapping[str, str]) -> Path:
    """Turn an ONNX file into OpenVINO IR (``.xml`` + ``.bin``), fp32 weights."""
    import openvino

    return save_openvino(openvino.convert_model(str(source)), path, metadata)


def save_openvino(network: object, path: str | Path, metadata: Mapping[str, str]) -> Path:
    """Write an OpenVINO network as ``.xml`` + ``.bin`` with its metadata."""
    import openvino

    for key, value in metadata.items():
        network.set_rt_info(value, ["eldenet", key])  # type: ignore[attr-defined]
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    openvino.save_model(network, str(path), compress_to_fp16=False)
    return Path(path)


def read_metadata(path: str | Path) -> dict[str, str]:
    """What :func:`describe` put into a file; empty for a file from elsewhere."""
    if Path(path).suffix == ".onnx":
        import onnx

        props = {prop.key: prop.value for prop in onnx.load(path, load_external_data=False).metadata_props}
        return {
            key.removeprefix(METADATA_PREFIX): value
            for key, value in props.items()
            if key.startswith(METADATA_PREFIX)
        }
    import xml.etree.ElementTree as ElementTree

    node = ElementTree.parse(path).getroot().find("rt_info/eldenet")
    return {} if node is None else {child.tag: child.attrib["value"] for child in node}


def count_operations(path: str | Path) -> Counter[str]:
    """How often each operation occurs in an ONNX or OpenVINO file; constants do not count."""
    if Path(path).suffix == ".onnx":
        import onnx

        kinds = [node.op_type for node in onnx.load(path, load_external_data=False).graph.node]
    else:
        import xml.etree.ElementTree as ElementTree

        kinds = [layer.attrib["type"] for layer in ElementTree.parse(path).getroot().iter("layer")]
    return Counter(kind for kind in kinds if kind not in ("Constant", "Const", "Parameter", "Result"))


def differences(depth: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Largest and median difference between two depths, in meters and relative to the reference."""
    meters = np.abs(depth.astype(np.float64) - reference)
    relative = meters / np.abs(reference)
    return {
        "max_m": float(meters.max()),
        "median_m": float(np.median(meters)),
        "max_relative": float(relative.max()),
        "median_relative": float(np.median(relative)),
    }
