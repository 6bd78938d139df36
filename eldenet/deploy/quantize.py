"""int8 by post-training quantization: calibration pictures give the scales, without training."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eldenet.data.io import IMAGE_ENDINGS, read_image
from eldenet.data.splits import evenly_spaced
from eldenet.deploy.files import decline_telemetry, quiet, read_metadata, save_openvino, set_metadata
from eldenet.system.files import part_file


def read_pictures(source: str | None, count: int, split: str) -> list[np.ndarray]:
    """Up to ``count`` pictures ``(H, W, 3)`` uint8 RGB, evenly spread over a folder or a pattern.

    Without a source they are frames of the built-in rooms.

    Raises:
        ValueError: the source holds no pictures.
    """
    if source is None:
        from eldenet.data.rooms import Rooms

        rooms = Rooms(split, frames=count)
        return [rooms.load_frame(index).image for index in range(len(rooms))]
    folder = Path(source).expanduser()
    paths = sorted(folder.iterdir() if folder.is_dir() else folder.parent.glob(folder.name))
    paths = [path for path in paths if path.suffix.lower() in IMAGE_ENDINGS]
    if not paths:
        raise ValueError(
            f"pictures={source} holds no pictures: give a folder, or a pattern such as 'photos/*.jpg'"
        )
    return [read_image(paths[index], upright=True) for index in evenly_spaced(len(paths), count)]


def quantize_onnx(source: str | Path, path: str | Path, inputs: Sequence[np.ndarray]) -> Path:
    """Turn fp32 ONNX into int8 ONNX with quantize/dequantize pairs (QDQ), scales per channel.

    Convolutions and matrix products are quantized; the rest stays fp32, as ONNX Runtime has no int8 kernels
    for it.

    Args:
        source: fp32 file from :func:`eldenet.deploy.files.write_onnx`.
        path: of the new file.
        inputs: calibration batches, as the graph takes them.
    """
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    path = Path(path)
    metadata = {**read_metadata(source), "precision": "int8"}

    class Reader(CalibrationDataReader):
        def __init__(self, name: str) -> None:
            self.feeds = iter([{name: value} for value in inputs])

        def get_next(self) -> dict[str, np.ndarray] | None:
            return next(self.feeds, None)

    with part_file(path) as unfinished, tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        with quiet():
            quant_pre_process(str(source), str(prepared), skip_symbolic_shape=True)
            quantize_static(
                str(prepared),
                str(unfinished),
                Reader(onnx.load(prepared).graph.input[0].name),
                quant_format=QuantFormat.QDQ,
                op_types_to_quantize=["Conv", "MatMul"],
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
        set_metadata(unfinished, metadata)
    return path


def quantize_openvino(
    source: str | Path, path: str | Path, inputs: Sequence[np.ndarray], metadata: Mapping[str, str]
) -> Path:
    """Turn fp32 ONNX or OpenVINO IR into int8 OpenVINO IR with nncf.

    Raises:
        ImportError: nncf is not installed.
    """
    decline_telemetry()
    import openvino

    try:
        with quiet():
            import nncf
    except ImportError as error:
        raise ImportError(f"int8 for OpenVINO needs nncf (pip install 'eldenet[deploy]'): {error}") from error
    network = openvino.Core().read_model(str(source))
    with quiet():
        quantized = nncf.quantize(
            network,
            nncf.Dataset(list(inputs)),
            preset=nncf.QuantizationPreset.MIXED,  # hard swish is not symmetric
            subset_size=len(inputs),
        )
    return save_openvino(quantized, path, {**metadata, "precision": "int8"})
