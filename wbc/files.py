"""The files that a model draws in, found and judged before MuJoCo opens any of them.

An MJCF file names others: `<include>`, `<model>`, meshes, textures, height fields, skins. MuJoCo looks for each beside
the main file, beside the file that names it and in the folders of `<compiler>`; here every place where any of them
might be found is looked at, so that what it may open is a part of what was judged. A file may be read where its real
place, symbolic links followed, is inside one of the `folders`.

So that MuJoCo's parser cannot read another text than this one, what the two might read differently is refused:
document types (and the entities that they define), encodings other than UTF-8, white space in names of files.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn
from xml.parsers import expat

from .errors import ModelError

MAX_XML, MAX_FILE = 16 * 2**20, 256 * 2**20  # [bytes] of an XML file, of a mesh or a picture
MAX_DEPTH, MAX_XMLS, MAX_PLACES = 200, 100, 200_000
MAX_COPIES, MAX_CELLS = 100_000, 10**8  # of a body or an element; of a height field or a texture
ROOTS = {".urdf": ("robot",), ".srdf": ("robot",)}  # any other: MJCF
MJCF = ("mujoco", "mujocoinclude")
_FOLDERS = ("assetdir", "meshdir", "texturedir")
_XMLS = ("include", "model")  # elements whose file is XML itself


class Element(NamedTuple):
    """The start of one element: where it stands, and how often the elements around it copy it."""

    file: Path
    line: int
    tag: str
    attributes: dict[str, str]
    copies: float

    @property
    def names(self) -> Iterator[str]:
        """The files that it names: `file`, and `fileup`, ... of a texture of six pictures."""
        for key, value in self.attributes.items():
            if key.startswith("file") and value:
                yield value

    def wrong(self, message: str) -> NoReturn:
        raise ModelError(f"{self.file}:{self.line}: {message}")


def elements(file: Path, folders: Sequence[Path] | None = None) -> list[Element]:
    """Every element of an XML file, judged alone. Raises ModelError, with the line."""
    within(file, folders)
    data = _read(file)
    parser, found, copies = expat.ParserCreate(), list[Element](), [1.0]

    def wrong(message: str) -> NoReturn:
        raise ModelError(f"{file}:{parser.CurrentLineNumber}: {message}")

    def declared(version: str, encoding: str | None, standalone: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "us-ascii", "ascii"):
            wrong(f"encoding {encoding[:40]!r}; expected UTF-8" if encoding else "expected UTF-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(copies) > MAX_DEPTH:
            wrong(f"nested more than {MAX_DEPTH} elements deep; expected a model")
        element = Element(file, parser.CurrentLineNumber, tag, attributes, copies[-1] * _copies(attributes))
        if len(copies) == 1 and tag not in ROOTS.get(file.suffix, MJCF):
            wrong(f"begins with <{tag[:40]}>; expected <{ROOTS.get(file.suffix, MJCF)[0]}>")
        _bounded(element)
        found.append(element)
        copies.append(element.copies)

    parser.XmlDeclHandler = declared
    parser.StartDoctypeDeclHandler = lambda *_: wrong("document types and entities are not read; expected plain XML")
    parser.StartElementHandler, parser.EndElementHandler = start, lambda tag: copies.pop()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        where = f"{file}:{error.lineno}"
        raise ModelError(f"{where}: not readable as XML: {expat.ErrorString(error.code)}; expected a model") from None
    return found


def judge(file: Path, folders: Sequence[Path] | None = None) -> None:
    """Look at everything that MuJoCo may read for this file. Raises ModelError, with the line that names it.

    `folders`: where files may be read, as `real` makes them; None: anywhere, and the rest is judged all the same.
    """
    seen = {file: elements(file, folders)}
    if file.suffix == ".urdf":
        return  # shapes and everything else that names a file are dropped before MuJoCo sees it
    todo = [file]
    while todo:
        todo = []
        bases, inside = _places(seen)
        for element in [element for one in list(seen.values()) for element in one if element.tag in _XMLS]:
            for name in element.names:
                for place in _existing(element, name, bases, inside, folders):
                    if place not in seen:
                        todo.append(place)
                        seen[place] = elements(place, folders)
                        if len(seen) > MAX_XMLS:
                            element.wrong(f"more than {MAX_XMLS} files of one model")
    bases, inside = _places(seen)
    every = [element for one in seen.values() for element in one]
    for element in every:
        if element.tag == "plugin" and folders is not None:
            element.wrong("plugins run code of their own, which no limit here holds; expected none, or --allow-outside")
    named = [(element, name) for element in every for name in element.names]
    if len(named) * len(bases) * (1 + len(inside)) > MAX_PLACES:
        named[0][0].wrong(f"more than {MAX_PLACES} places of files to look at; expected one model")
    for element, name in named:
        found = list(_existing(element, name, bases, inside, folders))
        if not found:
            element.wrong(
                f"<{element.tag}> names {_short(name)}, and there is no such file; expected one that is there"
            )
        for place in found:
            if os.path.getsize(place) > MAX_FILE:
                element.wrong(f"{_short(name)} is larger than {MAX_FILE // 2**20} MiB; expected a smaller one")


def readable(file: Path, folders: Sequence[Path] | None) -> bool:
    """Whether the file, links followed, is inside one of the folders; None: anywhere."""
    return folders is None or any(Path(os.path.realpath(file)).is_relative_to(folder) for folder in folders)


def within(file: Path, folders: Sequence[Path] | None) -> None:
    """Raises ModelError unless the file may be read."""
    if not readable(file, folders):
        where = f"inside {_short(str(folders[0]))}" if folders else "a shipped one"
        message = f"{_short(str(file))} is outside of the spec's folder, and is not read"
        raise ModelError(f"{message}; expected it {where}, or --allow-outside")


def real(folders: Iterable[Path]) -> tuple[Path, ...]:
    """The folders with symbolic links followed, each once."""
    return tuple(dict.fromkeys(Path(os.path.realpath(folder)) for folder in folders))


def _read(file: Path) -> bytes:
    if not file.is_file():
        raise ModelError(f"{file}: is not a regular file; expected a model")
    with file.open("rb") as stream:
        data = stream.read(MAX_XML + 1)
    if len(data) > MAX_XML:
        raise ModelError(f"{file}: larger than {MAX_XML // 2**20} MiB; expected a model")
    if b"\0" in data:
        raise ModelError(f"{file}: holds a zero byte; expected XML in UTF-8")
    return data


def _places(seen: dict[Path, list[Element]]) -> tuple[list[Path], list[str]]:
    """The folders of the files, and those that `<compiler>` names in any of them."""
    inside = [folder for one in seen.values() for element in one for folder in _inside(element)]
    return list(dict.fromkeys(file.parent for file in seen)), list(dict.fromkeys(inside))


def _existing(
    element: Element, name: str, bases: Iterable[Path], inside: Iterable[str], folders: Sequence[Path] | None
) -> Iterator[Path]:
    """Every file that MuJoCo may take for `name`. Raises ModelError for the first that may not be read."""
    if re.search(r"[\s\\]", name):
        element.wrong(f"<{element.tag}> names {_short(name)}; expected a name without spaces and backslashes")
    names = dict.fromkeys([name, name.rpartition("/")[2]])  # as it stands, and what `strippath` leaves of it
    for written in dict.fromkeys(base / folder / each for base in bases for folder in ("", *inside) for each in names):
        places = {os.path.realpath(place): place for place in (written, Path(os.path.normpath(written)))}
        for place in places.values():  # two where a link stands before `..`
            if not os.path.lexists(place) or place.is_dir():
                continue
            try:
                within(place, folders)
            except ModelError as error:
                element.wrong(str(error))
            if place.exists() and not place.is_file():
                element.wrong(f"{_short(name)} is not a regular file; expected a file")
            if place.is_file():
                yield place


def _inside(element: Element) -> Iterator[str]:
    for key in _FOLDERS:
        if folder := element.attributes.get(key):
            if re.search(r"[\s\\]", folder):
                element.wrong(f"{key} is {_short(folder)}; expected a name without spaces and backslashes")
            yield folder


def _numbers(attributes: dict[str, str], *keys: str) -> float:
    """The product of the numbers that some attributes hold; what is no number is left to MuJoCo."""
    found = re.findall(r"[0-9.]+(?:[eE]\+?[0-9]+)?", " ".join(attributes.get(key, "") for key in keys))
    try:
        return math.prod(max(1.0, float(number)) for number in found)
    except ValueError:
        return 1.0


def _copies(attributes: dict[str, str]) -> float:
    return _numbers(attributes, "count")


def _bounded(element: Element) -> None:
    if element.copies > MAX_COPIES:
        element.wrong(f"<{element.tag}> makes {element.copies:.3g} copies; expected {MAX_COPIES} at most")
    cells = max(_numbers(element.attributes, "nrow", "ncol"), _numbers(element.attributes, "width", "height"))
    if cells > MAX_CELLS:
        element.wrong(f"<{element.tag}> has {cells:.3g} cells; expected {MAX_CELLS:.0e} at most")


def _short(text: str) -> str:
    text = text if len(text) <= 120 else "..." + text[-117:]
    return repr(text)
