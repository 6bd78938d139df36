"""OpenVINO IR and ONNX files under OpenVINO."""

from pathlib import Path

import numpy as np

from eldenet.deploy.files import read_metadata
from eldenet.deploy.runtimes.base import Runtime, refuse

HINTS = {"fp32": "f32", "bf16": "bf16", "fp16": "f16", "int8": "f32"}  # int8: of what is between


class OpenvinoRuntime(Runtime):
    """An ``.xml`` or ``.onnx`` file under OpenVINO (on CPUs: oneDNN, once called MKL-DNN).

    Args:
        path: of the file.
        precision: None: the file's own. An fp32 file runs as bf16 on CPUs that have it.
        threads: on a CPU.
        device: "cpu", "gpu", "npu" or OpenVINO's own name.

    Raises:
        ValueError: a device or precision that is not to be had here.
    """

    runtime = "openvino"

    def __init__(
        self, path: str | Path, *, precision: str | None = None, threads: int = 1, device: str = "cpu"
    ) -> None:
        import openvino

        core = openvino.Core()
        name = device.upper()
        if name.partition(".")[0] not in {each.partition(".")[0] for each in core.available_devices}:
            raise ValueError(
                f"device={device!r}: OpenVINO here has {', '.join(core.available_devices).lower()}"
            )
        metadata = read_metadata(path)
        own = metadata.get("precision", "fp32")
        precision = precision or own
        capable = core.get_property(name, "OPTIMIZATION_CAPABILITIES")
        stored = "int8" if own == "int8" else "fp32"  # bf16 and fp16 are how fp32 weights are run
        allowed = [stored]
        if stored == "fp32":
            allowed += ["bf16"] * ("BF16" in capable)
            allowed += ["fp16"] * ("FP16" in capable and name != "CPU")  # CPUs accept it, and compute fp32
        refuse(
            precision,
            tuple(allowed),
            f"{Path(path).name} under OpenVINO",
            "export it with precision=int8" if precision == "int8" else "this processor has none",
        )
        hint = "bf16" if precision == "int8" and "BF16" in capable else HINTS[precision]
        settings: dict[str, str | int] = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": hint}
        if name == "CPU":
            settings["INFERENCE_NUM_THREADS"] = threads
        try:
            self.compiled = core.compile_model(str(path), name, settings)
        except RuntimeError as error:
            raise ValueError(f"OpenVINO cannot load {path}: {error}") from error
        super().__init__(precision, threads, device.lower(), metadata)
        self.request = self.compiled.create_infer_request()

    @property
    def fixed_batch(self) -> int | None:
        """From the input's shape."""
        batch = self.compiled.input(0).partial_shape[0]
        return int(batch.get_length()) if batch.is_static else None

    def run(self, images: np.ndarray) -> np.ndarray:
        """Arrays in, arrays out."""
        from openvino import PartialShape

        expected = self.compiled.input(0).partial_shape
        if not expected.compatible(PartialShape(list(images.shape))):
            raise ValueError(f"images are {images.shape}, this file takes {expected}: export another")
        depth = self.request.infer([images], share_inputs=True, share_outputs=True)[0]
        return depth.copy()  # the request writes the next one into the same place
