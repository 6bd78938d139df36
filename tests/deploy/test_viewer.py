"""``predict viewer=rerun``: the recording holds what was predicted, where and when."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support.predicting import photo, run, save

import eldenet
from eldenet.boxes import Boxes3D
from eldenet.data.io import read_depth
from eldenet.deploy import viewer
from eldenet.deploy.video_files import open_video
from eldenet.deploy.viewer import open_recording
from eldenet.geometry import PinholeCamera, back_project, pinhole
from eldenet.uncertainty import DepthEstimate

CAMERA = [50.0, 52.0, 31.0, 22.5]
LENS = PinholeCamera(pinhole(*CAMERA))
WITH_CAMERA = "intrinsics=[50,52,31,22.5]"
DEPTH = np.linspace(0.5, 8.0, 48 * 64, dtype=np.float32).reshape(48, 64)


def recorded(path: Path) -> dict[str, list[dict]]:
    """Entity -> its rows, as columns named without the entity."""
    reader = pytest.importorskip("rerun.chunk", reason="pip install -e '.[viewer]'").RrdReader(path)
    import pyarrow

    found: dict[str, list[dict]] = {}
    for chunk in reader.stream():
        table = chunk.to_record_batch()
        if "time" in table.schema.names:  # from nanoseconds
            seconds = table["time"].cast("int64").to_numpy() / 1e9
            table = table.set_column(table.schema.get_field_index("time"), "time", pyarrow.array(seconds))
        wall_clock = [name for name in table.schema.names if name.startswith("log_") or "start_time" in name]
        for row in table.drop_columns(wall_clock).to_pylist():
            rows = found.setdefault(chunk.entity_path, [])
            rows.append({key.split(":")[-1]: value for key, value in row.items()})
    return found


def rows_with(found: dict[str, list[dict]], entity: str, column: str) -> list[dict]:
    return [row for row in found[entity] if row.get(column)]


def depth_of(row: dict) -> np.ndarray:
    return np.frombuffer(np.array(row["buffer"][0], np.uint8).tobytes(), np.float16).reshape(48, 64)


def test_pictures_depth_and_points_are_recorded_in_order(model_folder, tmp_path) -> None:
    for name in "ab":
        save(tmp_path / f"in/{name}.png", photo() if name == "a" else photo()[::-1])
    run(model_folder, tmp_path / "in", tmp_path / "out", WITH_CAMERA, "viewer=rerun")
    found = recorded(tmp_path / "out/predict.rrd")
    assert [row["text"] for row in found["/name"]] == [["a"], ["b"]]
    assert [row["picture"] for row in found["/world/camera/image"]] == [0, 1]
    assert [row["picture"] for row in found["/world/points"]] == [0, 1]
    for row, name in zip(found["/world/camera/depth"], "ab", strict=True):
        stored = read_depth(tmp_path / f"out/{name}_depth.png", "mm")
        np.testing.assert_allclose(depth_of(row), stored, rtol=2e-3, atol=1e-3)
        assert row["meter"] == [1.0]
    lens = rows_with(found, "/world/camera", "image_from_camera")[0]
    assert pytest.approx(pinhole(*CAMERA)) == np.reshape(lens["image_from_camera"], (3, 3)).T
    assert lens["resolution"] == [[64, 48]]


def test_points_lie_where_they_are_and_have_the_pictures_colors(tmp_path) -> None:
    pytest.importorskip("rerun", reason="pip install -e '.[viewer]'")
    with open_recording(tmp_path / "a.rrd", points=True) as view:
        view.show("a", photo(), np.where(DEPTH > 7, np.inf, DEPTH), camera=LENS)
    (row,) = recorded(tmp_path / "a.rrd")["/world/points"]
    seen = DEPTH <= 7
    assert row["positions"] == pytest.approx(back_project(DEPTH, pinhole(*CAMERA))[seen], abs=1e-4)
    colors = np.array(row["colors"], np.uint32)
    assert (np.stack([colors >> 24, colors >> 16 & 255, colors >> 8 & 255], -1) == photo()[seen]).all()


def test_large_clouds_are_thinned_and_unsure_points_left_out(tmp_path, monkeypatch) -> None:
    pytest.importorskip("rerun", reason="pip install -e '.[viewer]'")
    monkeypatch.setattr(viewer, "MOST_POINTS", 800)
    sigma = np.where(np.arange(64) < 32, 0.5, 0.01) * DEPTH
    with open_recording(tmp_path / "a.rrd", points=True) as view:
        view.show("a", photo(), DepthEstimate(DEPTH, sigma, "laplace"), camera=LENS)
    found = recorded(tmp_path / "a.rrd")
    assert len(found["/world/points"][0]["positions"]) == 48 * 64 / 4 / 2
    assert depth_of(found["/world/camera/sigma"][0]) == pytest.approx(sigma, rel=1e-3)


def test_boxes_have_size_turn_and_a_label(tmp_path) -> None:
    pytest.importorskip("rerun", reason="pip install -e '.[viewer]'")
    box = Boxes3D(
        np.array([[3.0, 0.5, 4.0]]), np.array([[4.2, 1.8, 1.5]]), np.array([0.3]), np.array([0.9]),
        np.array([0]), ("car",), track_id=np.array([7]),
    )  # fmt: skip
    with open_recording(tmp_path / "a.rrd", points=True) as view:
        view.show("a", photo(), DEPTH)
        view.show_boxes(box)
    (row,) = recorded(tmp_path / "a.rrd")["/world/boxes"]
    assert row["labels"] == ["car 5.0 m #7"]
    assert row["half_sizes"][0] == pytest.approx([2.1, 0.75, 0.9])  # length along x, height along y
    assert row["centers"][0] == pytest.approx([3.0, 0.5, 4.0])


def test_a_film_is_recorded_over_its_time_and_without_a_lens_has_no_points(model_folder, tmp_path) -> None:
    with open_video(tmp_path / "walk.mp4", 10.0) as add:
        for _ in range(4):
            add(photo())
    run(model_folder, tmp_path / "walk.mp4", tmp_path / "out", "viewer=rerun")
    found = recorded(tmp_path / "out/predict.rrd")
    times = [row["time"] for row in found["/world/camera/depth"]]
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert "/world/points" not in found


def test_an_error_keeps_the_pictures_before_it_and_nothing_leaves_no_file(tmp_path) -> None:
    pytest.importorskip("rerun", reason="pip install -e '.[viewer]'")

    def fail() -> None:
        with open_recording(tmp_path / "a.rrd", points=False) as view:
            view.show("a", photo(), DEPTH)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert recorded(tmp_path / "a.rrd")["/name"][0]["text"] == ["a"]
    with open_recording(tmp_path / "b.rrd", points=False):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]


def test_an_older_recording_is_not_replaced_and_a_missing_sdk_ends_in_one_line(
    model_folder, tmp_path, monkeypatch
) -> None:
    picture = save(tmp_path / "a.png", photo())
    (tmp_path / "out").mkdir()
    (tmp_path / "out/predict.rrd").write_bytes(b"mine")
    with pytest.raises(ValueError, match=r"predict\.rrd.*overwrite=true"):
        run(model_folder, picture, tmp_path / "out", "viewer=rerun")
    with pytest.raises(ValueError, match="viewer='vlc': give one of rerun"):
        run(model_folder, picture, tmp_path / "new", "viewer=vlc")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match="viewer=rerun needs rerun: pip install -e"):
        run(model_folder, picture, tmp_path / "new", "viewer=rerun")


def test_the_network_says_how_far_it_can_answer(model) -> None:
    assert eldenet.DepthPredictor(model).max_depth == model.head.max_depth
