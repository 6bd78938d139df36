"""ONNX files are opened by one rule: the provider that was asked for runs, or an error says why not."""

from pathlib import Path

import numpy as np
import pytest

from eldenet.system.onnx_files import CPU, CUDA, TENSORRT, open_session, read_graph

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    make = onnx.helper.make_tensor_value_info
    node = onnx.helper.make_node("Neg", ["image"], ["depth"])
    graph = onnx.helper.make_graph([node], "g", [make("image", 1, [2])], [make("depth", 1, [2])])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, tmp_path / "net.onnx")
    return tmp_path / "net.onnx"


@pytest.mark.parametrize(
    ("providers", "available", "passed"),
    [
        ([CPU], [CUDA, CPU], [CPU]),
        ([CUDA], [TENSORRT, CUDA, CPU], [CUDA, CPU]),
        ([TENSORRT], [TENSORRT, CUDA, CPU], [TENSORRT, CUDA, CPU]),
        ([TENSORRT], [TENSORRT, CPU], [TENSORRT, CPU]),
    ],
)
def test_what_a_provider_cannot_run_runs_on_the_next(
    providers: list[str], available: list[str], passed: list[str], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    class Session:
        def __init__(self, path: str, options: object, providers: list) -> None:
            given.extend(providers)

        def get_providers(self) -> list[str]:
            return [name for name, _ in given]

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: available)
    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)
    open_session(file, providers)
    assert [name for name, _ in given] == passed
    assert dict(given).get(CUDA, {"use_tf32": "0"}) == {"use_tf32": "0"}  # ONNX Runtime's own default is TF32


def test_a_provider_that_does_not_run_is_said(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CPU])
    for wrong in (["cuda"], [CUDA], []):
        with pytest.raises(ValueError, match=f"this ONNX Runtime has {CPU}"):
            open_session(file, wrong)
    with pytest.warns(UserWarning, match=f"runs on {CPU}: {CUDA} is not installed"):
        session = open_session(file, [CUDA, CPU])
    np.testing.assert_array_equal(session.run(None, {"image": np.float32([1, 2])})[0], [-1, -2])
    # installed, but not its driver: ONNX Runtime falls back to the CPU silently
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CUDA, CPU])
    if CUDA not in onnxruntime.InferenceSession(file, providers=[CUDA, CPU]).get_providers():
        with pytest.raises(ValueError, match="cannot start it: is its driver installed"):
            open_session(file, [CUDA])


def test_what_is_no_onnx_file_is_named(file: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.onnx does not exist"):
        open_session(file.with_name("none.onnx"))
    file.write_bytes(file.read_bytes()[:-9])
    for read in (open_session, read_graph):
        with pytest.raises(ValueError, match=r"net\.onnx is truncated or not a valid ONNX file"):
            read(file)
