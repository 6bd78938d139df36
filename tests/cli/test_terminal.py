"""What commands print arrives on any terminal, and ends quietly where nobody reads it."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eldenet.system.escaping import without_password
from eldenet.system.terminal import printable

PRINTS = "from eldenet.system.terminal import terminal\nwith terminal():\n    print('%s' * 99999)"


def run(code: str, redirect: str = "", **environment: str) -> subprocess.CompletedProcess[bytes]:
    words = ["sh", "-c", f'exec "$0" -c "$1" {redirect}', sys.executable, code]
    return subprocess.run(
        words, capture_output=True, check=False, timeout=60, env={**os.environ, **environment}
    )


def test_a_terminal_shows_what_its_encoding_has() -> None:
    for encoding in ("ascii", "cp1252", "utf-8"):
        done = run(PRINTS % "m█", PYTHONIOENCODING=encoding)
        assert (done.returncode, done.stderr) == (0, b"")
        shown = "m█" if encoding == "utf-8" else "m?"
        assert done.stdout.decode(encoding) == shown * 99999 + "\n"


@pytest.mark.parametrize("redirect", [">&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_closed_output_is_no_error_and_no_file_gets_its_number(redirect: str, tmp_path: Path) -> None:
    number = "print(file.fileno(), file=file)"
    code = f"{PRINTS % 'a'}\n    with open('{tmp_path}/number', 'w') as file:\n        {number}"
    assert run(code, redirect).returncode == 0
    assert int((tmp_path / "number").read_text()) > 2


def test_a_full_disk_behind_the_output_is_one_line() -> None:
    done = run(PRINTS % "a", ">/dev/full")
    line = "error: standard output cannot be written (No space left on device): nothing more is printed\n"
    assert (done.returncode, done.stderr.decode()) == (1, line)


def test_a_reader_that_leaves_ends_the_command_quietly() -> None:
    done = run(PRINTS % "a", "| head -c 1")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"a", b"")


def test_ctrl_c_ends_a_command_without_a_traceback() -> None:
    done = run(f"{PRINTS % 'a'}\n    raise KeyboardInterrupt")
    assert (done.returncode, done.stdout, done.stderr) == (130, b"a" * 99999 + b"\n", b"")


def test_names_of_files_move_no_cursor_and_start_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert printable("a\x1b[2J\r\nerror: b\u202e\u2028c\x9b") == "a [2J  error: b  c "
    tree = "a\nb: x. Expected tree:\nimages/a.jpg\ndepths/a\x07.png"
    assert printable(tree) == "a b: x. Expected tree:\nimages/a.jpg\ndepths/a .png"


def test_commands_print_no_control_character(run_command, tmp_path: Path) -> None:
    name = "odd\x1b[31m\n\u202ename"
    (tmp_path / name).mkdir()
    for words in (["predict", f"source={name}"], ["report", f"runs={name}"], ["train", f"{name}=3"],
                  ["check_data", "data=folder", f"data.root={name}"]):  # fmt: skip
        finished = run_command(*words)
        said = finished.stdout + finished.stderr
        assert finished.returncode == 1
        assert "odd [31m" in said
        assert all(sign == "\n" or sign.isprintable() for sign in said)
        assert "\nname" not in said


def test_what_is_logged_and_warned_of_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    done = run(
        "import logging, warnings\nfrom eldenet.system.terminal import log_in_lines, terminal\n"
        "logging.basicConfig()\nlog_in_lines()\nwith terminal():\n"
        "    logging.warning('a%s', '\\nb')\n    warnings.warn('c\\x1bd')"
    )
    assert done.stderr == b"WARNING:root:a b\nwarning: c d\n"
    assert not logging.root.filters


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("rtsp://admin:p@ss:w?rd@10.0.0.1:554/a/b@c", "rtsp://10.0.0.1:554/a/b@c"),
        ("rtsp://admin:p/ss@10.0.0.1/a", "rtsp://10.0.0.1/a"),
        ("http://h/a.mjpg?user=me&password=x&n=1", "http://h/a.mjpg?user=me&password=...&n=1"),
        ("http://h/a?Access_Token=x y", "http://h/a?Access_Token=... y"),
        ("http://h/a#token=x&n=1", "http://h/a#token=...&n=1"),
        ("rtsp://10.0.0.1/user=me_password=x_channel=1 y", "rtsp://10.0.0.1/user=me_password=... y"),
        ("camera:0", "camera:0"),
        ("rtsp://10.0.0.1/x", "rtsp://10.0.0.1/x"),
        ("a@b.mp4", "a@b.mp4"),
        ("http://host/me@home.mp4", "http://host/me@home.mp4"),
        ("rtsp://10.0.0.1:554/a@b", "rtsp://10.0.0.1:554/a@b"),
    ],
)
def test_an_address_is_shown_without_its_secrets(address: str, shown: str) -> None:
    assert without_password(address) == shown
    assert printable(f"source={address}: no") == f"source={shown}: no"


@pytest.mark.parametrize("source", ["rtsp://me:hidden@127.0.0.1:1/x", '"http://127.0.0.1:1/x?token=hidden"',
                                    "http://me:hidden@127.0.0.1:1/x?a=b&c={"])  # fmt: skip
def test_no_message_of_a_command_has_a_password(source: str, run_command) -> None:
    finished = run_command("predict", f"source={source}", "checkpoint=eldenet_s")
    assert finished.returncode == 1
    assert "error: source=" in finished.stderr
    assert "hidden" not in finished.stdout + finished.stderr
