"""Photos and folders become depth files that mean what they say."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.detector_files import FILES
from support.detector_files import save as save_detector
from support.networks import canonical_net, light_net, rounding_down_net
from support.predicting import exported, listed, photo, read_ply, run, save, settings, turned_by_exif

import eldenet
from eldenet.data.io import read_depth
from eldenet.deploy import outputs
from eldenet.deploy.outputs import name_results
from eldenet.deploy.prediction import Source, find_source
from eldenet.deploy.predictor import DepthPredictor
from eldenet.model import DepthNet
from eldenet.predict import open_predictor, open_results
from eldenet.results.run_log import RunLog
from eldenet.system.resources import Resources, choose_resources
from eldenet.weights import BEST

RNG = np.random.default_rng(0)
CAMERA = [50.0, 52.0, 31.0, 22.5]


def test_pictures_are_sharpened_unless_told_otherwise(
    model_folder: Path, model: DepthNet, tmp_path: Path
) -> None:
    source = save(tmp_path / "in/kitchen.png", photo())
    for words, sharp in (([], True), (["sharp=false"], False)):
        run(model_folder, source, tmp_path / f"out{sharp}", *words)
        depth = DepthPredictor(model, sharp=sharp)(photo())
        written = read_depth(tmp_path / f"out{sharp}/kitchen_depth.png", "mm")
        np.testing.assert_allclose(written, depth, atol=5.1e-4)


def test_a_picture_becomes_depth_colors_and_points(
    model_folder: Path, model: DepthNet, tmp_path: Path
) -> None:
    source = save(tmp_path / "in/kitchen.png", photo())
    camera = "intrinsics=[" + ",".join(map(str, CAMERA)) + "]"
    results = run(model_folder, source, tmp_path / "out", camera)
    assert listed(tmp_path / "out") == ["kitchen.ply", "kitchen_color.png", "kitchen_depth.png"]
    assert (results.images, results.skipped, results.too_far) == (1, [], 0)
    depth = DepthPredictor(model, sharp=True)(photo())
    written = cv2.imread(str(tmp_path / "out/kitchen_depth.png"), cv2.IMREAD_UNCHANGED)
    assert written.dtype == np.uint16
    np.testing.assert_array_equal(written, np.rint(depth.astype(np.float64) * 1000))
    np.testing.assert_allclose(read_depth(tmp_path / "out/kitchen_depth.png", "mm"), depth, atol=5.1e-4)
    color = cv2.imread(str(tmp_path / "out/kitchen_color.png"))
    assert 240 < color.shape[0] < 280  # with titles
    assert color.shape[1] > 2 * 64 * 5
    # every pixel is a point of its color that projects back to it, although the network saw 32 x 64
    vertices = read_ply(tmp_path / "out/kitchen.ply")
    assert len(vertices) == 48 * 64
    fx, fy, cx, cy = CAMERA
    rows, cols = np.mgrid[:48, :64]
    np.testing.assert_allclose(vertices["x"] / vertices["z"] * fx + cx, cols.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["y"] / vertices["z"] * fy + cy, rows.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["z"], depth.ravel(), rtol=1e-6)
    rgb = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    np.testing.assert_array_equal(rgb.reshape(48, 64, 3), photo())


@pytest.mark.parametrize("size", [(48, 64), (64, 36)])
def test_a_longer_lens_moves_points_away_and_keeps_their_width(size: tuple[int, int], tmp_path: Path) -> None:
    """Z grows with the focal length, X = (u - cx) Z / fx and Y stay."""
    model = canonical_net(48, 64).save_pretrained(tmp_path / "model")
    source = save(tmp_path / "in/kitchen.png", photo(*size))
    clouds = []
    for focal in (40, 80):
        camera = f"intrinsics=[{focal},{focal},{(size[1] - 1) / 2},{(size[0] - 1) / 2}]"
        run(model, source, tmp_path / str(focal), camera, "formats=[ply]")
        clouds.append(read_ply(tmp_path / f"{focal}/kitchen.ply"))
    near, far = clouds
    assert len(near) == size[0] * size[1]
    for axis, factor in (("x", 1), ("y", 1), ("z", 2)):
        np.testing.assert_allclose(far[axis], factor * near[axis], rtol=1e-4, atol=1e-5)


def test_a_note_says_when_depth_is_doubtful(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    source = save(tmp_path / "a.png", photo())
    eldenet.load("eldenet_s").save_pretrained(tmp_path / "model")
    run(tmp_path / "model", source, tmp_path / "unknown", "formats=depth")
    assert "does not say at which size it was trained" in capsys.readouterr().out
    run(tmp_path / "model", source, tmp_path / "given", "formats=depth", "input_size=[32,64]")
    assert "at which size" not in capsys.readouterr().out
    run("eldenet_s", source, tmp_path / "new", "formats=depth")
    assert "freshly initialized" in capsys.readouterr().out


def test_a_photo_is_turned_upright_by_its_exif(model_folder: Path, tmp_path: Path) -> None:
    source = turned_by_exif(save(tmp_path / "in/turned.jpg", photo()))
    run(model_folder, source, tmp_path / "out", "formats=depth")
    assert cv2.imread(str(tmp_path / "out/turned_depth.png"), cv2.IMREAD_UNCHANGED).shape == (64, 48)


def test_pictures_of_one_name_in_a_folder_get_different_results(model_folder: Path, tmp_path: Path) -> None:
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
    save(tmp_path / "in/a_jpg.png", photo())
    with pytest.raises(ValueError, match="differ too little"):
        name_results(tmp_path / "in", output)


def test_results_are_replaced_only_with_overwrite_and_only_by_name(
    model_folder: Path, tmp_path: Path
) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    for name in ("a.png", "b.png"):
        save(source / name, photo())
    run(model_folder, source, out)
    with pytest.raises(ValueError, match=r"4 results already exist, such as .*a_depth.*overwrite=true"):
        run(model_folder, source, out)
    run(model_folder, source, out, "formats=[ply]", "intrinsics=[50,50,31,23]")  # other names
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    save(source / "a.png", photo()[::-1])
    (source / "b.png").unlink()
    run(model_folder, source, out, "formats=[depth]", "overwrite=true")
    after = {path.name: path.read_bytes() for path in out.iterdir()}
    assert after.keys() == before.keys()
    assert [name for name in after if after[name] != before[name]] == ["a_depth.png"]


def test_a_source_is_never_overwritten(model_folder: Path, tmp_path: Path) -> None:
    for name in ("a.png", "a_depth.png"):
        save(tmp_path / name, photo())
    with pytest.raises(ValueError, match=r"a_depth\.png is a source"):
        run(model_folder, tmp_path, tmp_path, "formats=[depth]", "overwrite=true")


def test_an_unreadable_picture_stops_the_command_or_is_listed(
    model_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    save(tmp_path / "in/a.png", photo())
    bad = save(tmp_path / "in/b.png", photo())
    bad.write_bytes(bad.read_bytes()[:200])
    with pytest.raises(
        ValueError, match=r"b\.png is truncated or damaged .*1 of 2 pictures are done; on_error=skip"
    ):
        run(model_folder, tmp_path / "in", tmp_path / "strict")
    results = run(model_folder, tmp_path / "in", tmp_path / "out", "on_error=skip")
    assert (results.images, len(results.skipped)) == (1, 1)
    said = capsys.readouterr().out
    for words in ("1 picture: depth + color in", "images/s", "skipped 1:\n", "b.png is truncated"):
        assert words in said
    (tmp_path / "in/a.png").unlink()
    with pytest.raises(ValueError, match="none of 1 pictures could be read"):
        run(model_folder, tmp_path / "in", tmp_path / "none", "on_error=skip")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["intrinsics=[500,500,320]"], r"intrinsics=\[500, 500, 320\]: give \[fx, fy, cx, cy\]"),
        (["intrinsics=[0,500,320,240]"], "fx and fy above 0"),
        (["intrinsics=5"], "or the .3, 3. matrix"),
        (["formats=[ply]"], "a.png: point clouds need the lens, which this file does not say"),
        (["fov=60", "intrinsics=[500,500,32,24]"], "intrinsics and fov are given"),
        (["fov=190"], "fov=190"),
        (["focal=0"], "focal=0"),
        (["formats=[jpeg]"], "depth, color, ply"),
        (["formats=[]"], "formats is empty"),
        (["on_error=ignore"], "stop, skip"),
        (["frames=0"], "frames=0: give a whole number, 1 or more"),
        (["fov=wide"], "fov=wide: give a number or null"),
        (["sharp=maybe"], "sharp=maybe: give true or false"),
        (["camera_timeout=nan"], "camera_timeout=nan: give seconds above 0, or null"),
        (["depth_range=[5,1]"], "near < far"),
        (["input_size=[32]"], "input_size"),
        (["engine=tvm"], "engine='tvm': give one of auto, torch"),
        (["checkpoint=nothing/of/this/name"], "neither a local folder"),
    ],
)
def test_wrong_settings_are_refused(
    model_folder: Path, tmp_path: Path, overrides: list[str], message: str
) -> None:
    source = save(tmp_path / "a.png", photo())
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        run(model_folder, source, tmp_path / "out", *overrides)
    assert not (tmp_path / "out").exists()


def test_wrong_sources_are_refused(model_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.png").write_text("no picture at all")
    (tmp_path / "text.mp4").write_text("no video at all")
    for source, message in (
        ("nothing.jpg", "does not exist"),
        ("empty", "holds no pictures"),
        ("text.png", r"text\.png .*is not a JPEG"),
        ("text.mp4", r"text\.mp4 is truncated or not a valid video"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            run(model_folder, tmp_path / source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_videos_in_a_folder_of_pictures_are_named(model_folder: Path, tmp_path: Path, caplog) -> None:
    save(tmp_path / "in/a.png", photo())
    (tmp_path / "in/b.MOV").touch()
    assert run(model_folder, tmp_path / "in", tmp_path / "out").images == 1
    said = f"videos are passed over (1): give each by itself, source={tmp_path / 'in/b.MOV'}"
    assert said in caplog.text


def test_intrinsics_fit_pictures_of_one_size(model_folder: Path, tmp_path: Path) -> None:
    save(tmp_path / "in/a.png", photo())
    save(tmp_path / "in/b.png", photo(40, 30))
    assert run(model_folder, tmp_path / "in", tmp_path / "other").images == 2
    with pytest.raises(ValueError, match=r"b is 40 x 30, but the previous pictures are 48 x 64"):
        run(model_folder, tmp_path / "in", tmp_path / "out", "intrinsics=[50,50,32,24]")
    with pytest.raises(ValueError, match=r"\(640, 360\) lies outside the picture, which is 64 x 48"):
        run(model_folder, tmp_path / "in/a.png", tmp_path / "none", "intrinsics=[900,900,640,360]")


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
def test_auto_device_means_the_cpu_outside_torch(
    tmp_path: Path, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accelerators of ONNX Runtime and OpenVINO need other builds."""
    pytest.importorskip(engine)

    def choose(**given: Any) -> Resources:
        with monkeypatch.context() as patch:
            patch.setattr("torch.cuda.is_available", lambda: True)
            return choose_resources(**given)

    monkeypatch.setattr("eldenet.predict.choose_resources", choose)
    folder = light_net().save_pretrained(tmp_path / "model", info={"input_size": [32, 64]})
    asked = settings(folder, tmp_path / "a.png", tmp_path / "out", f"engine={engine}")
    predictor = open_predictor(asked, RunLog(tmp_path, quiet=True))
    assert predictor.model.device == "cpu"
    assert predictor(photo()).shape == (48, 64)


@pytest.mark.slow
@pytest.mark.parametrize("info", [{"input_size": [64, 96]}, {}])
def test_another_input_size_shows_a_runtime_what_torch_sees(tmp_path: Path, info: dict[str, Any]) -> None:
    pytest.importorskip("onnxruntime")
    folder = light_net().save_pretrained(tmp_path / "model", info=info)
    depth = []
    for engine in ("torch", "onnxruntime"):
        words = ["sharp=false", "input_size=[32,64]", f"engine={engine}"]
        asked = settings(folder, tmp_path / "a.png", tmp_path / "out", *words)
        predictor = open_predictor(asked, RunLog(tmp_path, quiet=True))
        depth.append(predictor(photo(72, 128)))
    np.testing.assert_allclose(depth[1], depth[0], rtol=1e-3)


@pytest.mark.slow
def test_a_network_without_a_graph_for_any_size_runs_at_one(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    folder = rounding_down_net().save_pretrained(tmp_path / "model", info={"input_size": [64, 96]})
    words = [folder, tmp_path / "a.png", tmp_path / "out", "engine=onnxruntime"]
    with pytest.raises(ValueError, match=r"no graph for any size: .*\(predict: input_size=\)"):
        open_predictor(settings(*words), RunLog(tmp_path, quiet=True))
    predictor = open_predictor(settings(*words, "input_size=[64,96]"), RunLog(tmp_path, quiet=True))
    assert predictor(photo(90, 160)).shape == (90, 160)


def test_the_command_writes_below_runs_and_fails_with_one_line(
    model_folder: Path, tmp_path: Path, run_command
) -> None:
    for name in "abc":
        save(tmp_path / f"in/{name}.png", photo())
    done = run_command("predict", f"checkpoint={model_folder.parent}", "source=in", "frames=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (output,) = (tmp_path / "runs").glob("predict-*")
    assert listed(output) == ["a_color.png", "a_depth.png", "b_color.png", "b_depth.png"]
    assert f"2 pictures: depth + color in runs/{output.name}" in done.stdout
    failed = run_command("predict", f"checkpoint={model_folder}", "source=nothing.jpg", cwd=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr == (
        "error: source=nothing.jpg does not exist: give a picture, folder, video or camera:0\n"
    )
    assert len(list((tmp_path / "runs").iterdir())) == 1


LOADS_NO_TORCH = """
import resource, sys
from pathlib import Path
from eldenet.compose import compose
from eldenet.predict import PredictSettings, predict
words = sys.argv[1:]
try:
    predict(compose(PredictSettings, words))
except FileNotFoundError:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    assert usage.ru_utime + usage.ru_stime < 1.5, usage
assert "torch" not in sys.modules, "torch is loaded"
"""


def test_without_a_checkpoint_the_best_weights_of_the_package_are_taken(tmp_path: Path, run_command) -> None:
    save(tmp_path / "photo.jpg", photo(48, 64))
    done = run_command("predict", "source=photo.jpg", "output=out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"weights: {BEST} (the default; checkpoint=... takes others)" in done.stdout
    assert "license of the weights: Apache-2.0; trained on NYU Depth V2, a research release" in done.stdout
    assert (tmp_path / "out/photo_depth.png").is_file()


def test_a_missing_package_for_one_picture_is_said_before_the_first(tmp_path: Path, monkeypatch) -> None:
    save(tmp_path / "photos/a.png", photo())
    (tmp_path / "photos/b.heic").write_bytes(b"")
    monkeypatch.setattr("eldenet.system.extras.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"reading HEIC pictures needs pillow_heif.*\[heic\]"):
        find_source(str(tmp_path / "photos"), tmp_path / "out", None)


@pytest.mark.slow
def test_an_exported_file_and_a_wrong_source_load_no_torch(model: DepthNet, tmp_path: Path) -> None:
    file, source = exported(model, tmp_path / "small.onnx"), save(tmp_path / "a.png", photo())
    detector = save_detector(tmp_path / "detector.onnx", *FILES["yolov8"])
    boxes = ["overwrite=true", "boxes=true", "fov=60", f"perception.detector.path={detector}"]
    for checkpoint, given, more in (
        (file, source, []),
        (file, source, boxes),
        ("eldenet_rooms", "camera:99", []),
    ):
        words = [f"checkpoint={checkpoint}", f"source={given}", f"output={tmp_path / 'out'}", *more]
        done = subprocess.run(
            [sys.executable, "-c", LOADS_NO_TORCH, *words], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert checkpoint != file or "license of the weights: not stated" in done.stdout
    assert listed(tmp_path / "out") == ["a_boxes.png", "a_boxes.txt", "a_color.png", "a_depth.png"]


@pytest.mark.parametrize(
    ("words", "goes_on"), [((), True), (("steady=false",), False), (("topic=/b",), False)]
)
def test_a_stopped_video_goes_on_with_the_same_settings_alone(
    model_folder: Path, tmp_path: Path, words: tuple[str, ...], goes_on: bool
) -> None:
    video = Source({tmp_path / "walk.mp4": "walk"}, is_video=True, is_live=False)
    stopped, now = (settings(model_folder, tmp_path, tmp_path / "out", *more) for more in ((), words))
    open_results(stopped, video).begin()
    assert open_results(now, video).goes_on == goes_on


def test_a_command_that_a_full_disk_stopped_goes_on_without_overwrite(
    model_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    for name in ("a.png", "b.png", "c.png"):
        save(source / name, photo())
    with monkeypatch.context() as full:
        full.setattr(outputs, "write_picture", full_after(3, outputs.write_picture))
        with pytest.raises(OSError, match="no space left"):
            run(model_folder, source, out)
    assert listed(out) == ["a_color.png", "a_depth.png", "b_depth.png"]
    first = (out / "a_depth.png").stat().st_mtime_ns
    with pytest.raises(ValueError, match="results already exist"):  # another command
        run(model_folder, source, out, "max_side=128")
    assert run(model_folder, source, out).images == 2
    assert "1 of 3 pictures were done before the command stopped" in capsys.readouterr().out
    assert (out / "a_depth.png").stat().st_mtime_ns == first
    assert sorted(path.name for path in out.iterdir()) == [
        f"{name}_{kind}.png" for name in "abc" for kind in ("color", "depth")
    ]
    with pytest.raises(ValueError, match="6 results already exist"):  # it is complete now
        run(model_folder, source, out)


def full_after(count: int, write: Callable[..., None]) -> Callable[..., None]:
    left = [count]

    def limited(*arguments: object) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError("no space left on this disk")
        write(*arguments)

    return limited
