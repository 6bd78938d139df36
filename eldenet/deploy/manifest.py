"""What calls of ``eldenet.predict`` wrote into a folder: ``overwrite=true`` removes that and nothing else."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Self, TextIO

LISTS = ".predict"  # in the results' folder: one list per call


class Written:
    """The list of one call's files. It grows as they are written, so that it holds after a power cut, too.

    Args:
        folder: of the results; the list is made with the first of them.
        kind: of source: "folder", "picture" or "video".
        names: of the results, by the pictures, or the video, that they are of.
        about: what else the list says of the call.

    Attributes:
        ended: how the call ended, for the list's last line.
    """

    def __init__(self, folder: Path, kind: str, names: Mapping[Path, str], about: Mapping[str, Any]) -> None:
        self.folder, self.kind, self.names, self.about = folder, kind, names, about
        self.ended: dict[str, Any] = {}
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        if self._file is not None:
            self._line({"ended": f"{kind.__name__}: {error}"} if kind is not None else self.ended)
            self._file.close()
            self._file = None

    def add(self, file: Path, name: str) -> None:
        """Note a file that was written whole, of the picture or video ``name``."""
        if self._file is None:
            now = datetime.now().astimezone()
            path = self.folder / LISTS / f"{now:%Y%m%d-%H%M%S-%f}-{os.getpid()}.jsonl"
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("x")
            self._line({"kind": self.kind, "date": now.isoformat(timespec="seconds"), **self.about})
        place = file.relative_to(self.folder).as_posix()
        self._line({"name": name, "file": place, "bytes": file.stat().st_size})

    def _line(self, content: Mapping[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(content) + "\n")
            self._file.flush()

    def remove_earlier(self) -> tuple[int, list[Path]]:
        """Remove what earlier calls wrote for the same pictures or video, in whatever formats.

        Of two folders that share a picture's name the earlier one's results go altogether: those of its other
        pictures would pass for results of this one. A file that has another size than it was written with
        was changed, and stays; so does what this call reads.

        Returns:
            How many files went, and those that stay because they were changed.
        """
        names, sources = set(self.names.values()), {path.resolve() for path in self.names}
        removed, changed = 0, []
        for path in sorted((self.folder / LISTS).glob("*.jsonl")):
            header, *entries = _lines(path) or [{}]
            if (header.get("kind") == "video") != (self.kind == "video"):
                continue
            gone = [entry for entry in entries if entry.get("name") in names]
            left = [entry for entry in entries if entry.get("name") not in names]
            if gone and header.get("kind") == self.kind == "folder":
                gone, left = entries, []
            for file, size in self._places(gone):
                if file.resolve() in sources or not file.is_file():
                    continue
                if file.stat().st_size == size:
                    file.unlink()
                    removed += 1
                    self._remove_empty(file.parent)
                else:
                    changed.append(file)
            if gone:
                _rewrite(path, [header, *left] if any("file" in entry for entry in left) else [])
        return removed, changed

    def _places(self, entries: Iterable[Mapping[str, Any]]) -> Iterator[tuple[Path, Any]]:
        """Path and size of the listed files; a list that was tampered with leads nowhere else."""
        inside = self.folder.resolve()
        for entry in entries:
            path = self.folder / str(entry.get("file", ""))
            if inside in path.resolve().parents and not path.is_symlink():
                yield path, entry.get("bytes")

    def _remove_empty(self, folder: Path) -> None:
        with suppress(OSError):  # not empty
            while folder != self.folder:
                folder.rmdir()
                folder = folder.parent


def _lines(path: Path) -> list[dict[str, Any]]:
    """Of a list; what a power cut left unfinished is passed over."""
    lines = []
    for line in path.read_text(errors="replace").splitlines():
        with suppress(json.JSONDecodeError):
            content = json.loads(line)
            if isinstance(content, dict):
                lines.append(content)
    return lines


def _rewrite(path: Path, lines: list[dict[str, Any]]) -> None:
    if not lines:
        path.unlink()
        return
    unfinished = path.with_name(f".{path.name}.part")
    unfinished.write_text("".join(json.dumps(line) + "\n" for line in lines))
    unfinished.replace(path)
