"""``overwrite=true`` removes what of an earlier call could pass for the new one's, and nothing else."""

import json
from pathlib import Path

import pytest
from support.films import write_video
from support.predicting import listed, photo, run, save


def test_a_shorter_video_leaves_no_frame_of_a_longer_one(model_folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    run(model_folder, write_video(tmp_path / "old/walk.mp4", frames=6), out, "formats=[color,depth]")
    (out / "walk/notes.txt").write_text("mine")
    (out / "walk/000009_depth.png").write_bytes(b"mine too, though it looks like one of theirs")
    (out / "walk/000005_depth.png").write_bytes(b"painted over")
    source = write_video(tmp_path / "new/walk.mp4", frames=2)
    run(model_folder, source, out, "formats=[depth]", "overwrite=true")
    assert listed(out) == ["walk"]  # the old film shows six frames
    assert listed(out / "walk") == [
        *("000000_depth.png", "000001_depth.png", "000005_depth.png", "000009_depth.png", "notes.txt")
    ]
    said = capsys.readouterr().out
    assert "removed 6 files of earlier calls" in said
    assert f"kept, as it was changed since an earlier call wrote it: {out}/walk/000005_depth.png\n" in said


def test_pictures_that_are_gone_leave_no_results(model_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for name in ("a.png", "b.png", "c.png", "hall/d.png"):
        save(tmp_path / "monday" / name, photo())
        save(tmp_path / "elsewhere" / name.replace(".", "2."), photo())
    for name in ("a.png", "b.png", "e.png"):
        save(tmp_path / "tuesday" / name, photo())
    run(model_folder, tmp_path / "elsewhere", out, "formats=[depth]")
    run(model_folder, tmp_path / "monday", out)
    damaged = tmp_path / "tuesday/b.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    run(model_folder, tmp_path / "tuesday", out, "formats=[depth]", "overwrite=true", "on_error=skip")
    others = ["a2_depth.png", "b2_depth.png", "c2_depth.png"]  # of a folder that shares no name
    assert listed(out) == sorted(["a_depth.png", "e_depth.png", "hall", *others])
    assert listed(out / "hall") == ["d2_depth.png"]


def test_one_picture_again_replaces_its_own_results_alone(model_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for name in ("a.png", "b.png"):
        save(tmp_path / "in" / name, photo())
    run(model_folder, tmp_path / "in", out)
    run(model_folder, tmp_path / "in/a.png", out, "formats=[depth]", "overwrite=true")
    assert listed(out) == ["a_depth.png", "b_color.png", "b_depth.png"]
    run(model_folder, write_video(tmp_path / "b.mp4", frames=1), out, "overwrite=true")
    assert listed(out) == ["a_depth.png", "b_color.png", "b_depth.mp4", "b_depth.png"]
    (tmp_path / "in/b.png").unlink()
    run(model_folder, tmp_path / "in", out, "formats=[depth]", "overwrite=true")
    assert listed(out) == ["a_depth.png", "b_color.png", "b_depth.mp4", "b_depth.png"]


def test_without_overwrite_nothing_goes(model_folder: Path, tmp_path: Path) -> None:
    out, source = tmp_path / "out", save(tmp_path / "a.png", photo())
    run(model_folder, source, out, "formats=[color]")
    run(model_folder, source, out, "formats=[depth]")
    assert listed(out) == ["a_color.png", "a_depth.png"]


def test_a_call_that_fails_takes_nothing_away(model_folder: Path, tmp_path: Path) -> None:
    out, source = tmp_path / "out", save(tmp_path / "a.png", photo())
    run(model_folder, source, out)
    source.write_bytes(source.read_bytes()[:200])
    with pytest.raises(ValueError, match="cut or damaged"):
        run(model_folder, source, out, "overwrite=true")
    assert listed(out) == ["a_color.png", "a_depth.png"]


def test_a_list_leads_nowhere_else(model_folder: Path, tmp_path: Path) -> None:
    """Results are copied from others, with their lists: those must not name what to remove elsewhere."""
    out, source = tmp_path / "out", save(tmp_path / "a.png", photo())
    (tmp_path / "precious.txt").write_text("mine")
    lists = out / ".predict"
    lists.mkdir(parents=True)
    (out / "link").symlink_to(tmp_path)
    entries = [{"name": "a", "file": file, "bytes": 4} for file in ("../precious.txt", "link/precious.txt")]
    lines = [json.dumps(line) for line in ({"kind": "picture"}, *entries)]
    (lists / "1.jsonl").write_text("\n".join([*lines, '{"name": "a", "fi']))  # as a power cut leaves it
    run(model_folder, source, out, "overwrite=true")
    assert (tmp_path / "precious.txt").is_file()


def test_a_list_says_what_made_the_files(model_folder: Path, tmp_path: Path) -> None:
    run(model_folder, save(tmp_path / "a.png", photo()), tmp_path / "out", "formats=[depth]")
    (path,) = (tmp_path / "out/.predict").iterdir()
    first, file, last = (json.loads(line) for line in path.read_text().splitlines())
    assert (first["source"], first["checkpoint"]) == (str(tmp_path / "a.png"), str(model_folder))
    size = (tmp_path / "out/a_depth.png").stat().st_size
    assert file == {"name": "a", "file": "a_depth.png", "bytes": size}
    assert last == {"ended": "complete", "images": 1}
