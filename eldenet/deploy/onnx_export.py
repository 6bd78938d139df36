"""Networks as ONNX files: the graph around the network, the opset, and int8 by quantization."""

import json
import logging
import os
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import BytesIO, StringIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet import __version__
from eldenet.deploy.fold import fold
from eldenet.deploy.metadata import BLANK, DIGEST, PREFIX, PRODUCER, read_metadata, sealed
from eldenet.deploy.runtimes.base import FOCAL
from eldenet.geometry import focal_of_fov, same_aspect, size_of_aspect
from eldenet.model import DepthNet, EncoderDecoder
from eldenet.system.errors import first_line
from eldenet.system.files import write_bytes
from eldenet.system.onnx_files import NEWEST_OPSET, OLDEST_OPSET, read_graph

if TYPE_CHECKING:
    import onnx

AXES = {"batch": 0, "height": 2, "width": 3}  # of images (B, 3, H, W)
LEAST = {"batch": 1, "height": 16, "width": 16}
LENSES = (0.7, 1.0, 1.4)  # of the calibration of int8, in canonical focal lengths


def write_onnx(
    model: DepthNet,
    path: str | Path,
    size: tuple[int, int],
    *,
    any_size: bool = False,
    batch: int | None = None,
    opset: int = NEWEST_OPSET,
    camera_size: tuple[int, int] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write an ONNX file of fp32 weights; the network is folded first (:func:`eldenet.deploy.fold.fold`).

    Args:
        model: is not changed.
        size: ``(height, width)`` that the network sees [px]; fixed, unless ``any_size``.
        any_size: the file takes images of any size, as torch does.
        batch: fixed number of images; None: any number.
        opset: 18, or an older one (11 to 17) for old boards.
        camera_size: ``(height, width)`` of uint8 frames [px]: the graph takes these and resizes itself.
        metadata: from :func:`eldenet.deploy.metadata.describe`. Where it has a ``fov``, the graph knows this
            lens and answers in meters for it.

    Raises:
        ValueError: the opset, batch or size is out of range; frames would be stretched to ``size``; a ``fov``
            is given for a network that ignores lenses, or with ``any_size``; or the opset cannot express the
            network, or not at any size (:func:`needs_fixed_size`).
    """
    if not OLDEST_OPSET <= opset <= NEWEST_OPSET:
        raise ValueError(f"opset={opset}: choose {OLDEST_OPSET} to {NEWEST_OPSET}")
    if (batch is not None and batch < 1) or min(size) < 1:
        raise ValueError(f"batch={batch}, size={list(size)}: give numbers above 0, or batch=null")
    fov = json.loads((metadata or {}).get("fov", "null"))
    if any_size and fov is not None:
        raise ValueError(f"fov={fov:g}: one camera has pictures of one size: leave any_size out")
    if fov is not None and model.canonical_px is None:
        raise ValueError(
            f"fov={fov:g}: this network ignores lenses: train with canonical_focal, or leave it out"
        )
    only_one_size = f"this network has no graph for any size: give size={list(size)} (predict: input_size=)"
    network: nn.Module = fold(model).cpu()
    if any_size and needs_fixed_size(network):
        raise ValueError(only_one_size)
    takes_lens = model.sees_rays and fov is None
    outputs, lens = ["depth"], [torch.full((batch or 2,), 0.8 * size[1])] * takes_lens
    if model.distribution is not None:
        network, outputs = SigmaNet(network), ["depth", "sigma"]  # type: ignore[arg-type]
    name, example = "image", torch.rand(batch or 2, 3, *size)
    if camera_size is not None:
        seen = (camera_size[0], camera_size[1] * (model.info.get("stretch") or 1.0))
        if not same_aspect(size, seen):
            raise ValueError(
                f"size={list(size)} would stretch frames of camera={list(camera_size)}: give size="
                f"{list(size_of_aspect(size, seen))}, or leave it out"
            )
        network = CameraNet(network, camera_size, size)
        name, example = "frame", torch.zeros(batch or 2, *camera_size, 3, dtype=torch.uint8)
    if fov is not None:
        network = LensNet(network, focal_of_fov(fov, (camera_size or size)[1]))
    try:
        with quiet(), torch.no_grad():
            axes = ["batch"] * (batch is None) + ["height", "width"] * any_size
            inputs = [name] + [FOCAL] * takes_lens
            graph = _to_onnx(network.eval(), (example, *lens), (inputs, outputs), axes, opset)
    except RuntimeError as error:  # base class of the exporter's errors
        if any_size:
            raise ValueError(only_one_size) from error
        raise ValueError(f"opset={opset} cannot express this network: {first_line(error)}") from error
    return write_graph(graph, Path(path), metadata or {})


def needs_fixed_size(network: nn.Module) -> bool:
    """Whether the network has no graph for any size: its backbone rounds odd sides down, or takes none.

    Where a backbone rounds down, the decoder pads, and a graph pads as at the size that it was made for.
    """
    inner = next((part for part in network.modules() if isinstance(part, EncoderDecoder)), None)
    if inner is None:
        return False
    strides = [info.stride for info in inner.backbone.feature_info]
    side = 2 * max(strides) + min(strides)  # the first feature has an odd side, and so on
    try:
        with torch.inference_mode():
            features = inner.backbone(torch.zeros(1, 3, side, side))
    except Exception:  # of a fixed size or of windows: each fails in its way
        return True
    sides = [stride * len(map_[0, 0]) for stride, map_ in zip(strides, features, strict=True)]
    return any(finer > coarser for finer, coarser in pairwise(sides))


def _to_onnx(
    network: nn.Module,
    examples: tuple[Tensor, ...],
    ports: tuple[list[str], list[str]],
    axes: Sequence[str],
    opset: int,
) -> "onnx.ModelProto":
    """The graph of a network.

    Args:
        examples: inputs.
        ports: names of the inputs, and of the outputs.
        axes: those of :data:`AXES` that may have any length.
    """
    import onnx

    names: dict[str, Any] = {"input_names": ports[0], "output_names": ports[1], "opset_version": opset}
    if opset == NEWEST_OPSET:
        dims = {AXES[name]: torch.export.Dim(name, min=LEAST[name], max=4096) for name in axes}
        shapes = (dims, *[{key: dim for key, dim in dims.items() if key == 0} for _ in examples[1:]])
        program: Any = torch.onnx.export(
            network, examples, dynamo=True, dynamic_shapes=shapes if axes else None, verbose=False, **names
        )
        return program.model_proto
    if "height" in axes:
        raise ValueError(f"opset={opset}: files for any size need opset={NEWEST_OPSET}")
    content: Any = BytesIO()
    lengths = {port: {0: "batch"} for port in ports[0] + ports[1]} if axes else None
    torch.onnx.export(network, examples, content, dynamo=False, dynamic_axes=lengths, **names)
    return onnx.load_from_string(content.getvalue())


def write_graph(graph: "onnx.ModelProto", path: Path, metadata: Mapping[str, str]) -> Path:
    """Write a graph with its metadata and a digest of all of it (:mod:`eldenet.deploy.metadata`)."""
    import onnx

    graph.producer_name, graph.producer_version = PRODUCER, __version__
    entries = {**metadata, DIGEST: BLANK}
    onnx.helper.set_model_props(graph, {PREFIX + key: value for key, value in entries.items()})
    onnx.checker.check_model(graph)
    write_bytes(path, sealed(graph.SerializeToString()))
    return path


def quantize_onnx(source: str | Path, path: str | Path, inputs: Sequence[np.ndarray]) -> Path:
    """Turn fp32 ONNX into int8 ONNX with quantize/dequantize pairs (QDQ), scales per channel.

    Post-training quantization: calibration pictures give the scales, nothing is trained. Convolutions and
    matrix products are quantized; the rest stays fp32, as ONNX Runtime has no int8 kernels for it. Two parts
    stay fp32 for their accuracy:

    - the first convolution: eight bits of the normalized picture cost the most (``experiments/bench``);
    - the rays, which come of the focal length alone: eight bits would move the scale of a picture.

    Args:
        inputs: calibration batches, as the graph takes them.
    """
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Reader(CalibrationDataReader):
        def __init__(self) -> None:
            self.feeds = iter(calibration_feeds(source, inputs))

        def get_next(self) -> dict[str, np.ndarray] | None:
            return next(self.feeds, None)

    with tempfile.TemporaryDirectory() as folder, quiet():
        prepared, quantized = Path(folder) / "prepared.onnx", Path(folder) / "int8.onnx"
        quant_pre_process(str(source), str(prepared), skip_symbolic_shape=True)
        graph = read_graph(prepared).graph
        seen, of_image = {graph.input[0].name}, []  # what depends on the image's values
        for node in graph.node:
            if node.op_type != "Shape" and seen.intersection(node.input):
                seen.update(node.output)
                of_image.append(node)
        kinds = [node.op_type for node in of_image]
        stem = of_image[: kinds.index("Conv") + 1] if "Conv" in kinds else []
        rays = [node for node in graph.node if not seen.intersection(node.output)]
        quantize_static(
            str(prepared),
            str(quantized),
            Reader(),
            nodes_to_exclude=[node.name for node in (*stem, *rays)],
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv", "MatMul"],
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        return write_graph(read_graph(quantized), Path(path), {**read_metadata(source), "precision": "int8"})


def calibration_feeds(source: str | Path, inputs: Sequence[np.ndarray]) -> list[dict[str, np.ndarray]]:
    """Calibration batches by the name of the file's input; a file that takes lenses gets :data:`LENSES`."""
    ports = [port.name for port in read_graph(source).graph.input]
    feeds = [{ports[0]: value} for value in inputs]
    if FOCAL in ports:
        facts = read_metadata(source)
        canonical_px = json.loads(facts["canonical_focal"]) * json.loads(facts["canonical_width"])
        if camera_size := json.loads(facts["camera_size"]):  # a lens is given in pixels of the frames
            canonical_px *= camera_size[1] / json.loads(facts["input_size"])[1]
        for number, feed in enumerate(feeds):
            focal = canonical_px * LENSES[number % len(LENSES)]
            feed[FOCAL] = np.full(len(feed[ports[0]]), focal, np.float32)
    return feeds


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the log lines, warnings and prints of exporters and quantizers off the terminal."""
    disabled, output = logging.root.manager.disable, os.dup(1)
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            warnings.simplefilter("ignore")
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), 1)  # torch prints the graph that it cannot express from C++
            yield
    finally:
        os.dup2(output, 1)
        os.close(output)
        logging.disable(disabled)


class SigmaNet(nn.Module):
    """Depth and standard deviation of a model that predicts its sigma, as two outputs."""

    def __init__(self, model: DepthNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Tensor, focal: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """``image (B, 3, H, W)``, fx ``(B,)`` [px] -> depth and sigma ``(B, 1, H, W)`` [m] each."""
        estimate = self.model.predict(image, focal)
        return estimate.depth, estimate.sigma


class CameraNet(nn.Module):
    """Frames in, meters at the camera's size out, in one graph.

    Frames are resized as by :func:`eldenet.geometry.resize_image` (area where they shrink, else bilinear),
    but not rounded to whole gray levels. Depth is resized bilinearly, as by
    :class:`~eldenet.deploy.predictor.DepthPredictor`.

    Args:
        model: image -> meters, or a tuple of such maps.
        camera_size: ``(height, width)`` of the frames [px].
        input_size: ``(height, width)`` that the network sees [px].
    """

    rows: Tensor
    cols: Tensor

    def __init__(self, model: nn.Module, camera_size: tuple[int, int], input_size: tuple[int, int]) -> None:
        super().__init__()
        pairs = list(zip(camera_size, input_size, strict=True))
        self.shrinks = camera_size != input_size and all(seen <= given for given, seen in pairs)
        self.model, self.camera_size, self.input_size = model, camera_size, input_size
        whole = [given // seen for given, seen in pairs if given % seen == 0]
        self.blocks = (whole[0], whole[1]) if len(whole) == 2 else None
        rows, cols = (area_weights(given, seen) if self.shrinks else torch.eye(1) for given, seen in pairs)
        self.register_buffer("rows", rows)
        self.register_buffer("cols", cols)

    def forward(self, frame: Tensor, focal: Tensor | None = None) -> Tensor | tuple[Tensor, ...]:
        """``frame (B, H, W, 3)`` uint8 RGB -> depth ``(B, 1, H, W)`` [m], or the maps of the model.

        ``focal (B,)`` is fx [px of ``frame``], for a model that sees rays.
        """
        image = frame.permute(0, 3, 1, 2).float()
        if self.camera_size != self.input_size:
            image = self.resized(image)
        lens = [] if focal is None else [focal * (self.input_size[1] / self.camera_size[1])]
        maps = self.model(image / 255.0, *lens)
        if isinstance(maps, tuple):
            return tuple(self.enlarged(each) for each in maps)
        return self.enlarged(maps)

    def enlarged(self, depth: Tensor) -> Tensor:
        """A map of the model at the camera's size."""
        if self.camera_size == self.input_size:
            return depth
        return F.interpolate(depth, size=self.camera_size, mode="bilinear", align_corners=False)

    def resized(self, image: Tensor) -> Tensor:
        """``image (B, 3, H, W)`` at ``input_size``: averaged over areas, or bilinear where it grows."""
        if not self.shrinks:
            return F.interpolate(image, size=self.input_size, mode="bilinear", align_corners=False)
        if self.blocks is not None:
            return F.avg_pool2d(image, self.blocks)
        # transposed: OpenVINO fails where what follows is per channel and it joins that to a product
        return (self.cols @ (self.rows @ image).transpose(2, 3)).transpose(2, 3)


class LensNet(nn.Module):
    """A network of one camera: it is told that lens with every image or frame.

    Args:
        model: images ``(B, 3, H, W)`` or frames ``(B, H, W, 3)``, and fx ``(B,)`` [px of these] -> maps.
        focal: fx [px of these].
    """

    def __init__(self, model: nn.Module, focal: float) -> None:
        super().__init__()
        self.model, self.focal = model, focal

    def forward(self, image: Tensor) -> Tensor | tuple[Tensor, ...]:
        """Return the maps of the model for this lens."""
        return self.model(image, torch.full((image.shape[0],), self.focal, device=image.device))


def area_weights(given: int, wanted: int) -> Tensor:
    """Return ``(wanted, given)``: the share of each given pixel in each wanted one; rows add up to 1."""
    edges = torch.arange(wanted + 1, dtype=torch.float64) * given / wanted
    pixels = torch.arange(given, dtype=torch.float64)
    covered = torch.minimum(edges[1:, None], pixels + 1) - torch.maximum(edges[:-1, None], pixels)
    return (covered.clamp_min(0) * wanted / given).float()
