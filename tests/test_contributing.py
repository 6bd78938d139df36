"""The four examples of CONTRIBUTING.md train together, in a project outside the package."""

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

PAGE = Path(__file__).parents[1] / "CONTRIBUTING.md"
EXAMPLE = (
    r"`eldenet/(\w+)/mine\.py` and `configs/([\w/]+)/mine\.yaml`:\n\n"
    r"```python\n(.*?)```\n\n```yaml\n(.*?)```"
)


def test_the_backbone_decoder_loss_and_data_set_of_contributing_train_together(tmp_path: Path) -> None:
    examples = re.findall(EXAMPLE, PAGE.read_text(), re.S)
    assert [package for package, *_ in examples] == ["backbones", "decoders", "losses", "data"]
    for package, group, code, config in examples:
        (tmp_path / f"my_{package}.py").write_text(code)
        path = tmp_path / "my_configs" / group / "mine.yaml"
        path.parent.mkdir(parents=True)
        path.write_text(config.replace(f"eldenet.{package}.mine", f"my_{package}"))
    generator = np.random.default_rng(0)
    for split in ("train", "val"):
        for kind, shape, dtype in (("image", (64, 80, 3), np.uint8), ("depth", (64, 80), np.uint16)):
            folder = tmp_path / "frames" / split / kind
            folder.mkdir(parents=True)
            for number in range(4):
                values = generator.integers(1, 256, shape) * (1 if kind == "image" else 20)
                cv2.imwrite(str(folder / f"{number}.png"), values.astype(dtype))
    finished = subprocess.run(
        [
            *(sys.executable, "-m", "eldenet.train", "--config-dir", "my_configs", "debug=fast"),
            *("model/backbone=mine", "model/decoder=mine", "loss=mine", "data=mine", "data.root=frames"),
            *("trainer.batch_size=2", "run_dir=run", "runtime.threads=1"),
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
    assert (tmp_path / "run" / "model" / "model.safetensors").is_file()
