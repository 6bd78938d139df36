"""Files that say by their content what they are, and which of them end before their time."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.films import CODECS, cut, index_first, read_video, trim, turn, write_video
from support.predicting import listed, photo, run, save

from eldenet.deploy.runtimes import DepthStream
from eldenet.deploy.stream import is_live
from eldenet.deploy.video_files import is_video_file


def stream_of(path: Path) -> DepthStream:
    """A stream that was read to its end, and how many frames came, at which times [s]."""
    with DepthStream(path, lambda frame: frame[..., 0].astype(np.float32)) as stream:
        stream.times = [item.time for item in stream]  # type: ignore[attr-defined]
    return stream


# --- what a file is ---


@pytest.mark.parametrize("ending", [".ts", ".m2ts", ".flv", ".wmv", ".3gp", ".mpeg", ".mjpeg", ".webm"])
def test_videos_of_all_endings_become_videos(model_folder: Path, tmp_path: Path, ending: str) -> None:
    source = write_video(tmp_path / f"walk{ending}")
    assert run(model_folder, source, tmp_path / "out").images == 5
    assert listed(tmp_path / "out") == ["walk_depth.mp4"]


@pytest.mark.parametrize("ending", [".ts", ".avi", ".mjpeg"])
def test_the_content_speaks_where_the_ending_does_not(tmp_path: Path, ending: str) -> None:
    video = write_video(tmp_path / f"walk{ending}")
    for name in ("walk.rec", "walk"):
        assert is_video_file(Path(shutil.copy(video, tmp_path / name)))
    for kind in ("png", "jpg"):
        picture = save(tmp_path / f"photo.{kind}", photo())
        assert not is_video_file(picture)
        assert not is_video_file(Path(shutil.copy(picture, tmp_path / f"photo of {kind}")))


def test_what_is_neither_is_told_what_is_taken(model_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("a walk through the house\n" * 100)  # a film of letters to FFmpeg
    assert cv2.imwrite(str(tmp_path / "photo.webp"), photo())  # OpenCV plays it, as a film of one picture
    for name in ("notes.txt", "photo.webp"):
        with pytest.raises(ValueError, match=r"neither a picture \(\.jpg, .* nor a video .*\.mp4, .*\.ts,"):
            run(model_folder, tmp_path / name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_camera_goes_by_any_name_of_its_device(tmp_path: Path) -> None:
    """Such as ``/dev/v4l/by-id/usb-...``, which stays the same when a second camera is plugged in."""
    (tmp_path / "front camera").symlink_to("/dev/null")
    assert is_live(tmp_path / "front camera")
    assert not is_live(save(tmp_path / "a.png", photo()))
    with pytest.raises(ValueError, match="no such camera"):
        DepthStream(tmp_path / "front camera", lambda frame: frame)


def test_a_film_of_a_phone_held_upright_stands_upright(model_folder: Path, tmp_path: Path) -> None:
    source = turn(write_video(tmp_path / "walk.mp4", frames=2))
    run(model_folder, source, tmp_path / "out", "formats=[depth]")
    depth = cv2.imread(str(tmp_path / "out/walk/000000_depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (64, 48)


# --- where it ends ---


@pytest.mark.parametrize("ending", CODECS)
def test_a_whole_file_is_not_called_cut(tmp_path: Path, ending: str) -> None:
    stream = stream_of(write_video(tmp_path / f"walk{ending}", frames=60))
    assert (len(stream.times), stream.ended_too_soon) == (60, "")  # type: ignore[attr-defined]


@pytest.mark.parametrize("ending", [".mp4", ".mkv", ".webm", ".avi", ".flv"])
def test_a_cut_file_is_called_cut(tmp_path: Path, ending: str) -> None:
    path = write_video(tmp_path / f"walk{ending}", frames=60)
    stream = stream_of(cut(index_first(path) if ending == ".mp4" else path, 0.6))
    came = len(stream.times)  # type: ignore[attr-defined]
    assert 20 < came < 40
    assert f"announces 60 frames, {came} could be read" in stream.ended_too_soon


@pytest.mark.parametrize("ending", [".mp4", ".avi"])
def test_a_hole_in_a_file_is_called_damage(tmp_path: Path, ending: str) -> None:
    path = write_video(tmp_path / f"walk{ending}", frames=60)
    content = bytearray(path.read_bytes())
    third, half = len(content) // 3, len(content) // 2
    content[third:half] = bytes(half - third)
    path.write_bytes(content)
    assert "cut or damaged" in stream_of(path).ended_too_soon


def test_a_trimmed_film_is_whole(model_folder: Path, tmp_path: Path) -> None:
    """A phone leaves the frames before the cut in the file, and in its count."""
    source = trim(write_video(tmp_path / "walk.mp4", frames=60), seconds=2.0)
    assert run(model_folder, source, tmp_path / "out").images == 36


def test_a_film_that_breaks_off_is_kept_and_the_command_fails(
    model_folder: Path, tmp_path: Path, run_command
) -> None:
    cut(write_video(tmp_path / "walk.mkv", frames=60), 0.6)
    done = run_command("predict", f"checkpoint={model_folder}", "source=walk.mkv", "output=out", cwd=tmp_path)
    frames = len(read_video(tmp_path / "out/walk_depth.mp4")[0])
    assert 20 < frames < 40
    assert f"{frames} frames of walk.mkv: color in out" in done.stdout
    assert f"error: walk.mkv is cut: it announces 60 frames, {frames} could be read; what" in done.stderr
    assert done.returncode == 1
    first = run_command(
        "predict", f"checkpoint={model_folder}", "source=walk.mkv", "output=ten", "frames=10", cwd=tmp_path
    )
    assert first.returncode == 0, first.stderr  # all that was asked for was there


# --- when its frames were taken ---


def test_a_file_joined_of_recordings_does_not_stand_still_between_them(tmp_path: Path) -> None:
    """A recorder was off for 80 s, or set its clock anew: its film would show one frame all that time."""
    path = write_video(tmp_path / "walk.ts", frames=100, rate=1.0)
    packets = [path.read_bytes()[at : at + 188] for at in range(0, path.stat().st_size, 188)]
    tenth = len(packets) // 10
    path.write_bytes(b"".join(packets[:tenth] + packets[-tenth:]))
    times = stream_of(path).times  # type: ignore[attr-defined]
    assert 15 <= len(times) <= 20
    np.testing.assert_allclose(np.diff(times), 1.0)
