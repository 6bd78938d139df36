"""Networks as OpenVINO files, ``.xml`` + ``.bin``: converted from ONNX files, and int8 by quantization."""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.deploy.metadata import BLANK, DIGEST, sealed
from eldenet.system.extras import require
from eldenet.system.files import part_file


def decline_telemetry() -> None:
    """Keep OpenVINO and nncf from sending telemetry in this process; call it before they are imported.

    Each import and each conversion is reported to Google Analytics, unless a file in the user's home folder
    declines. Without ``openvino_telemetry``, an optional package, nothing is sent or stored.
    """
    telemetry = sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
    if telemetry is not None:  # the program has imported OpenVINO itself
        telemetry.main.TelemetrySender.send = lambda *message: None


@cache
def openvino_core() -> Any:
    """Return OpenVINO's core, one for the whole process.

    Its CPU plugin takes over the stack on which this thread handles signals. After two plugins that end in
    the order in which they began, that stack is gone, and the next signal (Ctrl-C) is a crash.
    """
    decline_telemetry()
    import openvino

    return openvino.Core()


def write_openvino(source: str | Path, path: str | Path, metadata: Mapping[str, str]) -> Path:
    """Convert an ONNX file to OpenVINO IR (``.xml`` + ``.bin``) with fp32 weights."""
    decline_telemetry()
    import openvino

    return _save(openvino.convert_model(str(source)), Path(path), metadata)


def quantize_openvino(
    source: str | Path, path: str | Path, inputs: Sequence[np.ndarray], metadata: Mapping[str, str]
) -> Path:
    """Turn an fp32 ONNX file into int8 OpenVINO IR with nncf.

    The first convolution stays fp32, and so do the rays, which come of the focal length alone, up to the
    operations that join them with the image (:func:`eldenet.deploy.onnx_export.quantize_onnx` says why).

    Args:
        inputs: calibration batches, as the file takes them.

    Raises:
        ImportError: nncf is not installed.
    """
    from eldenet.deploy.onnx_export import calibration_feeds, quiet

    decline_telemetry()
    require("int8 for OpenVINO", "nncf")
    with quiet():
        import nncf
    network = openvino_core().read_model(str(source))
    seen = {network.inputs[0].get_node().get_friendly_name()}  # what depends on the image's values
    of_lens = {port.get_node().get_friendly_name() for port in network.inputs[1:]}  # on the lens alone
    stem: list[str] = []
    exact: list[str] = []
    for op in network.get_ordered_ops():
        name, kind = op.get_friendly_name(), op.get_type_name()
        given = {port.get_node().get_friendly_name() for port in op.input_values()}
        if kind != "ShapeOf" and given & seen:
            seen.add(name)
            stem += [name] * (kind == "Convolution" and not stem)
            exact += [name] * bool(given & of_lens)
        elif given & of_lens or kind == "Convolution":  # of rays that a file of one lens holds
            of_lens.add(name)
            exact.append(name)
    with quiet():
        quantized = nncf.quantize(
            network,
            nncf.Dataset(calibration_feeds(source, inputs)),
            preset=nncf.QuantizationPreset.MIXED,  # hard swish is not symmetric
            subset_size=len(inputs),
            ignored_scope=nncf.IgnoredScope(names=stem + exact) if stem else None,
        )
    return _save(quantized, Path(path), {**metadata, "precision": "int8"})


def _save(network: Any, path: Path, metadata: Mapping[str, str]) -> Path:
    """Write a network with its metadata and a digest of both files (:mod:`eldenet.deploy.metadata`)."""
    import openvino

    for key, value in {**metadata, DIGEST: BLANK}.items():
        network.set_rt_info(value, ["eldenet", key])
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / path.name
        openvino.save_model(network, str(draft), compress_to_fp16=False)
        content, weights = draft.read_bytes(), draft.with_suffix(".bin").read_bytes()
    with part_file(path) as unfinished, part_file(path.with_suffix(".bin")) as unfinished_weights:
        unfinished_weights.write_bytes(weights)
        unfinished.write_bytes(sealed(content, weights))
    return path
