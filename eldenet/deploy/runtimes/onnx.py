"""ONNX files under ONNX Runtime."""

from pathlib import Path

import numpy as np

from eldenet.deploy.metadata import own_metadata
from eldenet.deploy.runtimes.base import FOCAL, Runtime, check_inputs, check_precision, unknown_focal
from eldenet.system.onnx_files import CPU, CUDA, TENSORRT, open_session

PROVIDERS = {"cpu": CPU, "cuda": CUDA, "tensorrt": TENSORRT}


class OnnxRuntime(Runtime):
    """An ``.onnx`` file under ONNX Runtime.

    Args:
        precision: must be the file's own; None accepts any.
        device: "cpu", "cuda", "tensorrt", or a provider's own name ("OpenVINOExecutionProvider").

    Raises:
        ValueError: the provider is missing or cannot start, or the file has another precision.
    """

    runtime = "onnxruntime"

    def __init__(
        self, path: str | Path, *, precision: str | None = None, threads: int = 1, device: str = "cpu"
    ) -> None:
        provider = PROVIDERS.get(device, device)
        self.session = open_session(path, [provider], threads=threads)
        metadata = own_metadata(self.session.get_modelmeta().custom_metadata_map)
        own = metadata.get("precision", "fp32")
        check_precision(
            precision or own,
            (own,),
            f"{Path(path).name} under ONNX Runtime",
            f"export it with precision={precision}"
            if "int8" in (own, precision)
            else "bf16 runs under OpenVINO (runtime=openvino) and torch",
        )
        port, *others = self.session.get_inputs()
        check_inputs(path, port.shape, [other.name for other in others])
        self.input = port.name
        device = "cpu" if provider == CPU else device
        super().__init__(own, threads, device, metadata, path, port.shape, sees_rays=bool(others))

    def run_maps(self, images: np.ndarray, focal: np.ndarray | None = None) -> list[np.ndarray]:
        """Run arrays."""
        given = {self.input: images}
        if self.sees_rays:
            given[FOCAL] = unknown_focal(images) if focal is None else focal
        return list(self.session.run(None, given))
