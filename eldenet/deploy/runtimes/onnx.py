"""ONNX files under ONNX Runtime."""

from pathlib import Path

import numpy as np

from eldenet.deploy.files import checked, read_metadata, without_prefix
from eldenet.deploy.runtimes.base import Runtime, refuse

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
}
# by default CUDA rounds the factors of fp32 convolutions and products to the ten bits of TF32
OPTIONS = {PROVIDERS["cuda"]: {"use_tf32": "0"}}
PACKAGES = {"cuda": "onnxruntime-gpu", "tensorrt": "onnxruntime-gpu and TensorRT"}


class OnnxRuntime(Runtime):
    """An ``.onnx`` file under ONNX Runtime.

    Args:
        path: of the file.
        precision: must be the file's own; None accepts any.
        threads: on a CPU; they do not spin while they wait, so that other work can use the core.
        device: "cpu", "cuda", "tensorrt", or a provider's own name ("OpenVINOExecutionProvider").

    Raises:
        ValueError: the provider is missing or cannot start, or the file has another precision.
    """

    runtime = "onnxruntime"

    def __init__(
        self, path: str | Path, *, precision: str | None = None, threads: int = 1, device: str = "cpu"
    ) -> None:
        import onnxruntime

        available = onnxruntime.get_available_providers()
        provider = provider_for(device, available)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        wanted = providers_behind(provider, available)
        try:
            self.session = onnxruntime.InferenceSession(
                str(path), options, providers=[(name, OPTIONS.get(name, {})) for name in wanted]
            )
        except Exception as error:  # the only common base of its exception classes
            read_metadata(path)  # says so if it is no ONNX file at all
            raise ValueError(f"ONNX Runtime cannot load {path}: {error}") from error
        if self.session.get_providers()[0] != provider:  # it falls back silently
            raise ValueError(f"ONNX Runtime has {provider} but cannot start it: is its driver installed?")
        metadata = checked(path, without_prefix(self.session.get_modelmeta().custom_metadata_map))
        own = metadata.get("precision", "fp32")
        refuse(
            precision or own,
            (own,),
            f"{Path(path).name} under ONNX Runtime",
            f"export it with precision={precision}"
            if "int8" in (own, precision)
            else "bf16 runs under OpenVINO (runtime=openvino) and torch",
        )
        super().__init__(own, threads, "cpu" if provider == PROVIDERS["cpu"] else device, metadata)
        self.path = path
        self.input = self.session.get_inputs()[0].name

    @property
    def fixed_batch(self) -> int | None:
        """Batch of the input's shape, where it is a number."""
        batch = self.session.get_inputs()[0].shape[0]
        return batch if isinstance(batch, int) else None

    def run_maps(self, images: np.ndarray) -> list[np.ndarray]:
        """Run arrays."""
        try:
            return list(self.session.run(None, {self.input: images}))
        except Exception as error:
            if "Got invalid dimensions" not in str(error):
                raise ValueError(f"ONNX Runtime cannot run {self.path}: {error}") from error
            shape = self.session.get_inputs()[0].shape
            raise ValueError(f"images are {images.shape}, this file takes {shape}: export another") from error


def provider_for(device: str, available: list[str]) -> str:
    """ONNX Runtime's provider for ``device``.

    Raises:
        ValueError: it is not installed.
    """
    provider = PROVIDERS.get(device, device)
    if provider not in available:
        install = f"install {PACKAGES[device]}, or " if device in PACKAGES else ""
        raise ValueError(
            f"device={device!r} needs ONNX Runtime's {provider}; this installation has "
            f"{', '.join(available)}: {install}choose one of {', '.join(PROVIDERS)} or a provider's name"
        )
    return provider


def providers_behind(provider: str, available: list[str]) -> list[str]:
    """``provider``, followed by those that run what it cannot."""
    cuda = [PROVIDERS["cuda"]] if provider == PROVIDERS["tensorrt"] and PROVIDERS["cuda"] in available else []
    return list(dict.fromkeys([provider, *cuda, PROVIDERS["cpu"]]))
