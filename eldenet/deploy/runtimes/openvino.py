"""OpenVINO IR and ONNX files under OpenVINO."""

import threading
from pathlib import Path

import numpy as np

from eldenet.deploy.metadata import read_metadata
from eldenet.deploy.openvino_export import openvino_core
from eldenet.deploy.runtimes.base import FOCAL, Runtime, check_inputs, check_precision, unknown_focal
from eldenet.system.errors import reading
from eldenet.system.onnx_files import EXPORT_AGAIN

HINTS = {"fp32": "f32", "bf16": "bf16", "fp16": "f16", "int8": "f32"}  # int8: of the layers between


class OpenvinoRuntime(Runtime):
    """An ``.xml`` or ``.onnx`` file under OpenVINO (on CPUs: oneDNN, once called MKL-DNN).

    Callers in several threads wait for each other: a request per thread would need more memory and be no
    faster, because one image takes all the threads of the runtime.

    Args:
        precision: None: the file's own. An fp32 file also runs as bf16 on CPUs that multiply it.
        device: "cpu", "gpu", "npu" or OpenVINO's own name.

    Raises:
        ValueError: the device or precision is not available.
    """

    runtime = "openvino"

    def __init__(
        self, path: str | Path, *, precision: str | None = None, threads: int = 1, device: str = "cpu"
    ) -> None:
        core = openvino_core()
        name = device.upper()
        if name.partition(".")[0] not in {each.partition(".")[0] for each in core.available_devices}:
            raise ValueError(
                f"device={device!r}: OpenVINO offers {', '.join(core.available_devices).lower()} here"
            )
        metadata = read_metadata(path)
        own = metadata.get("precision", "fp32")
        precision = precision or own
        capable = core.get_property(name, "OPTIMIZATION_CAPABILITIES")
        stored = "int8" if own == "int8" else "fp32"  # bf16 and fp16 are ways to run fp32 weights
        allowed = [stored]
        if stored == "fp32":
            allowed += ["bf16"] * ("BF16" in capable)
            allowed += ["fp16"] * ("FP16" in capable and name != "CPU")  # CPUs accept fp16 but compute fp32
        check_precision(
            precision,
            tuple(allowed),
            f"{Path(path).name} under OpenVINO",
            f"export it with precision={precision}"
            if "int8" in (own, precision)
            else "this processor cannot multiply it",
        )
        hint = "bf16" if precision == "int8" and "BF16" in capable else HINTS[precision]
        settings: dict[str, str | int] = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": hint}
        if name == "CPU":
            settings["INFERENCE_NUM_THREADS"] = threads
        with reading(path, "file for OpenVINO", EXPORT_AGAIN):
            self.compiled = core.compile_model(str(path), name, settings)
            sides = list(self.compiled.input(0).partial_shape)
            # a port has several names where operations that change nothing follow it
            named = [port.get_names() for port in self.compiled.inputs[1:]]
            others = [FOCAL if FOCAL in names else min(names) for names in named]
        shape = [side.get_length() if side.is_static else None for side in sides]
        check_inputs(path, shape, others)
        super().__init__(precision, threads, device.lower(), metadata, path, shape, sees_rays=bool(others))
        self.request = self.compiled.create_infer_request()
        self._one_at_a_time = threading.Lock()

    def run_maps(self, images: np.ndarray, focal: np.ndarray | None = None) -> list[np.ndarray]:
        """Run arrays."""
        given = [images]
        if self.sees_rays:
            given.append(unknown_focal(images) if focal is None else focal)
        with self._one_at_a_time:  # until the copy is made: the request reuses the memory
            found = self.request.infer(given, share_inputs=True, share_outputs=True)
            return [found[number].copy() for number in range(len(self.compiled.outputs))]
