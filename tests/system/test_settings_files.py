"""Settings and records are read in a moment: a hostile one is one line that names the file."""

from pathlib import Path

import pytest

from eldenet.system.files import MOST_YAML, parse_json, read_json, read_yaml, write_json, write_yaml


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 10_000, "nested too deep"),
        ("a: 2001-99-99", "month must be in 1..12"),
        ("a" * (MOST_YAML + 1), "more than the 1 MB allowed"),
        ("a: !!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("a: [", "parsing"),
    ],
)
def test_hostile_yaml_is_refused_in_one_line(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"study\.yaml can't be read as YAML: .*{reason}") as caught:
        read_yaml(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 200_000, "nested too deep"),
        ("[" * 60 + "]" * 60, "nested too deep"),
        ('{"epochs": 1' + 400 * "0" + "}", "int too large to convert to float"),
        ('{"epochs": 1', "Expecting"),
        ("", "Expecting value"),
    ],
)
def test_hostile_json_is_refused_in_one_line(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"run\.json can't be read as JSON: .*{reason}"):
        read_json(path)
    with pytest.raises(ValueError, match=rf"the notes can't be read as JSON: .*{reason}"):
        parse_json(text, "the notes")


def test_what_is_no_text_or_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\xff\xfe\0")
    for name in ("a", "none"):
        with pytest.raises(ValueError, match=f"{name} can't be read as JSON"):
            read_json(tmp_path / name)
        with pytest.raises(ValueError, match=f"{name} can't be read as YAML"):
            read_yaml(tmp_path / name)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    content = {"a": [1, 2.5, None, True, "x"], "b": {"c": 10**250}, "d": {}}
    write_json(tmp_path / "a.json", content)
    write_yaml(tmp_path / "a.yaml", content)
    assert read_json(tmp_path / "a.json") == content
    assert read_yaml(tmp_path / "a.yaml") == content
    (tmp_path / "b.yaml").write_text("a: &a {x: 1}\nb: {<<: *a, y: 2.5}\n")  # aliases are fine
    assert read_yaml(tmp_path / "b.yaml") == {"a": {"x": 1}, "b": {"x": 1, "y": 2.5}}
