"""From a photo or a folder to depth files that mean what they say."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.predicting import listed, photo, read_ply, run, save

import eldenet
from eldenet.config import build_prediction, compose
from eldenet.data.io import read_depth
from eldenet.deploy.outputs import Results, name_results
from eldenet.deploy.prediction import open_predictor, predict
from eldenet.deploy.predictor import DepthPredictor
from eldenet.model import DepthNet
from eldenet.results.run_log import RunLog
from eldenet.system.resources import Resources

RNG = np.random.default_rng(0)
CAMERA = [50.0, 52.0, 31.0, 22.5]


def test_one_picture(model_folder: Path, model: DepthNet, tmp_path: Path) -> None:
    source = save(tmp_path / "in/kitchen.png", photo())
    camera = "intrinsics=[" + ",".join(map(str, CAMERA)) + "]"
    results = run(model_folder, source, tmp_path / "out", camera)
    assert listed(tmp_path / "out") == ["kitchen.ply", "kitchen_color.png", "kitchen_depth.png"]
    assert (results.images, results.skipped, results.too_far) == (1, [], 0)
    depth = DepthPredictor(model)(photo())
    written = cv2.imread(str(tmp_path / "out/kitchen_depth.png"), cv2.IMREAD_UNCHANGED)
    assert written.dtype == np.uint16
    np.testing.assert_array_equal(written, np.rint(depth.astype(np.float64) * 1000))
    np.testing.assert_allclose(read_depth(tmp_path / "out/kitchen_depth.png", "mm"), depth, atol=5.1e-4)
    color = cv2.imread(str(tmp_path / "out/kitchen_color.png"))
    assert color.shape[0] == 240
    assert color.shape[1] > 2 * 64 * 5
    # every pixel is a point, of its own color, that projects back to it: the network saw 32 x 64, though
    vertices = read_ply(tmp_path / "out/kitchen.ply")
    assert len(vertices) == 48 * 64
    fx, fy, cx, cy = CAMERA
    rows, cols = np.mgrid[:48, :64]
    np.testing.assert_allclose(vertices["x"] / vertices["z"] * fx + cx, cols.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["y"] / vertices["z"] * fy + cy, rows.ravel(), atol=1e-3)
    np.testing.assert_allclose(vertices["z"], depth.ravel(), rtol=1e-6)
    rgb = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    np.testing.assert_array_equal(rgb.reshape(48, 64, 3), photo())


def test_what_makes_depth_doubtful_is_said(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    source = save(tmp_path / "a.png", photo())
    eldenet.load("eldenet_s").save_pretrained(tmp_path / "model")
    run(tmp_path / "model", source, tmp_path / "unknown", "formats=depth")
    assert "does not say at which size it was trained" in capsys.readouterr().out
    run(tmp_path / "model", source, tmp_path / "given", "formats=depth", "input_size=[32,64]")
    assert "note:" not in capsys.readouterr().out
    predict(
        build_prediction(
            compose("predict", ["checkpoint=eldenet_s", f"source={source}", f"output={tmp_path / 'new'}"])
        )
    )
    assert "freshly initialized" in capsys.readouterr().out


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
    with pytest.raises(
        ValueError, match=r"b\.png is cut or damaged .*1 of 2 pictures are done; on_error=skip"
    ):
        run(model_folder, tmp_path / "in", tmp_path / "strict")
    results = run(model_folder, tmp_path / "in", tmp_path / "out", "on_error=skip")
    assert results.images == 1
    assert len(results.skipped) == 1
    said = capsys.readouterr().out
    assert "1 picture: depth + color in" in said
    assert "images/s" in said
    assert "skipped 1:\n" in said
    assert "b.png is cut" in said
    (tmp_path / "in/a.png").unlink()
    with pytest.raises(ValueError, match="none of 1 pictures could be read"):
        run(model_folder, tmp_path / "in", tmp_path / "none", "on_error=skip")


def test_the_first_pictures_of_a_folder(model_folder: Path, tmp_path: Path) -> None:
    for name in "abc":
        save(tmp_path / f"in/{name}.png", photo())
    assert run(model_folder, tmp_path / "in", tmp_path / "out", "formats=depth", "frames=2").images == 2
    assert listed(tmp_path / "out") == ["a_depth.png", "b_depth.png"]


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that fails like a worn card")
def test_a_card_that_fails_is_one_bad_picture(model_folder: Path, tmp_path: Path) -> None:
    save(tmp_path / "in/a.png", photo())
    (tmp_path / "in/b.png").symlink_to("/proc/self/mem")
    results = run(model_folder, tmp_path / "in", tmp_path / "out", "on_error=skip")
    assert (results.images, len(results.skipped)) == (1, 1)
    assert "Input/output error" in results.skipped[0]


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
        (["formats=[jpeg]"], "depth, color, ply"),
        (["formats=[]"], "formats is empty"),
        (["on_error=ignore"], "stop, skip"),
        (["frames=0"], "frames=0: give a whole number above 0"),
        (["frames=-3"], "frames=-3: give a whole number above 0"),
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
    with pytest.raises(ValueError, match=r"\(640, 360\) lies outside the picture, which is 64 x 48"):
        run(model_folder, tmp_path / "in/a.png", tmp_path / "none", "intrinsics=[900,900,640,360]")


@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
def test_the_other_runtimes_stay_on_the_cpu(model_folder: Path, tmp_path: Path, engine: str) -> None:
    """Where torch sees a GPU, "auto" is that of torch alone: those of ONNX need builds of their own."""
    pytest.importorskip(engine)
    resources = Resources("cuda", "fp32", threads=1, workers=0, cores=1)
    given = [f"checkpoint='{model_folder}'", "source=x", f"engine={engine}"]
    predictor = open_predictor(compose("predict", given), resources, RunLog(tmp_path, quiet=True))
    assert predictor.model.device == "cpu"
    assert predictor(photo()).shape == (48, 64)


def test_depth_beyond_16_bits_is_unknown_and_said(model: DepthNet, tmp_path: Path) -> None:
    results = Results(tmp_path, ("depth",))
    depth = np.full((4, 5), 2.5, np.float32)
    depth[0] = 70.0
    results.write("far", photo(4, 5), depth, results.formats)
    assert results.too_far == 5
    written = cv2.imread(str(tmp_path / "far_depth.png"), cv2.IMREAD_UNCHANGED)
    assert written[0].tolist() == [0] * 5
    assert (written[1:] == 2500).all()


def test_command(model_folder: Path, tmp_path: Path, run_command) -> None:
    save(tmp_path / "in/a.png", photo())
    done = run_command("predict", f"checkpoint={model_folder.parent}", "source=in", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (output,) = (tmp_path / "runs").glob("predict-*")
    assert listed(output) == ["a_color.png", "a_depth.png"]
    assert f"1 picture: depth + color in runs/{output.name}" in done.stdout
    failed = run_command("predict", f"checkpoint={model_folder}", "source=nothing.jpg", cwd=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr == (
        "error: source=nothing.jpg does not exist: give a picture, folder, video or camera:0\n"
    )
    assert len(list((tmp_path / "runs").iterdir())) == 1
