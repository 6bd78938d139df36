"""Pictures and depth maps are read exactly; damaged files and wrong units are errors that name the file."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.layouts import real_folder
from support.predicting import turned_by_exif

from eldenet.data.array_files import PIXEL_VARIABLE
from eldenet.data.io import (
    decode_depth,
    depth_encoding,
    read_depth,
    read_image,
    read_raw_depth,
)

RNG = np.random.default_rng(0)
RGB = RNG.integers(0, 255, (37, 53, 3), dtype=np.uint8)
MILLIMETERS = RNG.integers(0, 9000, (37, 53)).astype(np.uint16)


def write(path: Path, picture: np.ndarray, *params: int) -> Path:
    if picture.ndim == 3:
        picture = picture[..., ::-1]
    assert cv2.imwrite(str(path), picture, list(params))
    return path


def cut(path: Path, fraction: float) -> Path:
    content = path.read_bytes()
    target = path.with_name(f"cut_{path.name}")
    target.write_bytes(content[: int(len(content) * fraction)])
    return target


@pytest.mark.parametrize("ending", [".png", ".bmp", ".ppm", ".tif", ".jpg", ".webp"])
def test_images_are_rgb(tmp_path: Path, ending: str) -> None:
    smooth = np.zeros((32, 48, 3), np.uint8)
    smooth[..., 0], smooth[:, 32:, 2] = 200, 90  # whole JPEG blocks
    read = read_image(write(tmp_path / f"a{ending}", smooth))
    assert read.dtype == np.uint8
    assert read.shape == (32, 48, 3)
    assert np.abs(read.astype(int) - smooth).max() <= (25 if ending in (".jpg", ".webp") else 0)


@pytest.mark.parametrize("fraction", [0.3, 0.99])
@pytest.mark.parametrize("ending", [".png", ".bmp", ".ppm", ".tif", ".webp", ".jpg", "_progressive.jpg"])
def test_a_cut_picture_is_named(tmp_path: Path, ending: str, fraction: float) -> None:
    progressive = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1) if "progressive" in ending else ()
    whole = write(tmp_path / f"picture{ending}", RGB, *progressive)
    assert read_image(whole).shape == RGB.shape
    with pytest.raises(ValueError, match=rf"cut_picture{ending}.*(truncated|damaged)"):
        read_image(cut(whole, fraction))


def test_jpeg_with_trailing_bytes_is_whole(tmp_path: Path) -> None:
    path = write(tmp_path / "a.jpg", RGB)
    plain = read_image(path)
    path.write_bytes(path.read_bytes() + b"\0" * 100 + b"camera")
    np.testing.assert_array_equal(read_image(path), plain)


def test_exif_does_not_turn_a_data_set(tmp_path: Path) -> None:
    """Depth is stored as the pixels are; OpenCV would turn the picture alone."""
    path = turned_by_exif(write(tmp_path / "a.jpg", RGB))
    assert read_image(path).shape == (37, 53, 3)
    assert read_image(path, upright=True).shape == (53, 37, 3)


@pytest.mark.parametrize(
    ("name", "raw", "meters"),
    [
        ("mm", np.uint16([0, 1, 1000, 65535]), [0.0, 0.001, 1.0, 65.535]),
        ("kitti", np.uint16([0, 256, 640, 20480]), [0.0, 1.0, 2.5, 80.0]),
        ("tum", np.uint16([0, 5000, 1, 10000]), [0.0, 1.0, 0.0002, 2.0]),
        ("sunrgbd", np.uint16([0, 8000, 7, 8193]), [0.0, 1.0, 57.344, 9.216]),
        ("nyu8", np.uint8([0, 255, 51, 102]), [0.0, 10.0, 2.0, 4.0]),
        (
            "nyu8_labelled",
            np.uint8([0, 1, 254, 100]),
            [0.0, 1.5 * 9.99547 / 255, 254.5 * 9.99547 / 255, 3.9394],
        ),
        ("meters", np.float32([0, np.nan, -1, 2.5]), [0.0, 0.0, 0.0, 2.5]),
        ("meters", np.float64([0, np.inf, 1, 2.5]), [0.0, 0.0, 1.0, 2.5]),
    ],
)
def test_encodings_give_meters(name: str, raw: np.ndarray, meters: list[float]) -> None:
    depth = decode_depth(raw[None], name, "test")
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth[0], meters, rtol=1e-5)


def test_an_encoding_can_be_given_as_numbers() -> None:
    raw = np.array([[0, 10]], np.uint8)
    np.testing.assert_allclose(
        decode_depth(raw, {"scale": 0.5, "offset": 1, "dtype": "uint8"}, "x"), [[0, 5.5]]
    )
    assert depth_encoding({"scale": 0.5, "dtype": "uint8"}).name == "{scale: 0.5, dtype: uint8}"
    far = np.full((2, 2), 300.0, np.float32)
    np.testing.assert_allclose(decode_depth(far, {"scale": 1.0, "dtype": "float"}, "x"), far)


@pytest.mark.parametrize("bad", ["millimeters", {"dtype": "uint8"}, {"scale": 0}, {"scale": 1, "unit": "m"}])
def test_unknown_encoding_is_refused(bad: object) -> None:
    with pytest.raises(ValueError, match=r"give|must be"):
        depth_encoding(bad)  # type: ignore[arg-type]


def test_wrong_unit_is_refused(tmp_path: Path) -> None:
    eight = write(tmp_path / "eight.png", (MILLIMETERS // 40).astype(np.uint8))
    with pytest.raises(ValueError, match=r"eight\.png.*uint8.*'mm' needs uint16"):
        read_depth(eight, "mm")
    with pytest.raises(ValueError, match=r"eight\.png.*uint8.*'kitti' needs uint16"):
        read_depth(eight, "kitti")
    sixteen = write(tmp_path / "sixteen.png", MILLIMETERS)
    with pytest.raises(ValueError, match=r"sixteen\.png.*uint16.*'nyu8' needs uint8"):
        read_depth(sixteen, "nyu8")
    whole_meters = write(tmp_path / "whole.png", MILLIMETERS // 1000)
    with pytest.raises(ValueError, match=r"whole\.png.*largest number is 8.*meters.*\{scale: 0\.001\}"):
        read_depth(whole_meters, "mm")
    assert read_depth(whole_meters, {"scale": 0.001}).max() == np.float32(0.008)
    np.save(tmp_path / "float.npy", MILLIMETERS.astype(np.float32))
    with pytest.raises(ValueError, match=r"float\.npy.*median.*mm"):
        read_depth(tmp_path / "float.npy", "meters")
    assert not read_depth(write(tmp_path / "empty.png", MILLIMETERS * 0), "mm").any()


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.int64, np.uint32])
def test_wider_integers_of_numpy_are_read_as_16_bits(dtype: type, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", MILLIMETERS.astype(dtype))
    meters = read_depth(tmp_path / "a.npy", "mm")
    np.testing.assert_array_equal(meters, decode_depth(MILLIMETERS, "mm", "x"))
    np.testing.assert_array_equal(meters, read_depth(tmp_path / "a.npy", {"scale": 0.001}))
    with pytest.raises(ValueError, match=r"'sunrgbd' needs uint16"):  # whose bits turn within 16
        read_depth(tmp_path / "a.npy", "sunrgbd")


def test_pictures_of_sixteen_bits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gray\.png holds uint16.*is it a depth map\?"):
        read_image(write(tmp_path / "gray.png", MILLIMETERS))
    with pytest.raises(ValueError, match=r"color\.png holds uint16.*: convert it to 8 bits$"):
        read_image(write(tmp_path / "color.png", RGB.astype(np.uint16) * 257))


def test_sunrgbd_turns_back_what_its_toolbox_turned() -> None:
    millimeters = MILLIMETERS.astype(np.uint32)
    stored = ((millimeters << 3) | (millimeters >> 13)).astype(np.uint16)
    expected = (MILLIMETERS / 1000.0).astype(np.float32)
    np.testing.assert_array_equal(decode_depth(stored, "sunrgbd", "x"), expected)


METERS = np.where(MILLIMETERS > 100, MILLIMETERS / np.float32(1000), np.inf).astype(np.float32)


def pfm(path: Path, order: str = "<f4", kind: str = "Pf", values: np.ndarray = METERS) -> Path:
    scale = "-1.0" if order == "<f4" else "0.0039"
    header = f"{kind}\n{values.shape[1]} {values.shape[0]}\n{scale}\n".encode()
    path.write_bytes(header + values[::-1].astype(order).tobytes())
    return path


@pytest.mark.parametrize("order", ["<f4", ">f4"])
def test_pfm_reads_both_byte_orders(tmp_path: Path, order: str) -> None:
    path = pfm(tmp_path / "a.pfm", order)
    np.testing.assert_array_equal(read_depth(path, "meters"), np.where(np.isfinite(METERS), METERS, 0))
    with pytest.raises(ValueError, match=r"c\.pfm has shape.*one channel"):
        read_depth(pfm(tmp_path / "c.pfm", kind="PF", values=np.dstack([METERS] * 3)), "meters")
    if order == "<f4":  # OpenCV writes the same
        assert cv2.imwrite(str(tmp_path / "b.pfm"), METERS)
        np.testing.assert_array_equal(read_depth(tmp_path / "b.pfm", "meters"), read_depth(path, "meters"))


@pytest.mark.parametrize("half", [False, True])
def test_exr_reads_one_channel_or_equal_ones(tmp_path: Path, half: bool) -> None:
    exr = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install -e '.[exr]'")
    meters = (MILLIMETERS / 1000.0).astype(np.float16 if half else np.float32)
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}

    def written(name: str, channels: dict[str, np.ndarray]) -> Path:
        exr.File(header, channels).write(str(tmp_path / name))
        return tmp_path / name

    path = written("a.exr", {"Z": meters})
    np.testing.assert_array_equal(read_depth(path, "meters"), meters.astype(np.float32))
    gray = written("gray.exr", {"R": meters, "G": meters, "B": meters})
    np.testing.assert_array_equal(read_depth(gray, "meters"), meters.astype(np.float32))
    with pytest.raises(ValueError, match=r"color\.exr has the channels"):
        read_depth(written("color.exr", {"R": meters, "G": meters, "B": meters * 2}), "meters")


def test_float_tiff_is_read(tmp_path: Path) -> None:
    meters = MILLIMETERS.astype(np.float32) / 1000
    np.testing.assert_array_equal(read_depth(write(tmp_path / "a.tif", meters), "meters"), meters)


def test_a_real_npy_equals_a_straight_reading() -> None:
    path = real_folder("nyu_depth_v2/fastdepth_npy", "depth.npy") / "depth.npy"
    np.testing.assert_array_equal(read_depth(path, "meters"), np.load(path).squeeze())


@pytest.mark.parametrize("peak", [1, 15, 100, 254, 255])
def test_a_ppm_of_any_peak_has_the_full_range(tmp_path: Path, peak: int) -> None:
    numbers = RNG.integers(0, peak + 1, (4, 5, 3), dtype=np.uint8)
    (tmp_path / "a.ppm").write_bytes(b"P6\n5 4\n%d\n" % peak + numbers.tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.ppm"), np.floor(numbers * 255.0 / peak + 0.5))
    (tmp_path / "d.pgm").write_bytes(b"P5\n5 4\n%d\n" % peak + numbers[..., 0].tobytes())
    np.testing.assert_array_equal(read_raw_depth(tmp_path / "d.pgm"), numbers[..., 0])  # these are no colors


@pytest.mark.parametrize(
    "content", [b"GIF89a" + bytes(20), b"\0\0\0\x1cftypavif" + bytes(20), b"P3\n1 1\n9\n1 2 3\n"]
)
def test_a_format_that_is_not_read_gets_what_to_do(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.jpg .* is not a JPEG, PNG.*: convert it to JPEG or PNG"):
        read_image(tmp_path / "a.jpg")


@pytest.mark.parametrize("tags", [{254: 1}, {50706: b"\1\4\0\0"}])
def test_the_preview_in_a_raw_photo_is_not_taken_for_the_photo(tmp_path: Path, tags: dict) -> None:
    Image.fromarray(RGB).save(tmp_path / "a.tif", tiffinfo=tags)
    with pytest.raises(ValueError, match="raw photo"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("ending", [".png", ".bmp", ".ppm", ".tif", ".jpg", ".npy", ".pfm", ".exr"])
def test_pixels_are_counted_before_they_are_read(ending: str, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / f"a{ending}"
    if ending == ".npy":
        np.save(path, np.ones((37, 53), np.float32))
    elif ending == ".pfm":
        path.write_bytes(b"Pf\n53 37\n-1\n" + np.ones((37, 53), "<f4").tobytes())
    elif ending == ".exr":
        OpenEXR = pytest.importorskip("OpenEXR")
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": np.ones((37, 53), np.float32)}).write(str(path))
    else:
        write(path, RGB)
    read = read_image if ending in (".png", ".bmp", ".ppm", ".tif", ".jpg") else read_depth
    more = () if read is read_image else ("meters",)
    monkeypatch.setenv(PIXEL_VARIABLE, str(37 * 53))
    assert read(path, *more).shape[:2] == (37, 53)
    monkeypatch.setenv(PIXEL_VARIABLE, str(37 * 53 - 1))
    with pytest.raises(ValueError, match=rf"a\{ending} has .*37 x 53.*{PIXEL_VARIABLE}"):
        read(path, *more)
