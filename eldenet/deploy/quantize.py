"""int8 by post-training quantization: scales from calibration frames, no training."""

import logging
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

from eldenet.deploy.files import METADATA_PREFIX, read_metadata, save_openvino


def quantize_onnx(source: str | Path, path: str | Path, inputs: Sequence[np.ndarray]) -> Path:
    """fp32 ONNX -> int8 ONNX with quantize/dequantize pairs (QDQ), scales per channel.

    Convolutions and matrix products are quantized; what is between them stays in fp32, for ONNX Runtime has
    no int8 kernels for it.

    Args:
        source: fp32 file from :func:`eldenet.deploy.files.write_onnx`.
        path: of the new file.
        inputs: what the graph takes, one batch each: calibration.

    Raises:
        ValueError: there are no calibration inputs.
    """
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    _need(inputs)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {**read_metadata(source), "precision": "int8"}

    class Reader(CalibrationDataReader):
        def __init__(self, name: str) -> None:
            self.feeds = iter([{name: value} for value in inputs])

        def get_next(self) -> dict[str, np.ndarray] | None:
            return next(self.feeds, None)

    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()), _quiet():
        prepared = Path(folder) / "prepared.onnx"
        quant_pre_process(str(source), str(prepared), skip_symbolic_shape=True)
        quantize_static(
            str(prepared),
            str(path),
            Reader(onnx.load(prepared).graph.input[0].name),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv", "MatMul"],
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
    graph = onnx.load(path)
    onnx.helper.set_model_props(graph, {METADATA_PREFIX + key: value for key, value in metadata.items()})
    onnx.save(graph, path)
    return path


def quantize_openvino(
    source: str | Path, path: str | Path, inputs: Sequence[np.ndarray], metadata: Mapping[str, str]
) -> Path:
    """fp32 ONNX or OpenVINO IR -> int8 OpenVINO IR, by nncf.

    Raises:
        ValueError: there are no calibration inputs.
        ImportError: nncf is not installed.
    """
    import openvino

    _need(inputs)
    try:
        with _quiet():
            import nncf
    except ImportError as error:
        raise ImportError(f"int8 for OpenVINO needs nncf (pip install 'eldenet[deploy]'): {error}") from error
    network = openvino.Core().read_model(str(source))
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()), _quiet():
        quantized = nncf.quantize(
            network,
            nncf.Dataset(list(inputs)),
            preset=nncf.QuantizationPreset.MIXED,  # hard swish is not symmetric
            subset_size=len(inputs),
        )
    return save_openvino(quantized, path, {**metadata, "precision": "int8"})


def _need(inputs: Sequence[np.ndarray]) -> None:
    if not inputs:
        raise ValueError("int8 needs calibration frames: pictures like those the network will see")


class _quiet:
    """Keep quantizers from logging to the user's terminal for a while."""

    def __enter__(self) -> None:
        os.environ.setdefault("NNCF_DISABLE_TELEMETRY", "1")
        self.disabled = logging.root.manager.disable
        logging.disable(logging.WARNING)

    def __exit__(self, *error: object) -> None:
        logging.disable(self.disabled)
