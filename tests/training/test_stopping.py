"""After Ctrl-C or ``systemctl stop`` videos play, no file is half written, and the exit status tells."""

import signal
from pathlib import Path

import pytest
from support.films import read_video, write_video
from support.predicting import listed, photo, run, save

from eldenet.deploy.predictor import DepthPredictor
from eldenet.system.signals import GracefulStop


@pytest.fixture(autouse=True)
def default_signals():
    """Restore the signals' default actions: a suite that a shell starts with ``&`` ignores Ctrl-C."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        signal.signal(number, signal.default_int_handler if number is signal.SIGINT else signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def third_picture(monkeypatch: pytest.MonkeyPatch):
    """Return a function that arranges for a signal during the third prediction."""

    def arrange(number: signal.Signals) -> None:
        predict, seen = DepthPredictor.__call__, []

        def depth(predictor: DepthPredictor, frame, **camera):
            seen.append(frame)
            if len(seen) == 3:
                signal.raise_signal(number)
            return predict(predictor, frame, **camera)

        monkeypatch.setattr(DepthPredictor, "__call__", depth)

    return arrange


@pytest.mark.parametrize(
    ("number", "called"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP")]
)
def test_a_stopped_video_is_playable_up_to_there(
    model_folder: Path, tmp_path: Path, third_picture, capsys, number, called
) -> None:
    third_picture(number)
    handler = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt if called == "Ctrl-C" else SystemExit) as end:
        run(model_folder, write_video(tmp_path / "walk.mp4", 9), tmp_path / "out", "formats=[color,depth]")
    if called != "Ctrl-C":
        assert end.value.code == 128 + number
    assert signal.getsignal(number) == handler
    assert listed(tmp_path / "out") == ["walk", "walk_depth.mp4"]
    assert len(read_video(tmp_path / "out/walk_depth.mp4")[0]) == 3
    assert listed(tmp_path / "out/walk") == [f"00000{number}_depth.png" for number in range(3)]
    assert f"stopped by {called}: 3 frames of walk.mp4: color + depth in" in capsys.readouterr().out


def test_a_stopped_folder_reports_how_many_images_are_done(
    model_folder: Path, tmp_path: Path, third_picture, capsys
) -> None:
    third_picture(signal.SIGINT)
    for name in "abcde":
        save(tmp_path / f"in/{name}.png", photo())
    with pytest.raises(KeyboardInterrupt):
        run(model_folder, tmp_path / "in", tmp_path / "out")
    assert listed(tmp_path / "out") == [f"{name}_{kind}.png" for name in "abc" for kind in ("color", "depth")]
    assert "stopped by Ctrl-C: 3 of 5 pictures: depth + color in" in capsys.readouterr().out


def test_stopping_a_camera_is_success(model_folder: Path, tmp_path: Path, third_picture) -> None:
    """A camera has no other end."""
    third_picture(signal.SIGTERM)
    # frames that arrive too fast are dropped: enough for three predictions on a busy machine
    source = write_video(tmp_path / "walk.ts", 1500)
    results = run(model_folder, f"file://{source}", tmp_path / "out")  # type: ignore[arg-type]
    assert results.images == 3


def test_a_second_ctrl_c_interrupts_at_once() -> None:
    with GracefulStop() as stop:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        assert str(stop) == "SIGTERM"
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_ctrl_c_ends_the_command_with_status_130(model_folder: Path, tmp_path: Path, run_command) -> None:
    write_video(tmp_path / "walk.mp4", 1500)
    begun = "out/.walk_depth.*.part.mp4"
    done = run_command(
        "predict", f"checkpoint={model_folder}", "source=walk.mp4", "output=out", interrupt_at=begun
    )
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    frames = len(read_video(tmp_path / "out/walk_depth.mp4")[0])
    assert 1 <= frames < 1500
    assert f"stopped by Ctrl-C: {frames} frame" in done.stdout


@pytest.mark.slow
def test_ctrl_c_ends_render_processes_without_their_tracebacks(tmp_path: Path, command_server) -> None:
    rendered = "rooms/*/train.frames"
    words = ("data=rooms", "data.root=rooms")
    done = command_server.run("eldenet.check_data", words, tmp_path, interrupt_at=rendered, delay=2.0)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
