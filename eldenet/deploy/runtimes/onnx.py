"""ONNX files under ONNX Runtime."""

from pathlib import Path

import numpy as np

from eldenet.deploy.runtimes.base import Runtime, refuse

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
}
# CUDA's would round the factors of fp32 convolutions and products to TF32's ten bits
OPTIONS = {PROVIDERS["cuda"]: {"use_tf32": "0"}}
PACKAGES = {"cuda": "onnxruntime-gpu", "tensorrt": "onnxruntime-gpu and TensorRT"}


class OnnxRuntime(Runtime):
    """An ``.onnx`` file under ONNX Runtime.

    Args:
        path: of the file.
        precision: None: the file's own.
        threads: on a CPU; they do not spin while they wait, so that other work can have the core.
        device: "cpu", "cuda", "tensorrt", or a provider's own name ("OpenVINOExecutionProvider").

    Raises:
        ValueError: a provider that this installation does not have or cannot start, or another precision
            than the file's.
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
        except Exception as error:  # its own exception classes share no base but this
            raise ValueError(f"ONNX Runtime cannot load {path}: {error}") from error
        if self.session.get_providers()[0] != provider:  # it falls back without a word
            raise ValueError(f"ONNX Runtime has {provider} but cannot start it: is its driver installed?")
        metadata = {
            key.removeprefix("eldenet."): value
            for key, value in self.session.get_modelmeta().custom_metadata_map.items()
            if key.startswith("eldenet.")
        }
        own = metadata.get("precision", "fp32")
        refuse(
            precision or own,
            (own,),
            f"{Path(path).name} under ONNX Runtime",
            f"export it with precision={precision}"
            if precision == "int8"
            else "bf16 runs under OpenVINO (runtime=openvino) and torch",
        )
        super().__init__(own, threads, "cpu" if provider == PROVIDERS["cpu"] else device, metadata)
        self.input = self.session.get_inputs()[0].name

    @property
    def fixed_batch(self) -> int | None:
        """From the input's shape, whose free sizes have names."""
        batch = self.session.get_inputs()[0].shape[0]
        return batch if isinstance(batch, int) else None

    def run(self, images: np.ndarray) -> np.ndarray:
        """Arrays in, arrays out."""
        try:
            return self.session.run(None, {self.input: images})[0]
        except Exception as error:
            if "Got invalid dimensions" not in str(error):
                raise
            shape = self.session.get_inputs()[0].shape
            raise ValueError(f"images are {images.shape}, this file takes {shape}: export another") from error


def provider_for(device: str, available: list[str]) -> str:
    """ONNX Runtime's name of the provider for ``device``.

    Raises:
        ValueError: this installation does not have it.
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
    """``provider``, and those that take what it leaves, in their order."""
    cuda = [PROVIDERS["cuda"]] if provider == PROVIDERS["tensorrt"] and PROVIDERS["cuda"] in available else []
    return list(dict.fromkeys([provider, *cuda, PROVIDERS["cpu"]]))
