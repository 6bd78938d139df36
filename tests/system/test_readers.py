"""Text, JSON, YAML and CSV: what is damaged, hostile or too long is one line that names the file."""

import lzma
from pathlib import Path

import pytest

from eldenet.system.files import (
    MOST_YAML,
    parse_json,
    read_json,
    read_table,
    read_text,
    read_yaml,
    write_json,
    write_rows,
    write_text,
    write_yaml,
)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.txt", b"\xff\xfe", "can't decode byte"),
        ("a.txt", b"a\0b", "zero bytes"),
        ("a.txt.xz", lzma.compress(b"text")[:-8], "EOFError"),
        ("a.txt.xz", b"\x1f\x8b of gzip", "LZMAError"),
        ("a.yaml", b"[" * 10_000, "RecursionError"),
        ("a.yaml", b"a: 2001-99-99", "month must be in 1..12"),
        ("a.yaml", b"a" * (MOST_YAML + 1), "more than the 1 MB allowed"),
        ("a.yaml", b"a: !!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("a.yaml", b"a: [", "line 1: expected"),
        ("a.json", b"[" * 200_000, "RecursionError"),
        ("a.json", b"[" * 60 + b"]" * 60, "nested too deep"),
        ("a.json", b'{"epochs": 1' + 400 * b"0" + b"}", "int too large to convert to float"),
        ("a.json", b'{"epochs": 1', "Expecting"),
        ("a.json", b"", "Expecting value"),
        ("a.json", b"NaN", "NaN is not a number"),
        ("a.csv", b"name,rmse\na,1,2\n", "line 2 has more or fewer cells"),
        ("a.csv", b"name\na\n", "needs .'rmse'."),
        ("a.csv", b'name,rmse\n"a', "unexpected end of data"),
    ],
)
def test_what_is_damaged_or_hostile_is_one_line(
    name: str, content: bytes, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    readers = {
        ".yaml": read_yaml,
        ".json": read_json,
        ".csv": lambda path: read_table(path, ["name", "rmse"]),
    }
    read = readers.get(path.suffix, read_text)
    with pytest.raises(FileNotFoundError, match=rf"{path} does not exist: "):
        read(path)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"^{path} is truncated or not a valid [^\n]*({reason})[^\n]*$"):
        read(path)


def test_a_text_names_where_it_is_from() -> None:
    with pytest.raises(ValueError, match=r"^the notes is truncated or not a valid JSON file"):
        parse_json("{", "the notes")


def test_what_is_written_is_read(tmp_path: Path) -> None:
    content = {"a": [1, 2.5, None, True, "x"], "b": {"c": 10**250}, "d": {}}
    write_json(tmp_path / "a.json", content)
    write_yaml(tmp_path / "a.yaml", content)
    assert read_json(tmp_path / "a.json") == content
    assert read_yaml(tmp_path / "a.yaml") == content
    (tmp_path / "b.yaml").write_text("a: &a {x: 1}\nb: {<<: *a, y: 2.5}\n")  # aliases are fine
    assert read_yaml(tmp_path / "b.yaml") == {"a": {"x": 1}, "b": {"x": 1, "y": 2.5}}
    (tmp_path / "c.yaml").write_text("a: 1\nb: [2\nc: 3\n")
    with pytest.raises(ValueError, match=r"c\.yaml.*line 3: expected ',' or ']'"):
        read_yaml(tmp_path / "c.yaml")
    write_text(tmp_path / "c.txt.xz", "text")
    assert read_text(tmp_path / "c.txt.xz") == "text"
    write_rows(tmp_path / "d.csv", ["name", "rmse"], [["a", 1]])
    assert read_table(tmp_path / "d.csv", ["rmse"]) == [{"name": "a", "rmse": "1"}]
