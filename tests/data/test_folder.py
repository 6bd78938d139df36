"""Your own pictures with depth: pairs, splits, and errors that name the file."""

import unicodedata
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.layouts import real_folder

from eldenet.data.folder import FolderDataset

RNG = np.random.default_rng(0)
RGB = np.repeat(RNG.integers(0, 255, (20, 30, 1), dtype=np.uint8), 3, axis=-1)
MILLIMETERS = RNG.integers(500, 9000, (20, 30)).astype(np.uint16)
MILLIMETERS[3, 4] = 0


def tree(root: Path, count: int = 2, images: str = "images", depths: str = "depths") -> Path:
    for folder in (images, depths):
        (root / folder).mkdir(parents=True, exist_ok=True)
    for i in range(count):
        cv2.imwrite(str(root / images / f"f{i:03d}.png"), RGB)
        cv2.imwrite(str(root / depths / f"f{i:03d}.png"), MILLIMETERS)
    return root


def test_files_in_two_folders_are_paired_by_name(tmp_path: Path) -> None:
    data = FolderDataset(tree(tmp_path), intrinsics=[100, 90, 15, 10], max_depth=8.0, input_size=(10, 15))
    assert data.names == ["f000", "f001"]
    assert data.ground_truth == "raw"
    frame = data.load_frame(1)
    np.testing.assert_array_equal(frame.depth, (MILLIMETERS / 1e3).astype(np.float32))
    sample = data[0]
    assert sample["image"].shape == (3, 10, 15)
    np.testing.assert_allclose(sample["intrinsics"], [[50, 0, 7.25], [0, 45, 4.75], [0, 0, 1]], rtol=1e-6)
    full = FolderDataset(tmp_path, max_depth=8.0)[0]
    expected = (MILLIMETERS > 0) & (MILLIMETERS <= 8000)
    np.testing.assert_array_equal(full["mask"][0], expected)
    assert not full["intrinsics"].any()
    np.testing.assert_allclose(full["image"][0] * 255, RGB[..., 0], atol=1e-3)


def test_subfolders_and_npy_files_are_read(tmp_path: Path) -> None:
    tree(tmp_path / "images", 1, "a", "unused")
    for path in (tmp_path / "images/unused").iterdir():
        path.unlink()
    (tmp_path / "gt/a").mkdir(parents=True)
    np.save(tmp_path / "gt/a/f000.npy", (MILLIMETERS / 1e3).astype(np.float32))
    data = FolderDataset(tmp_path, depths="gt", encoding="meters", max_depth=10.0, ground_truth="inpainted")
    assert data.names == ["a/f000"]
    assert data.ground_truth == "inpainted"
    np.testing.assert_array_equal(data.load_frame(0).depth, (MILLIMETERS / 1e3).astype(np.float32))


def test_a_csv_pairs_files_of_any_name(tmp_path: Path) -> None:
    tree(tmp_path)
    (tmp_path / "pairs.csv").write_text(
        "images/f001.png,depths/f000.png\n\nimages/f000.png,depths/f001.png\n"
    )
    data = FolderDataset(tmp_path, csv="pairs.csv", max_depth=10.0)
    assert data.names == ["images/f000", "images/f001"]
    assert data.files[0] == ("images/f000.png", "depths/f001.png")
    (tmp_path / "pairs.csv").write_text("images/f001.png,depths/f000.png,518.8\n")
    with pytest.raises(ValueError, match=r"pairs\.csv, line 1"):
        FolderDataset(tmp_path, csv="pairs.csv", max_depth=10.0)
    (tmp_path / "pairs.csv").write_text("images/f001.png,depths/f009.png\n")
    with pytest.raises(FileNotFoundError, match=r"1 of 2 files are missing: .*depths/f009\.png"):
        FolderDataset(tmp_path, csv="pairs.csv", max_depth=10.0)
    (tmp_path / "pairs.csv").write_text("images/f001.png,depths/f000.png\nimages/f001.png,depths/f001.png\n")
    with pytest.raises(ValueError, match="2 lines but only 1"):
        FolderDataset(tmp_path, csv="pairs.csv", max_depth=10.0)


def test_an_empty_folder_is_named_with_what_belongs_there(tmp_path: Path) -> None:
    tree(tmp_path, 0)
    (tmp_path / "images/a.dng").touch()
    with pytest.raises(FileNotFoundError, match=r"/images holds no pictures \(\.jpg.* data\.images"):
        FolderDataset(tmp_path, split="val", max_depth=10.0)
    cv2.imwrite(str(tmp_path / "images/a.png"), RGB)
    with pytest.raises(FileNotFoundError, match=r"/depths holds no depth maps \(\.png.* data\.depths"):
        FolderDataset(tmp_path, split="val", max_depth=10.0, on_error="skip")


@pytest.mark.parametrize("wrong", [[0, 90, 15, 10], [100, -90, 15, 10], [np.inf, 90, 15, 10], [100, 90, 15]])
def test_a_camera_that_cannot_be_is_refused(tmp_path: Path, wrong: list[float]) -> None:
    with pytest.raises(ValueError, match=r"intrinsics=\[.*: give \[fx, fy, cx, cy\] .*, fx and fy above"):
        FolderDataset(tree(tmp_path), intrinsics=wrong, max_depth=8.0)


def test_a_camera_of_other_pictures_is_refused(tmp_path: Path) -> None:
    """Intrinsics of 640 x 480 px do not fit pictures that were resized since."""
    for split in ("train", "val"):
        with pytest.raises(
            ValueError, match=r"the principal point \(320, 240\) lies outside the picture, .*30 x 20"
        ):
            FolderDataset(tree(tmp_path), intrinsics=[525, 525, 320, 240], split=split, max_depth=8.0)


def test_missing_partners_are_named(tmp_path: Path) -> None:
    tree(tmp_path, 30)
    for i in range(12):
        (tmp_path / f"depths/f{i:03d}.png").unlink()
    (tmp_path / "images/f020.png").unlink()
    with pytest.raises(FileNotFoundError) as error:
        FolderDataset(tmp_path, max_depth=10.0)
    text = str(error.value)
    assert "13 files" in text
    assert "images/f000.png" in text
    assert "images/f009.png" in text
    assert "f010" not in text
    assert "and 3 more" in text


def test_hidden_files_are_no_frames(tmp_path: Path) -> None:
    tree(tmp_path)
    (tmp_path / "images/._f000.png").write_bytes(b"a Mac's note on the file")
    (tmp_path / "depths/.thumbnails").mkdir()
    cv2.imwrite(str(tmp_path / "depths/.thumbnails/f000.png"), MILLIMETERS)
    assert FolderDataset(tmp_path, max_depth=10.0).names == ["f000", "f001"]


def test_two_pictures_of_one_name_are_refused(tmp_path: Path) -> None:
    tree(tmp_path)
    cv2.imwrite(str(tmp_path / "images/f000.jpg"), RGB)
    with pytest.raises(ValueError, match=r"f000\.jpg and images/f000\.png"):
        FolderDataset(tmp_path, max_depth=10.0)


def test_missing_folder_says_what_is_expected(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"has no images, depths.*\n.*images/a\.jpg"):
        FolderDataset(tmp_path, max_depth=10.0)


def test_blocks_follow_each_other_in_time_where_numbers_have_no_leading_zeros(tmp_path: Path) -> None:
    """As text, frame 10 comes before frame 2, and a block would have frames of the whole recording."""
    for number in range(1, 121):
        for folder, picture in (("images", RGB), ("depths", MILLIMETERS)):
            (tmp_path / folder).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / folder / f"{number}.png"), picture)
    numbers = {
        split: sorted(int(name) for name in FolderDataset(tmp_path, split=split, gap=2, max_depth=10.0).names)
        for split in ("train", "val")
    }
    assert len(numbers["val"]) == 12
    assert numbers["val"] == list(range(numbers["val"][0], numbers["val"][0] + 12))
    assert min(abs(one - other) for one in numbers["train"] for other in numbers["val"]) == 3


@pytest.mark.parametrize("seed", range(5))
def test_train_and_val_are_separate_blocks(tmp_path: Path, seed: int) -> None:
    tree(tmp_path, 50)
    options = {"max_depth": 10.0, "val_fraction": 0.2, "split_seed": seed, "gap": 2}
    train = FolderDataset(tmp_path, split="train", **options)
    val = FolderDataset(tmp_path, split="val", **options)
    assert len(val) == 10
    numbers = [{int(name[1:]) for name in part.names} for part in (train, val)]
    assert min(abs(a - b) for a in numbers[0] for b in numbers[1]) == 3  # two frames of gap between them
    assert len(train) + len(val) >= 50 - 8
    assert FolderDataset(tmp_path, split="val", **options).split_hash == val.split_hash
    assert len(FolderDataset(tmp_path, max_depth=10.0)) == 50


@pytest.mark.parametrize("names", ["train Val test", "train/a valid/a test/a", "training test", "train gym"])
def test_folders_named_as_parts_are_these_parts(tmp_path: Path, names: str) -> None:
    """Without ``val``, it is ``test``; one other name, and they are scenes."""
    scenes = names.split()
    for number, scene in enumerate(scenes):
        tree(tmp_path / scene, number + 1)
    below = "/".join("*" for _ in scenes[0].split("/"))
    given = {"images": f"{below}/images", "depths": f"{below}/depths", "max_depth": 9.0}

    def scenes_of(split: str) -> set[str]:
        return {name.rpartition("/")[0] for name in FolderDataset(tmp_path, split=split, **given).names}

    if "gym" in scenes:
        with pytest.raises(ValueError, match="no folders train and test"):
            scenes_of("test")
        assert len(scenes_of("train")) == len(scenes_of("val")) == 1
    else:
        assert scenes_of("train") == {scene for scene in scenes if scene.startswith("train")}
        assert scenes_of("val") == {scenes[1]}
        assert scenes_of("test") == {scene for scene in scenes if scene.startswith("test")}


def test_validation_frames_can_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree(tmp_path, 4)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "val.txt").write_text("f001\nf003\n")
    for given in (["f003", "f001"], tmp_path / "val.txt", "~/val.txt"):
        assert FolderDataset(tmp_path, split="val", val_names=given, max_depth=10.0).names == ["f001", "f003"]
        assert FolderDataset(tmp_path, split="train", val_names=given, max_depth=10.0).names == [
            "f000",
            "f002",
        ]
    with pytest.raises(ValueError, match=r"1 of val_names.*f9.*such as 'f000'"):
        FolderDataset(tmp_path, split="val", val_names=["f9"], max_depth=10.0)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.txt"):
        FolderDataset(tmp_path, split="val", val_names="nowhere.txt", max_depth=10.0)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"split": "dev"}, "split='dev'"),
        ({"ground_truth": "dense"}, "ground_truth"),
        ({"intrinsics": [1, 2]}, "fx, fy, cx, cy"),
        ({"split": "train", "val_fraction": 1.5}, "val_fraction"),
        ({"encoding": "cm"}, "encoding='cm'"),
    ],
)
def test_settings_out_of_range_are_refused(tmp_path: Path, bad: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FolderDataset(tree(tmp_path), **{"max_depth": 10.0, **bad})


def test_range_must_be_given_and_typos_do_not_vanish(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="max_depth is missing"):
        FolderDataset(tree(tmp_path))
    with pytest.raises(TypeError, match="inputsize"):
        FolderDataset(tmp_path, max_depth=10.0, inputsize=(3, 4))  # type: ignore[call-arg]


def test_real_pair() -> None:
    root = real_folder("nyu_depth_v2/mmseg_pseudo_160x120", "annotations")
    data = FolderDataset(root, depths="annotations", max_depth=10.0)
    raw = cv2.imread(str(root / "annotations" / f"{data.names[0]}.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(data.load_frame(0).depth, (raw / 1000.0).astype(np.float32))
    assert data[0]["image"].shape == (3, 120, 160)


def test_names_in_either_form_of_unicode_are_one_name(tmp_path: Path) -> None:
    composed, apart = (unicodedata.normalize(form, "Küche é") for form in ("NFC", "NFD"))
    tree(tmp_path, 2)
    for folder, name in (("images", apart), ("depths", composed)):
        for number in range(2):
            (tmp_path / folder / f"f{number:03d}.png").rename(tmp_path / folder / f"{name}{number}.png")
    data = FolderDataset(tmp_path, max_depth=10.0, split="val", val_names=[f"{apart}1"])
    assert data.names == [f"{composed}1"]
    assert data[0]["mask"].any()
    (tmp_path / "pairs.csv").write_text(f"images/{composed}0.png,depths/{apart}0.png\n")
    assert FolderDataset(tmp_path, csv="pairs.csv", max_depth=10.0)[0]["mask"].any()
    cv2.imwrite(str(tmp_path / f"images/{composed}0.png"), RGB)
    with pytest.raises(ValueError, match="have the same name: remove one"):
        FolderDataset(tmp_path, max_depth=10.0)


def test_pictures_of_other_formats_are_counted_and_named(tmp_path: Path, caplog) -> None:
    tree(tmp_path, 2)
    for name in ("a.dng", "b.DNG", "c.avif", ".d.avif", "notes.txt"):
        (tmp_path / "images" / name).write_bytes(b"")
    for split in ("train", "val"):  # said once
        FolderDataset(tmp_path, max_depth=10.0, split=split)
    (line,) = [record.getMessage() for record in caplog.records]
    assert "are passed over" in line
    assert "(2 .dng, 1 .avif; such as a.dng)" in line


@pytest.mark.parametrize("file", ["../other/f000.png", "depths/../../x.png", "/etc/x.png"])
def test_lists_stay_in_the_data_sets_folder_unless_allowed(file: str, tmp_path: Path) -> None:
    root = tree(tmp_path / "data")
    (root / "list.csv").write_text(f"images/f000.png,{file}\n")
    with pytest.raises(ValueError, match=r"list\.csv: .* is outside .*allow_outside=true"):
        FolderDataset(root, csv="list.csv", max_depth=10.0)
    with pytest.raises(FileNotFoundError, match="files are missing"):
        FolderDataset(root, csv="list.csv", max_depth=10.0, allow_outside=True)
