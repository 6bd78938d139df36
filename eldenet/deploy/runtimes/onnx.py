"""ONNX files under ONNX Runtime."""

from pathlib import Path

import numpy as np

from eldenet.deploy.metadata import own_metadata
from eldenet.deploy.runtimes.base import Runtime, refuse
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
        refuse(
            precision or own,
            (own,),
            f"{Path(path).name} under ONNX Runtime",
            f"export it with precision={precision}"
            if "int8" in (own, precision)
            else "bf16 runs under OpenVINO (runtime=openvino) and torch",
        )
        (port,) = self.session.get_inputs()
        self.input = port.name
        super().__init__(own, threads, "cpu" if provider == CPU else device, metadata, path, port.shape)

    def run_maps(self, images: np.ndarray) -> list[np.ndarray]:
        """Run arrays."""
        return list(self.session.run(None, {self.input: images}))
