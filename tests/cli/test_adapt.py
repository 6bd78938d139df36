"""``python -m eldenet.adapt`` as a command."""

import cv2
import numpy as np
import pytest

from eldenet.system.files import LOCK, sole_writer


@pytest.mark.parametrize("kind", ["depth frames", "camera height"])
def test_a_second_adapt_in_one_folder_is_refused(run_command, tmp_path, kind):
    for part, dtype in (("images", np.uint8), ("depths", np.uint16)):
        (tmp_path / part).mkdir()
        for number in range(4):
            cv2.imwrite(str(tmp_path / part / f"{number}.png"), np.full((24, 32), 200, dtype))
    given = ["data.root=."]
    if kind == "camera height":
        given = ["source=images", "camera_height=0.8", "intrinsics=[30,30,15.5,11.5]"]
    with sole_writer(tmp_path / "run"):
        finished = run_command("adapt", *given, "output=run")
        assert finished.returncode == 1
        assert finished.stderr.startswith(f"error: {tmp_path}/run is in use by process ")
        assert [path.name for path in (tmp_path / "run").iterdir()] == [LOCK]
