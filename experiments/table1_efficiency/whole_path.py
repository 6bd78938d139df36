"""Time the whole path on a robot: from a 640x480 uint8 frame to meters at 640x480, by an exported file.

python experiments/table1_efficiency/whole_path.py
"""

import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

import eldenet
from eldenet.deploy import runtimes
from eldenet.deploy.onnx_export import write_onnx
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluation.cost import median_ms, percentile_ms, time_interleaved
from eldenet.results.run_record import environment
from eldenet.results.tables import to_markdown

SIZES = ((224, 224), (120, 160))


def main() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    predictors = {}
    with tempfile.TemporaryDirectory() as folder:
        for size in SIZES:
            torch.manual_seed(0)
            model = eldenet.load("eldenet")
            file = write_onnx(model, Path(folder) / f"{size[0]}x{size[1]}.onnx", size)
            for runtime in ("onnxruntime", "openvino"):
                for threads in (1, 2):
                    network = runtimes.load(file, runtime, threads=threads)
                    predictors[runtime, size, threads] = DepthPredictor(network, size)
        assert all(predictor(frame).shape == (480, 640) for predictor in predictors.values())
        calls = {
            str(key): lambda predictor=predictor: predictor(frame) for key, predictor in predictors.items()
        }
        times = time_interleaved(calls, rounds=9, seconds=0.5)
    rows = []
    for runtime, size, threads in predictors:
        spent = times[str((runtime, size, threads))]
        middle = median_ms(spent)
        cells = [f"{middle:.2f}", f"{percentile_ms(spent, 95):.2f}", f"{1000 / middle:.0f}"]
        rows.append([runtime, f"{size[0]} x {size[1]}", str(threads), *cells])
    found = environment()
    packages = ("torch", "onnxruntime", "openvino", "opencv-python-headless")
    versions = ", ".join(f"{name} {version(name)}" for name in packages)
    notes = [
        "eldenet, fp32, one frame at a time: resize (cv2), network, depth enlarged (cv2); median of "
        "9 interleaved rounds of 0.5 s",
        f"{found['hardware']['processor']}; {versions}; python experiments/table1_efficiency/whole_path.py",
    ]
    titles = ["runtime", "network sees", "threads", "p50 [ms]", "p95 [ms]", "frames/s"]
    print(to_markdown(titles, rows, notes))


if __name__ == "__main__":
    main()
