"""From a photo, a folder or a video to depth files that mean what they say."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import eldenet
from eldenet.config import compose
from eldenet.data.io import read_depth
from eldenet.legend import photo_beside_depth, round_numbers, visible_range
from eldenet.model import DepthNet
from eldenet.pointcloud import write_ply
from eldenet.predict import predict
from eldenet.predictions import Results, name_results
from eldenet.predictor import DepthPredictor, to_millimetres

RNG = np.random.default_rng(0)
CAMERA = [50.0, 52.0, 31.0, 22.5]


def photo(height: int = 48, width: int = 64) -> np.ndarray:
    rows, cols = np.mgrid[:height, :width]
    return np.stack([rows * 5 % 256, cols * 4 % 256, (rows + cols) * 2 % 256], -1).astype(np.uint8)


def save(path: Path, picture: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture[..., ::-1])
    return path


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("trained") / "model"
    eldenet.load("eldenet_s").save_pretrained(folder, info={"input_size": [32, 64]})
    return folder


@pytest.fixture(scope="module")
def model(model_folder: Path) -> DepthNet:
    return eldenet.load(model_folder)


def run(model_folder: Path, source: Path, output: Path, *overrides: str) -> Results:
    quoted = [f"checkpoint='{model_folder}'", f"source='{source}'", f"output='{output}'"]
    return predict(compose("predict", [*quoted, "runtime.threads=1", "runtime.workers=0", *overrides]))


def read_ply(path: Path) -> np.ndarray:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    vertices = np.frombuffer(body, np.dtype([(name, kinds[kind]) for kind, name in fields]))
    assert f"element vertex {len(vertices)}" in lines
    return vertices


# --- the predictor ------------------------------------------------------------------------------------------


def test_predictor_sees_the_training_size_and_answers_in_the_frames(model: DepthNet) -> None:
    seen = []
    hook = model.register_forward_pre_hook(lambda _, inputs: seen.append(tuple(inputs[0].shape)))
    predictor = DepthPredictor(model)
    depth = predictor(photo(50, 90))
    hook.remove()
    assert seen == [(1, 3, 32, 64)]
    assert (depth.shape, depth.dtype) == ((50, 90), np.float32)
    assert model.head.min_depth <= depth.min() <= depth.max() <= model.head.max_depth
    np.testing.assert_array_equal(depth, predictor(photo(50, 90)))


def test_predictor_is_the_network_with_a_resize_around_it(model: DepthNet) -> None:
    frame = photo()
    small = cv2.resize(frame, (32, 24), interpolation=cv2.INTER_AREA)
    with torch.inference_mode():
        depth = model(torch.from_numpy(small).permute(2, 0, 1)[None].float() / 255)
        large = torch.nn.functional.interpolate(depth, size=(48, 64), mode="bilinear", align_corners=False)
    np.testing.assert_allclose(DepthPredictor(model, (24, 32))(frame), large[0, 0], rtol=1e-6)


def test_predictor_of_an_unknown_training_size_bounds_the_longer_side() -> None:
    predictor = DepthPredictor(eldenet.load("eldenet_s"), max_side=100)
    assert predictor.size_for(50, 80) == (50, 80)
    assert predictor.size_for(300, 200) == (100, 67)
    assert predictor.size_for(10_000, 1) == (100, 1)


@pytest.mark.parametrize("frame", [photo()[..., 0], photo().astype(np.float32), photo()[:0]])
def test_predictor_refuses_what_is_no_frame(model: DepthNet, frame: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"\(H, W, 3\) uint8 RGB is needed"):
        DepthPredictor(model)(frame)


def test_predictor_refuses_sizes_and_depth_that_are_none(model: DepthNet) -> None:
    with pytest.raises(ValueError, match="input_size"):
        DepthPredictor(model, (0, 32))
    with pytest.raises(ValueError, match="max_side"):
        DepthPredictor(model, max_side=0)

    class Broken(torch.nn.Module):
        info: dict = {}  # noqa: RUF012

        def forward(self, image: torch.Tensor) -> torch.Tensor:
            return image[:, :1] * math.nan

    with pytest.raises(ValueError, match="not finite"):
        DepthPredictor(Broken())(photo())  # type: ignore[arg-type]


# --- what is written ----------------------------------------------------------------------------------------


def test_millimetres() -> None:
    depth = np.array([[0.0, 1.2344, 1.2346, 65.5351, 65.536, 200.0, np.nan, np.inf, -1.0]], np.float32)
    np.testing.assert_array_equal(to_millimetres(depth), [[0, 1234, 1235, 65535, 0, 0, 0, 0, 0]])


def test_point_cloud_leaves_out_what_is_unknown(tmp_path: Path) -> None:
    points = np.array([[0, 0, 1], [0, 0, 0], [1, np.nan, 2], [3, 4, 5]], np.float64)
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    assert write_ply(tmp_path / "a/b.ply", points, colours) == 2
    vertices = read_ply(tmp_path / "a/b.ply")
    assert vertices["z"].tolist() == [1, 5]
    assert vertices["blue"].tolist() == [2, 11]
    with pytest.raises(ValueError, match="one shape"):
        write_ply(tmp_path / "c.ply", points, colours[:2])


def test_scale_in_metres() -> None:
    for near, far in ((0, 1), (0.7, 9.9), (1.2, 1.25), (3, 80), (0.5, 120)):
        numbers = round_numbers(near, far)
        assert 3 <= len(numbers) <= 8
        assert near - 1e-6 <= numbers[0] < numbers[-1] <= far + 1e-6
        np.testing.assert_allclose(np.diff(numbers), numbers[1] - numbers[0], rtol=1e-4)
    depth = np.full((48, 65), 2.0, np.float32)
    depth[:, :20] = 0
    assert visible_range(depth) == (2.0, 2.05)
    assert visible_range(np.zeros((3, 3))) == (0.0, 1.0)
    picture = photo_beside_depth(photo(48, 65), depth, 0.5, 120.0)
    np.testing.assert_array_equal(picture[:240:5, : 65 * 5 : 5], photo(48, 65))
    assert not picture[100, 65 * 5 + 4 + 50].any()  # unknown is black
    widths = {photo_beside_depth(photo(), depth[:, :64], 0.0, far).shape for far in (0.07, 1, 9.9, 12, 150)}
    assert len(widths) == 1  # a video's frames have one size
    assert not any(length % 2 for length in widths.pop()[:2])


def test_one_picture(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = save(tmp_path / "in/kitchen.png", photo())
    camera = "intrinsics=[" + ",".join(map(str, CAMERA)) + "]"
    results = run(model_folder, source, tmp_path / "out", camera)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        *("kitchen.ply", "kitchen_colour.png", "kitchen_depth.png")
    ]
    assert (results.images, results.skipped, results.too_far) == (1, [], 0)
    depth = DepthPredictor(model)(photo())
    written = cv2.imread(str(tmp_path / "out/kitchen_depth.png"), cv2.IMREAD_UNCHANGED)
    assert written.dtype == np.uint16
    np.testing.assert_array_equal(written, np.rint(depth.astype(np.float64) * 1000))
    np.testing.assert_allclose(read_depth(tmp_path / "out/kitchen_depth.png", "mm"), depth, atol=5.1e-4)
    colour = cv2.imread(str(tmp_path / "out/kitchen_colour.png"))
    assert colour.shape[0] == 240
    assert colour.shape[1] > 2 * 64 * 5
    # every pixel is a point, of its own colour, that projects back to it: the network saw 32 x 64, though
    vertices = read_ply(tmp_path / "out/kitchen.ply")
    assert len(vertices) == 48 * 64
    fx, fy, cx, cy = CAMERA
    rows, cols = np.mgrid[:48, :64]
    np.testing.assert_allclose(vertices["x"] / vertices["z"] * fx + cx, cols.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["y"] / vertices["z"] * fy + cy, rows.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["z"], depth.ravel(), rtol=1e-6)
    rgb = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    np.testing.assert_array_equal(rgb.reshape(48, 64, 3), photo())


def test_what_makes_depth_doubtful_is_said(
    model: DepthNet, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    source = save(tmp_path / "a.png", photo())
    model.save_pretrained(tmp_path / "model", info={})
    run(tmp_path / "model", source, tmp_path / "unknown", "formats=depth")
    assert "does not say at which size it was trained" in capsys.readouterr().out
    run(tmp_path / "model", source, tmp_path / "given", "formats=depth", "input_size=[32,64]")
    assert "note:" not in capsys.readouterr().out
    predict(compose("predict", ["checkpoint=eldenet_s", f"source={source}", f"output={tmp_path / 'new'}"]))
    assert "freshly initialised" in capsys.readouterr().out


def test_a_photo_is_turned_as_its_exif_says(model_folder: Path, tmp_path: Path) -> None:
    source = save(tmp_path / "in/turned.jpg", photo())
    content = source.read_bytes()
    tiff = b"II*\0\x08\0\0\0\x01\0" + b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0" + b"\0\0\0\0"  # Orientation = 6
    exif = b"Exif\0\0" + tiff
    source.write_bytes(content[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + content[2:])
    run(model_folder, source, tmp_path / "out", "formats=depth")
    assert cv2.imread(str(tmp_path / "out/turned_depth.png"), cv2.IMREAD_UNCHANGED).shape == (64, 48)


def test_a_folder_keeps_pictures_of_one_name_apart(model_folder: Path, tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg", "one/a.png", "two/deep/a.png", "two/b.JPG", ".hidden/x.png"):
        save(tmp_path / "in" / name, photo(20, 30))
    (tmp_path / "in/notes.txt").write_text("no picture")
    output = tmp_path / "in/results"  # inside the source: not read again
    results = run(model_folder, tmp_path / "in", output, "formats=[depth]")
    expected = ["a_jpg", "a_png", "one/a", "two/b", "two/deep/a"]
    files = sorted(path.relative_to(output).as_posix() for path in output.rglob("*.png"))
    assert files == [f"{name}_depth.png" for name in expected]
    assert results.images == 5
    assert sorted(name_results(tmp_path / "in", output).values()) == expected
    with pytest.raises(ValueError, match=r"5 results are there already .*overwrite=true"):
        run(model_folder, tmp_path / "in", output, "formats=[depth]")
    assert run(model_folder, tmp_path / "in", output, "formats=[depth]", "overwrite=true").images == 5


def test_a_source_is_never_overwritten(model_folder: Path, tmp_path: Path) -> None:
    for name in ("a.png", "a_depth.png"):
        save(tmp_path / name, photo())
    with pytest.raises(ValueError, match=r"a_depth\.png is a source"):
        run(model_folder, tmp_path, tmp_path, "formats=[depth]", "overwrite=true")


def test_names_that_differ_too_little(tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg", "a_jpg.png"):
        save(tmp_path / name, photo())
    with pytest.raises(ValueError, match="differ too little"):
        name_results(tmp_path, tmp_path / "out")


def test_a_bad_picture_stops_or_is_listed(
    model_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    save(tmp_path / "in/a.png", photo())
    bad = save(tmp_path / "in/b.png", photo())
    bad.write_bytes(bad.read_bytes()[:200])
    with pytest.raises(ValueError, match=r"b\.png is cut or damaged"):
        run(model_folder, tmp_path / "in", tmp_path / "strict")
    results = run(model_folder, tmp_path / "in", tmp_path / "out", "on_error=skip")
    assert results.images == 1
    assert len(results.skipped) == 1
    said = capsys.readouterr().out
    assert "1 picture: depth + colour in" in said
    assert "images/s" in said
    assert "skipped 1:\n" in said
    assert "b.png is cut" in said
    (tmp_path / "in/a.png").unlink()
    with pytest.raises(ValueError, match="none of 1 pictures could be read"):
        run(model_folder, tmp_path / "in", tmp_path / "none", "on_error=skip")


@pytest.mark.parametrize("share", [0.3, 0.9, 0.99])
@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_a_cut_picture_is_named(model_folder: Path, tmp_path: Path, ending: str, share: float) -> None:
    path = save(tmp_path / f"cut{ending}", RNG.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(ValueError, match=f"cut{ending} is cut or damaged"):
        run(model_folder, path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["intrinsics=[500,500,320]"], r"intrinsics=\[500, 500, 320\]: give \[fx, fy, cx, cy\]"),
        (["intrinsics=[500,500,320,x]"], "4 numbers"),
        (["intrinsics=[0,500,320,240]"], "focal lengths above 0"),
        (["intrinsics=5"], "4 numbers"),
        (["formats=[ply]"], "needs intrinsics"),
        (["formats=[depth]", "intrinsics=[500,500,320,240]"], "add ply"),
        (["formats=[jpeg]"], "depth, colour, ply"),
        (["formats=[]"], "formats is empty"),
        (["on_error=ignore"], "stop, skip"),
        (["depth_range=[5,1]"], "near < far"),
        (["input_size=[32]"], "input_size"),
        (["checkpoint=nothing/of/this/name"], "neither a folder here"),
    ],
)
def test_wrong_settings(model_folder: Path, tmp_path: Path, overrides: list[str], message: str) -> None:
    source = save(tmp_path / "a.png", photo())
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        run(model_folder, source, tmp_path / "out", *overrides)
    assert not (tmp_path / "out").exists()


def test_wrong_sources(model_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.png").write_text("no picture at all")
    (tmp_path / "text.mp4").write_text("no video at all")
    for source, message in (
        ("nothing.jpg", "does not exist"),
        ("empty", "holds no pictures"),
        ("text.png", r"text\.png is no JPEG"),
        ("text.mp4", r"text\.mp4 holds no frame"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            run(model_folder, tmp_path / source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_camera_is_of_one_size(model_folder: Path, tmp_path: Path) -> None:
    save(tmp_path / "in/a.png", photo())
    save(tmp_path / "in/b.png", photo(40, 30))
    assert run(model_folder, tmp_path / "in", tmp_path / "other").images == 2
    with pytest.raises(ValueError, match=r"b is 40 x 30, the pictures before it 48 x 64"):
        run(model_folder, tmp_path / "in", tmp_path / "out", "intrinsics=[50,50,32,24]")


def test_depth_beyond_16_bits_is_unknown_and_said(model: DepthNet, tmp_path: Path) -> None:
    results = Results(tmp_path, ("depth",))
    depth = np.full((4, 5), 2.5, np.float32)
    depth[0] = 70.0
    results.write("far", photo(4, 5), depth, results.formats)
    assert results.too_far == 5
    written = cv2.imread(str(tmp_path / "far_depth.png"), cv2.IMREAD_UNCHANGED)
    assert written[0].tolist() == [0] * 5
    assert (written[1:] == 2500).all()


# --- video --------------------------------------------------------------------------------------------------


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


# --- the command --------------------------------------------------------------------------------------------


def test_command(model_folder: Path, tmp_path: Path, run_command) -> None:
    save(tmp_path / "in/a.png", photo())
    done = run_command("predict", f"checkpoint={model_folder.parent}", "source=in", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (output,) = (tmp_path / "runs").glob("predict-*")
    assert sorted(path.name for path in output.iterdir()) == ["a_colour.png", "a_depth.png"]
    assert f"1 picture: depth + colour in runs/{output.name}" in done.stdout
    failed = run_command("predict", f"checkpoint={model_folder}", "source=nothing.jpg", cwd=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr == (
        "error: source=nothing.jpg does not exist: give a picture, a folder or a video\n"
    )
    assert len(list((tmp_path / "runs").iterdir())) == 1
