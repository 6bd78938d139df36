"""What may happen to the files of a data set: each is one clear error that names the file, or a counted skip.

Changes that nothing can detect are left out: other numbers in pixels without a checksum.
"""

import shutil
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import layouts
from support.damaged_layouts import LAYOUTS, NYU_FRAME, Target, folder_of
from support.damages import exr, pfm

from eldenet.compose import compose
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings

RNG = np.random.default_rng


def samples(config: Any, split: str = "train") -> tuple[Any, list[dict[str, Any]]]:
    """A split as a command builds it, and everything in it."""
    data = open_split(config.data, split, chosen_protocol(config.data, config.protocol))
    return data, [data[index] for index in range(len(data))]


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one["name"] == other["name"] and all(
        bool((one[key] == other[key]).all()) for key in ("image", "depth", "mask", "intrinsics")
    )


def is_clear(error: Exception, target: Target) -> bool:
    """One line that names the file, of a kind that a command shows without a traceback."""
    names = (target.named or Path(target.file).stem).split("|")
    message = str(error)
    return (
        type(error) in (ValueError, FileNotFoundError)
        and any(name in message for name in names)
        and 40 < len(message) < 1200
        and "Traceback" not in message
    )


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_damage_is_named_or_counted(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(layouts, "KITTI_SIZES", {"2011_09_26": (60, 80), "2011_09_28": (56, 84)})
    layout = LAYOUTS[name]
    root = tmp_path / "data set"
    given = layout.given(root)
    stop, skip = (compose(TrainSettings, [*given, f"data.on_error={how}"]) for how in ("stop", "skip"))
    data, whole = samples(skip, layout.split)
    assert data.skipped == {}
    names = data.names
    del data
    wrong = []
    cases = [(one, damage) for one in layout.targets for damage in one.damages]
    for target, damage in cases:
        path, kept = root / target.file, (root / target.file).read_bytes()
        path.unlink()  # another file, as after a fetch: HDF5 knows open files by their inode
        path.write_bytes(kept)
        capfd.readouterr()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            damage(path)
            fault = check(stop, skip, layout.split, target, names, whole)
        said = "".join(capfd.readouterr())
        if path.suffix == ".exr":  # OpenEXR prints as well; the error is there all the same
            said = ""
        if not fault and (warned or said):
            fault = f"printed {said!r}, warned of {[str(w.message) for w in warned]}"
        if fault:
            wrong.append(f"{target.file}, {getattr(damage, '__qualname__', damage)}: {fault}")
        if path.is_dir():
            shutil.rmtree(path)
        path.write_bytes(kept)
    assert not wrong, "\n".join(wrong)


def check(
    stop: Any, skip: Any, split: str, target: Target, names: Sequence[str], whole: Sequence[dict[str, Any]]
) -> str:
    """What is wrong with how this damage is met, or ""."""
    try:
        samples(stop, split)
    except Exception as error:
        if not is_clear(error, target):
            return f"unclear {type(error).__name__}: {error}"
    else:
        return "on_error=stop did not stop"
    try:
        data, left = samples(skip, split)
    except Exception as error:
        return (
            ""
            if target.lost is None and is_clear(error, target)
            else f"skip: {type(error).__name__}: {error}"
        )
    if target.lost is None and not data.skipped:
        return "on_error=skip noticed nothing"
    if target.lost is not None and list(data.skipped) != [target.lost]:
        return f"skipped {data.skipped}"
    expected = [sample for sample in whole if sample["name"] in data.names]
    if target.lost is not None and len(expected) != len(names) - 1:
        return f"{len(left)} of {len(names)} frames are left"
    if not (len(left) == len(expected) and all(map(equal, left, expected))):
        return "the other frames are not what they were"
    return ""


def test_numbers_that_are_no_depth_are_unknown(tmp_path: Path) -> None:
    """Among good ones NaN, infinity and negative numbers are holes, in every format that can hold them."""
    values = NYU_FRAME.meters.copy()
    bad = RNG(0).random(values.shape) < 0.2
    values[bad] = RNG(1).choice([np.nan, np.inf, -np.inf, -1.0, 0.0], bad.sum())
    layouts.hdf5(tmp_path / "h5", NYU_FRAME._replace(meters=values))
    for ending, writer in ((".npy", np.save), (".pfm", pfm), (".exr", exr), (".tiff", layouts.picture)):
        root = tmp_path / ending
        given = folder_of(ending, ()).given(root)
        writer(root / f"depths/f1{ending}", values)
        config = compose(TrainSettings, [*given, "data.input_size=null", "data.resize_on_load=null"])
        _, (_, sample, _) = samples(config)
        np.testing.assert_array_equal(sample["mask"][0], ~bad)
        np.testing.assert_array_equal(sample["depth"][0], np.where(bad, 0, NYU_FRAME.meters))
    given = [f"data.root={tmp_path / 'h5'}", "data.train.split=trainval", "data.input_size=null"]
    config = compose(
        TrainSettings, ["data=nyu_hdf5", "protocol=folder", "data.train.resize_on_load=null", *given]
    )
    np.testing.assert_array_equal(samples(config)[1][0]["mask"][0], ~bad)


def test_a_webcams_extra_byte_is_no_damage(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from eldenet.data.io import read_image

    file = tmp_path / "frame.jpg"
    layouts.picture(file, NYU_FRAME.rgb)
    whole, content = read_image(file), file.read_bytes()
    file.write_bytes(content[:-2] + b"\0\0\0" + content[-2:])
    np.testing.assert_array_equal(read_image(file), whole)
    assert capfd.readouterr().err == ""
    size = struct.pack(">HH", 60000, 60000)  # a frame that no memory holds
    at = content.index(b"\xff\xc0") + 5
    file.write_bytes(content[:at] + size + content[at + 4 :])
    with pytest.raises(ValueError, match=r"frame\.jpg"):
        read_image(file)
