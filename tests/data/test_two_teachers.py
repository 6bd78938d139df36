"""The two teachers of experiments/indoor: their mean has the network's scale, and FastDepth's file runs."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest
import torch

FILE = Path(__file__).resolve().parents[2] / "experiments" / "indoor" / "two_teachers.py"


@pytest.fixture
def module() -> ModuleType:
    pytest.importorskip("ai_edge_litert", reason="needs pip install ai-edge-litert")
    spec = importlib.util.spec_from_file_location("two_teachers", FILE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def test_the_mean_lies_between_the_teachers_and_has_the_networks_median(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "ELDENET_WEIGHTS" not in os.environ:
        pytest.skip("ELDENET_WEIGHTS is not set: FastDepth's file is not here")
    ramp = torch.linspace(1, 4, 48).view(1, 1, 48, 1).expand(2, 1, 48, 64)

    class Network:
        input_size, signature = (48, 64), {"source": "ramp"}

        def __call__(self, image: torch.Tensor) -> torch.Tensor:
            return ramp

    monkeypatch.setattr(module, "build_teacher", lambda **_: Network())
    file = Path(os.environ["ELDENET_WEIGHTS"]) / "depth" / "fastdepth_nyu_int8_224.tflite"
    teacher = module.TwoTeachers(file, source="ramp")
    images = torch.rand(2, 3, 48, 64, generator=torch.Generator().manual_seed(0))
    depth = teacher(images)
    other = depth**2 / ramp  # FastDepth's depth, moved to the network's median
    assert depth.shape == (2, 1, 48, 64)
    for one in range(2):
        torch.testing.assert_close(other[one].median(), ramp[one].median())
    assert (depth >= torch.minimum(ramp, other) - 1e-5).all()
    assert (depth <= torch.maximum(ramp, other) + 1e-5).all()
    assert not torch.allclose(depth, ramp)
    assert set(teacher.signature) == {"network", "fastdepth", "mean"}
