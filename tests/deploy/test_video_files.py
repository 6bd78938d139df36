"""The content of a file says whether it is a video, and whether it is whole."""

import shutil
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from support.films import CODECS, copy_packets, cut, read_video, trim, write_video
from support.predicting import listed, photo, run, save

from eldenet.deploy.stream import DepthStream, is_live
from eldenet.deploy.video_files import VideoFile, is_video_file


def stream_of(path: Path) -> tuple[list[float], str]:
    """Times of the frames [s], and why the file ended too soon."""
    with DepthStream(path, lambda frame: frame[..., 0].astype(np.float32)) as stream:
        times = [item.time for item in stream]
    return times, stream.ended_too_soon


@pytest.mark.parametrize("ending", [".ts", ".flv", ".wmv", ".3gp", ".mpeg", ".mjpeg", ".webm"])
def test_videos_of_any_ending_become_videos(model_folder: Path, tmp_path: Path, ending: str) -> None:
    source = write_video(tmp_path / f"walk{ending}")
    assert run(model_folder, source, tmp_path / "out").images == 5
    assert listed(tmp_path / "out") == ["walk_depth.mp4"]


@pytest.mark.parametrize("ending", [".ts", ".avi", ".mjpeg"])
def test_the_content_decides_where_the_ending_does_not(tmp_path: Path, ending: str) -> None:
    video = write_video(tmp_path / f"walk{ending}")
    for name in ("walk.rec", "walk"):
        assert is_video_file(Path(shutil.copy(video, tmp_path / name)))
    for kind in ("png", "jpg"):
        picture = save(tmp_path / f"photo.{kind}", photo())
        assert not is_video_file(picture)
        assert not is_video_file(Path(shutil.copy(picture, tmp_path / f"photo of {kind}")))


def test_the_error_for_other_files_lists_what_is_accepted(model_folder: Path, tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("a walk through the house\n" * 100)  # FFmpeg films its letters
    with pytest.raises(ValueError, match=r"neither a picture \(\.jpg, .* nor a video .*\.mp4, .*\.ts,"):
        run(model_folder, notes, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_without_pictures_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mov").write_text(";FFMETADATA1\ntitle=walk\n")
    with pytest.raises(ValueError, match=r"a.mov .*it holds no pictures"):
        VideoFile(tmp_path / "a.mov")


def test_a_camera_has_any_name_of_its_device(tmp_path: Path) -> None:
    """Such as ``/dev/v4l/by-id/usb-...``, which stays the same when a second camera is plugged in."""
    (tmp_path / "front camera").symlink_to("/dev/null")
    assert is_live(tmp_path / "front camera")
    assert not is_live(save(tmp_path / "a.png", photo()))
    with pytest.raises(ValueError, match="no such camera"):
        DepthStream(tmp_path / "front camera", lambda frame: frame)


@pytest.mark.parametrize("ending", CODECS)
def test_a_whole_file_gives_all_frames_and_no_fault(tmp_path: Path, ending: str) -> None:
    times, fault = stream_of(write_video(tmp_path / f"walk{ending}", frames=60))
    assert (len(times), fault) == (60, "")


@pytest.mark.parametrize(
    ("ending", "share"),
    [
        (".mp4", 0.6),
        (".mkv", 0.6),
        (".webm", 0.6),
        (".avi", 0.6),
        (".flv", 0.6),
        (".mp4", 0.97),
        (".mkv", 0.97),
    ],
)
def test_a_cut_file_is_reported(tmp_path: Path, ending: str, share: float) -> None:
    path = write_video(tmp_path / f"walk{ending}", frames=60)
    if ending == ".mp4":
        copy_packets(path, movflags="faststart")  # else the index at the end is lost
    times, fault = stream_of(cut(path, share))
    assert 20 < len(times) < (40 if share == 0.6 else 60)
    assert fault == f"is truncated or damaged: {len(times)} of 60 frames could be read"


@pytest.mark.parametrize("ending", [".mp4", ".avi"])
def test_a_hole_in_a_file_is_reported(tmp_path: Path, ending: str) -> None:
    path = write_video(tmp_path / f"walk{ending}", frames=60)
    content = bytearray(path.read_bytes())
    third, half = len(content) // 3, len(content) // 2
    content[third:half] = bytes(half - third)
    path.write_bytes(content)
    times, fault = stream_of(path)
    assert len(times) > 40  # frames behind the hole are read too
    assert "truncated or damaged" in fault


def test_a_trimmed_video_is_whole(tmp_path: Path) -> None:
    """A phone leaves the frames before the cut in the file, and in its count."""
    times, fault = stream_of(trim(write_video(tmp_path / "walk.mp4", frames=60), seconds=2.0))
    assert (len(times), fault) == (36, "")


def test_the_frames_of_a_cut_video_are_kept_and_the_command_fails(
    model_folder: Path, tmp_path: Path, run_command
) -> None:
    cut(write_video(tmp_path / "walk.mkv", frames=60), 0.6)
    done = run_command("predict", f"checkpoint={model_folder}", "source=walk.mkv", "output=out", cwd=tmp_path)
    frames = len(read_video(tmp_path / "out/walk_depth.mp4")[0])
    assert 20 < frames < 40
    assert f"{frames} frames of walk.mkv: color in out" in done.stdout
    assert (
        f"error: walk.mkv is truncated or damaged: {frames} of 60 frames could be read; earlier"
        in done.stderr
    )
    assert done.returncode == 1
    first = run_command(
        "predict", f"checkpoint={model_folder}", "source=walk.mkv", "output=ten", "frames=10", cwd=tmp_path
    )
    assert first.returncode == 0, first.stderr  # all frames that were asked for are there


def test_joined_recordings_play_on_without_a_gap(tmp_path: Path) -> None:
    """A recorder that was off for 80 s would otherwise show one frame all that time."""
    path = write_video(tmp_path / "walk.ts", frames=100, rate=1.0)
    packets = [path.read_bytes()[at : at + 188] for at in range(0, path.stat().st_size, 188)]
    tenth = len(packets) // 10
    path.write_bytes(b"".join(packets[:tenth] + packets[-tenth:]))
    times, _ = stream_of(path)
    assert 15 <= len(times) <= 20
    np.testing.assert_allclose(np.diff(times), 1.0)


def test_frames_keep_the_uneven_times_that_a_file_states(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / "walk.mkv"), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in (0, 1, 2, 8, 9):
            frame = av.VideoFrame.from_ndarray(np.roll(photo(), number, axis=1), "rgb24")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    np.testing.assert_allclose(stream_of(tmp_path / "walk.mkv")[0], [0, 0.04, 0.08, 0.32, 0.36])


MATRICES = {  # a, b, c, d of a display matrix: a point (x, y) is shown at (a x + c y, b x + d y)
    (1, 0, 0, 1): lambda a: a,
    (-1, 0, 0, 1): lambda a: a[:, ::-1],
    (1, 0, 0, -1): lambda a: a[::-1],
    (-1, 0, 0, -1): lambda a: a[::-1, ::-1],
    (0, 1, -1, 0): lambda a: np.rot90(a, -1),
    (0, -1, 1, 0): np.rot90,
    (0, 1, 1, 0): lambda a: a.swapaxes(0, 1),
    (0, -1, -1, 0): lambda a: a.swapaxes(0, 1)[::-1, ::-1],
}


@pytest.mark.parametrize("matrix", MATRICES)
def test_a_video_is_turned_and_mirrored_as_its_matrix_says(tmp_path: Path, matrix: tuple[int, ...]) -> None:
    path = write_video(tmp_path / "walk.mp4", frames=2)
    stored = [frame for frame, _ in VideoFile(path).frames()]
    content = bytearray(path.read_bytes())
    a, b, c, d = (65536 * number for number in matrix)
    at = content.index(b"tkhd") + 4 + 40  # of a track header in version 0
    assert struct.unpack_from(">9i", content, at)[::4] == (65536, 65536, 1 << 30)
    struct.pack_into(">9i", content, at, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    shown = [frame for frame, _ in VideoFile(path).frames()]
    np.testing.assert_array_equal(shown, [MATRICES[matrix](frame) for frame in stored])


@pytest.mark.parametrize(("aspect", "width"), [("4/3", 85), ("8/9", 57), ("1/1", 64), ("900/1", 64)])
def test_pixels_become_square(tmp_path: Path, aspect: str, width: int) -> None:
    path = tmp_path / "walk.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(aspect)
        for _ in range(2):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(photo(48, 64), "rgb24")))
        container.mux(stream.encode())
    assert {frame.shape for frame, _ in VideoFile(path).frames()} == {(48, width, 3)}
