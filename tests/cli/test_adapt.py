"""``python -m eldenet.adapt`` as a command."""

import cv2
import numpy as np
import pytest

from eldenet.system.files import LOCK, sole_writer


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("poses=o.csv", "give source=<folder of pictures, or video>: poses needs frames of your camera"),
        (
            "poses=o.csv source=images data.root=.",
            "data.root: poses= or a bag makes the frames, from source=",
        ),
        (
            "source=images topic=/camera/image_raw",
            "topic: source= is no bag of ROS or does not exist; only bags have topics",
        ),
        ("source=walk.mcap camera_height=1", "source=walk.mcap does not exist: give a bag of ROS"),
        (
            "camera_height=1 source=images camera_ahead=0.1",
            "camera_ahead: camera_height fits the scale alone",
        ),
        ("data.root=. seed=-1", "seed=-1: give 0 or more"),
        ("data.root=. camera_ahead=0.1", "camera_ahead: give poses= or camera_height=, too"),
    ],
)
def test_settings_of_a_drive_that_do_not_fit_are_refused(run_command, tmp_path, words, said):
    finished = run_command("adapt", *words.split(), "output=run")
    assert finished.returncode == 1
    assert finished.stderr.startswith(f"error: {said}")
