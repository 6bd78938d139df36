"""A video or a camera becomes a video, or one depth file per frame."""

import resource
import signal
import socket
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import bags
from support.films import read_video, write_video
from support.predicting import exported, listed, photo, run, save

from eldenet.deploy import runtimes
from eldenet.deploy.outputs import to_millimeters
from eldenet.deploy.predictor import DepthPredictor
from eldenet.deploy.stream import DepthStream, StreamFrame
from eldenet.deploy.video_files import in_time, open_video
from eldenet.geometry import pinhole
from eldenet.model import DepthNet
from eldenet.results.run_log import RunLog
from eldenet.visualization import photo_beside_depth, visible_range


def test_a_video_becomes_a_video(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = write_video(tmp_path / "walk.mp4")
    results = run(model_folder, source, tmp_path / "out")
    assert listed(tmp_path / "out") == ["walk_depth.mp4"]
    frames, rate = read_video(tmp_path / "out/walk_depth.mp4")
    assert (len(frames), results.images, rate) == (5, 5, 12.0)
    first = cv2.cvtColor(read_video(source)[0][0], cv2.COLOR_BGR2RGB)
    depth = DepthPredictor(model)(first)
    expected = photo_beside_depth(first, depth, *visible_range(depth))
    assert frames[0].shape == expected.shape
    assert np.abs(frames[0][..., ::-1].astype(float) - expected).mean() < 12  # lossy
    with pytest.raises(ValueError, match="already exist"):
        run(model_folder, source, tmp_path / "out")


def test_other_formats_are_one_file_per_frame(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = write_video(tmp_path / "walk.mp4", frames=2)
    run(
        model_folder,
        source,
        tmp_path / "out",
        "formats=[depth,ply]",
        "fov=66",
        "steady=false",
    )
    assert listed(tmp_path / "out") == ["walk"]
    assert listed(tmp_path / "out/walk") == [
        f"00000{i}{end}" for i in range(2) for end in (".ply", "_depth.png")
    ]
    frame = cv2.cvtColor(read_video(source)[0][1], cv2.COLOR_BGR2RGB)
    written = cv2.imread(str(tmp_path / "out/walk/000001_depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(written, to_millimeters(DepthPredictor(model)(frame)))


def test_an_exported_file_predicts_a_video(model: DepthNet, tmp_path: Path, capsys) -> None:
    source, file = write_video(tmp_path / "walk.mp4"), exported(model, tmp_path / "small.onnx")
    results = run(
        file, source, tmp_path / "out", "formats=[depth]", "frames=3", "engine=onnxruntime", "steady=false"
    )
    assert results.images == 3
    said = capsys.readouterr().out
    assert "small.onnx: onnxruntime, fp32, 1 threads" in said
    assert "3 frames of walk.mp4: depth" in said
    frame = cv2.cvtColor(read_video(source)[0][2], cv2.COLOR_BGR2RGB)
    written = cv2.imread(str(tmp_path / "out/walk/000002_depth.png"), cv2.IMREAD_UNCHANGED)
    network = runtimes.load(file, "onnxruntime", threads=1)
    assert np.abs(written.astype(int) - to_millimeters(DepthPredictor(network)(frame))).max() <= 1
    with pytest.raises(ValueError, match=r"only takes \[32, 64\]"):
        run(file, source, tmp_path / "none", "input_size=[64,64]")


def test_an_address_is_read_live(model_folder: Path, tmp_path: Path, capsys) -> None:
    source = write_video(tmp_path / "walk.mp4")  # read without waiting for the network
    results = run(model_folder, f"file://{source}", tmp_path / "out")
    assert 1 <= results.images <= 5
    said = capsys.readouterr().out
    assert f"of walk.mp4 ({5 - results.images} dropped): color" in said
    assert "stopped after" not in said  #  it announces its five frames
    (name,) = listed(tmp_path / "out")
    assert name.endswith("walk_mp4_depth.mp4")
    assert read_video(tmp_path / "out" / name)[1] == 12.0
    with pytest.raises(FileNotFoundError, match=r"source=camera:99: there is no /dev/video99"):
        run(model_folder, "camera:99", tmp_path / "none")


class SlowCamera(DepthStream):
    """A camera of 10 frames a second that had time for three frames: at 0, 0.5 and 0.7 s."""

    def __init__(self, source, predictor, **options: object) -> None:
        self.predictor, self.drop = predictor, True
        self.dropped, self.announced, self.frames_per_second = 5, 0, 10.0
        self.ended_too_soon = "stopped after 8 frames"
        self._times = [0.0]

    def __iter__(self):
        for number in (0, 5, 7):
            frame = np.roll(photo(), 3 * number, axis=1)
            yield StreamFrame(number, frame, self.predictor(frame), 77.0 + number / 10)

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_the_video_of_a_camera_plays_in_real_time(
    model_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("eldenet.deploy.prediction.DepthStream", SlowCamera)
    with pytest.raises(OSError, match=r"rtsp://host/street stopped after 8 frames; earlier results"):
        run(model_folder, "rtsp://me:se@cret@host/street", tmp_path / "out", "depth_range=[0.1,10]")
    assert listed(tmp_path / "out") == ["rtsp_host_street_depth.mp4"]
    frames, rate = read_video(tmp_path / "out/rtsp_host_street_depth.mp4")
    assert (len(frames), rate) == (8, 10.0)  # 0.7 s, and the last frame
    steps = [np.abs(b.astype(float) - a).mean() for a, b in pairwise(frames)]
    assert sorted(np.argsort(steps)[-2:] + 1) == [5, 7]  # where the picture changes
    said = capsys.readouterr().out
    assert "3 frames of street (5 dropped)" in said
    assert "cret" not in said
    assert run(model_folder, "rtsp://host/street", tmp_path / "three", "frames=3").images == 3


def test_the_remaining_time_is_shown_only_where_it_is_known(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("eldenet.system.progress.LINE_EVERY_S", 0.0)
    for total in (0, 1, 3):  # a camera; a video of two frames that announces one; one that goes on
        with RunLog(tmp_path).bar("predicting", total) as bar:
            bar.advance(1)
            bar.advance(1)
    camera, short, long = capsys.readouterr().out.splitlines()[1::2]
    assert camera.startswith("predicting: 2  ")
    assert short.startswith("predicting: 2/1  ")
    assert long.startswith("predicting: 2/3  ")
    assert [" s left" in line for line in (camera, short, long)] == [False, False, True]


def video_of(path: Path, pictures: list[np.ndarray], error: BaseException | None = None) -> None:
    with open_video(path, 10.0) as add:
        for picture in pictures:
            add(picture)
        if error is not None:
            raise error


def test_an_error_keeps_the_video_up_to_it(tmp_path: Path) -> None:
    gray = [np.full((48, 64, 3), 40 * number, np.uint8) for number in range(4)]
    with pytest.raises(OSError, match="unplugged"):
        video_of(tmp_path / "a.mp4", gray, OSError("unplugged"))
    video_of(tmp_path / "b.mp4", [*gray[:3], np.zeros((50, 64, 3), np.uint8)])  # of another size
    with pytest.raises(KeyboardInterrupt):
        video_of(tmp_path / "c.mp4", gray, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        video_of(tmp_path / "d.mp4", [], KeyboardInterrupt())
    names = ["a.mp4", "b.mp4", "c.mp4"]
    assert [len(read_video(tmp_path / name)[0]) for name in names] == [4, 4, 4]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_video_wider_than_its_format_allows_is_made_smaller(tmp_path: Path) -> None:
    """A frame of 4K and its depth side by side are 8626 pixels wide."""
    picture = np.zeros((200, 8626, 3), np.uint8)
    picture[:, 4313:] = 200
    video_of(tmp_path / "a.mp4", [picture] * 2)
    frames = read_video(tmp_path / "a.mp4")[0]
    assert [frame.shape for frame in frames] == [(190, 8190, 3)] * 2
    assert frames[1][:, 4110:].mean() - frames[1][:, :4080].mean() > 180


def test_a_full_disk_is_an_error_and_leaves_no_file(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (20, 96, 128, 3), np.uint8)
    limits, ignored = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
        with pytest.raises(OSError, match="File too large"):
            video_of(tmp_path / "a.mp4", list(noise))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert not list(tmp_path.iterdir())


def test_a_video_is_as_long_as_what_it_shows() -> None:
    def film(*taken: float, rate: float = 10.0) -> list[float]:
        shown: list[np.ndarray] = []
        show = in_time(shown.append, rate)
        for one in taken:
            show(np.array(one), one)
        return [float(picture) for picture in shown]

    assert film(*(number / 12 for number in range(9)), rate=12.0) == [number / 12 for number in range(9)]
    assert film(5.0, 5.3, 5.4) == [5.0, 5.0, 5.0, 5.3, 5.4]
    assert film(5.0, 5.01, 5.02, 5.2) == [5.0, 5.02, 5.2]  # faster than the film


def test_an_address_that_cannot_be_opened_is_named_without_its_password() -> None:
    with pytest.raises(ValueError, match=r"source=file:///nowhere cannot be opened") as error:
        DepthStream("file://me:secret@/nowhere", lambda frame: frame)
    assert "secret" not in str(error.value)


def test_an_address_that_never_answers_ends_in_the_timeout() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        start = time.monotonic()
        with pytest.raises(ValueError, match=rf"source=rtsp://{address}/a did not answer within 1 s"):
            DepthStream(f"rtsp://{address}/a", lambda frame: frame, timeout=1.0)
        assert time.monotonic() - start < 5


def bag_of(folder: Path, frames: list[np.ndarray], times: list[float], focal: float = 60.0) -> Path:
    sent = [bags.lens(times[0], pinhole(focal, focal, 31.5, 23.5), (48, 64))]
    return bags.write_bag(folder, [*sent, *map(bags.picture, times, frames)])


def test_a_bag_is_a_video_whose_lens_is_known(model_folder: Path, tmp_path: Path) -> None:
    frames = [np.roll(photo(), 9 * number, 1) for number in range(3)]
    bag = bag_of(tmp_path, frames, [1.7e9, 1.7e9 + 0.5, 1.8e9])  # the clock was set
    options = ["formats=[color,depth,ply]", "steady=false"]
    results = run(model_folder, bag, tmp_path / "bag", *options)
    assert results.images == 3
    for number, frame in enumerate(frames):
        save(tmp_path / f"photos/{number:06d}.png", frame)
    alone = [*options, "sharp=false", "intrinsics=[60,60,31.5,23.5]"]
    run(model_folder, tmp_path / "photos", tmp_path / "each", *alone)
    for name in ("000000_depth.png", "000002_depth.png", "000001.ply"):
        assert (tmp_path / "bag/walk" / name).read_bytes() == (tmp_path / "each" / name).read_bytes()
    assert len(read_video(tmp_path / "bag/walk_depth.mp4")[0]) == 17  # 30 a second


def test_the_lens_of_a_bag_is_said_to_be_its_own(tmp_path: Path, capsys) -> None:
    bag = bag_of(tmp_path, [photo()], [1.7e9])
    run("eldenet_indoor", bag, tmp_path / "own", "formats=[color]")
    assert "camera: fx 60 px (from CameraInfo), pictures 64 px wide" in capsys.readouterr().out
    run("eldenet_indoor", bag, tmp_path / "given", "formats=[color]", "intrinsics=[50,50,31.5,23.5]")
    assert "camera: fx 50 px (given), pictures 64 px wide" in capsys.readouterr().out


def test_a_bag_takes_a_topic_and_no_second_lens(model_folder: Path, tmp_path: Path) -> None:
    bag = bag_of(tmp_path, [photo()], [1.7e9])
    with pytest.raises(ValueError, match=r"in /camera/image_raw, not /rear: give topic= one of them"):
        run(model_folder, bag, tmp_path / "out", "topic=/rear")
    with pytest.raises(ValueError, match=r"fov: the CameraInfo of a bag says the lens; intrinsics= replaces"):
        run(model_folder, bag, tmp_path / "out", "fov=60")


def test_a_bag_of_a_camera_that_nobody_calibrated_asks_for_its_lens(tmp_path: Path, capsys) -> None:
    bag = bag_of(tmp_path, [photo()], [1.7e9], focal=0.0)
    with pytest.raises(ValueError, match=r"needs a CameraInfo of a calibrated camera .*: give intr"):
        run("eldenet_indoor", bag, tmp_path / "out")
    run("eldenet_indoor", bag, tmp_path / "out", "formats=[color]", "fov=60")
    assert "camera: fx 55 px (given), pictures 64 px wide" in capsys.readouterr().out
