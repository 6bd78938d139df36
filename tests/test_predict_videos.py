"""From a video or a camera to a video, or to a depth file a frame."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from predicting import photo, run, save

from eldenet.config import compose
from eldenet.legend import photo_beside_depth, visible_range
from eldenet.model import DepthNet
from eldenet.predict import predict
from eldenet.predictor import DepthPredictor, to_millimetres


def video(path: Path, frames: int = 5) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 12.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no mp4v")
    for i in range(frames):
        writer.write(np.roll(photo(), 3 * i, axis=1)[..., ::-1].copy())
    writer.release()
    return path


def read_video(path: Path) -> tuple[list[np.ndarray], float]:
    capture, frames = cv2.VideoCapture(str(path)), []
    while True:
        complete, frame = capture.read()
        if not complete:
            return frames, capture.get(cv2.CAP_PROP_FPS)
        frames.append(frame)


def test_a_video_becomes_a_video(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = video(tmp_path / "walk.mp4")
    results = run(model_folder, source, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["walk_depth.mp4"]
    frames, rate = read_video(tmp_path / "out/walk_depth.mp4")
    assert (len(frames), results.images, rate) == (5, 5, 12.0)
    first = cv2.cvtColor(read_video(source)[0][0], cv2.COLOR_BGR2RGB)
    depth = DepthPredictor(model)(first)
    expected = photo_beside_depth(first, depth, *visible_range(depth))
    assert frames[0].shape == expected.shape
    assert np.abs(frames[0][..., ::-1].astype(float) - expected).mean() < 12  # lossy
    with pytest.raises(ValueError, match="there already"):
        run(model_folder, source, tmp_path / "out")


def test_depth_files_of_a_video_when_asked_for(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = video(tmp_path / "walk.mp4", frames=2)
    run(model_folder, source, tmp_path / "out", "formats=[depth,ply]", "intrinsics=[50,50,32,24]")
    names = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*"))
    assert names == [f"walk/00000{i}{end}" for i in range(2) for end in (".ply", "_depth.png")]
    frame = cv2.cvtColor(read_video(source)[0][1], cv2.COLOR_BGR2RGB)
    written = cv2.imread(str(tmp_path / "out/walk/000001_depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(written, to_millimetres(DepthPredictor(model)(frame)))


def exported(model: DepthNet, path: Path) -> Path:
    from eldenet.exporting import describe, write_onnx

    pytest.importorskip("onnxruntime")
    return write_onnx(model, path, (32, 64), batch=1, opset=17, metadata=describe(model, "small", (32, 64)))


def test_an_exported_file_predicts_a_video(model: DepthNet, tmp_path: Path, capsys) -> None:
    source, file = video(tmp_path / "walk.mp4"), exported(model, tmp_path / "small.onnx")
    results = run(file, source, tmp_path / "out", "formats=[depth]", "frames=3", "engine=onnxruntime")
    assert results.images == 3
    said = capsys.readouterr().out
    assert "small.onnx: onnxruntime, fp32, 1 threads" in said
    assert "3 frames of walk.mp4: depth" in said
    frame = cv2.cvtColor(read_video(source)[0][2], cv2.COLOR_BGR2RGB)
    written = cv2.imread(str(tmp_path / "out/walk/000002_depth.png"), cv2.IMREAD_UNCHANGED)
    assert np.abs(written.astype(int) - to_millimetres(DepthPredictor(model)(frame))).max() <= 1
    with pytest.raises(ValueError, match="engine='tvm': give one of auto, torch"):
        run(file, source, tmp_path / "none", "engine=tvm")
    with pytest.raises(ValueError, match=r"sees \[32, 64\] only"):
        run(file, source, tmp_path / "none", "input_size=[64,64]")


def test_a_model_under_another_runtime(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = save(tmp_path / "a.png", photo())
    run(model_folder, source, tmp_path / "out", "formats=[depth]", "engine=torch_channels_last")
    written = cv2.imread(str(tmp_path / "out/a_depth.png"), cv2.IMREAD_UNCHANGED)
    assert np.abs(written.astype(int) - to_millimetres(DepthPredictor(model)(photo()))).max() <= 1


def test_an_address_is_read_as_it_comes(model_folder: Path, tmp_path: Path, capsys) -> None:
    source = video(tmp_path / "walk.mp4")  # an address of a file: read without waiting for the network
    results = predict(
        compose(
            "predict",
            [f"checkpoint='{model_folder}'", f"source='file://{source}'", f"output='{tmp_path / 'out'}'"],
        )
    )
    assert 1 <= results.images <= 5
    said = capsys.readouterr().out
    assert f"of walk.mp4 ({5 - results.images} dropped): colour" in said
    (file,) = (tmp_path / "out").iterdir()
    assert file.name.endswith("walk_mp4_depth.mp4")
    assert len(read_video(file)[0]) == results.images
    with pytest.raises(ValueError, match=r"source=camera:99 cannot be opened"):
        run(model_folder, "camera:99", tmp_path / "none")  # type: ignore[arg-type]
