"""YAML text -> a tree of plain values that remembers where every key stands.

A subset of YAML 1.2: one document of mappings with text keys, lists and scalars; no aliases, anchors, merge keys or
tags. The tree is built from parser events without recursion, so size, depth and count are refused before they cost.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import yaml

from ..errors import Fault, SpecError, did_you_mean

KeyPath = tuple[str | int, ...]
Message = tuple[KeyPath, str]  # where something is wrong, and what
Mark = tuple[int, int]  # line and column, from 1

MAX_BYTES = 256 * 1024
MAX_DEPTH = 32
MAX_VALUES = 10_000
MAX_FAULTS = 100

# libyaml is some twenty times faster; what it and the Python parser read differently is checked here, before and after
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")

_WORDS: dict[str, bool | None] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile("[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def scalar(text: str) -> bool | int | float | str | None:
    """What a plain (unquoted) scalar means in YAML 1.2: 1e3 is a number; on, yes and 12:30 are texts; 010 is ten."""
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _NOT_FINITE.fullmatch(text) else text


def dotted(path: Iterable[str | int]) -> str:
    """tasks.press.damping[2]; parts are shortened and escaped, so that a message is always one printable line."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{printable(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def printable(text: str, most: int = 60) -> str:
    text = text if len(text) <= most else text[: most - 3] + "..."
    return text if text.isprintable() else repr(text)[1:-1]


class NoSuchKey(LookupError):
    """A path that leads nowhere: where it ends, and why."""

    def __init__(self, path: KeyPath, message: str) -> None:
        self.path, self.message = path, message
        super().__init__(message)


def put(
    tree: Any, path: KeyPath, value: Any, sections: Collection[KeyPath] = (), above: KeyPath = ()
) -> tuple[Any, KeyPath]:
    """A copy of the tree with one value changed, and the path with its list positions as integers.

    Every key but the last must be there, or be one of `sections`, which are made when absent.
    """
    if not path:
        return value, above
    place: Any = path[0]
    here, copy = (
        (*above, place),
        dict(tree) if isinstance(tree, Mapping) else list(tree) if isinstance(tree, list | tuple) else tree,
    )
    if isinstance(copy, list):
        place = int(place) if re.fullmatch("[0-9]{1,5}", str(place)) else -1
        if not 0 <= place < len(copy):
            raise NoSuchKey(here, f"expected a position from 0 to {len(copy) - 1}")
    elif not isinstance(copy, dict):
        raise NoSuchKey(above, f"is {printable(repr(tree))}, which has no keys of its own")
    elif len(path) > 1 and place not in copy:
        if here not in sections:
            raise NoSuchKey(here, f"no such key{did_you_mean(str(place), map(str, copy))}")
        copy[place] = {}
    inner = copy[place] if len(path) > 1 else None
    copy[place], done = put(inner, path[1:], value, sections, (*above, place))
    return copy, done


@dataclass(frozen=True)
class Source:
    """A tree and where it comes from: keys of a file by `marks`, values of `--set` by `origins`."""

    file: str = "spec"
    tree: Any = None
    marks: Mapping[KeyPath, Mark] = field(default_factory=dict)
    origins: Mapping[KeyPath, str] = field(default_factory=dict)
    found: tuple[Fault, ...] = ()  # what was wrong but could be read past
    blind: frozenset[KeyPath] = frozenset()  # where the value is not what was written; nothing more is said there

    def fault(self, path: KeyPath, message: str) -> Fault:
        """A fault at the nearest enclosing key that exists."""
        for length in range(len(path), -1, -1):
            if origin := self.origins.get(path[:length]):
                return Fault(origin, 0, 0, dotted(path), message)
            if mark := self.marks.get(path[:length]):
                return Fault(self.file, *mark, dotted(path), message)
        return Fault(self.file, 0, 0, dotted(path), message)

    def error(self, messages: Iterable[Message] = ()) -> SpecError:
        """Everything found while reading and afterwards, at most MAX_FAULTS of it."""
        seen = [message for message in messages if not any(message[0][: len(path)] == path for path in self.blind)]
        error = SpecError([*self.found, *(self.fault(*message) for message in dict.fromkeys(seen))])
        if len(error.faults) <= MAX_FAULTS:
            return error
        shown = error.faults[:MAX_FAULTS]
        return SpecError([*shown, replace(shown[-1], key="", message="there are more faults, which are not shown")])

    def whole(self) -> Source:
        """The source, if nothing was wrong while reading it."""
        if self.found:
            raise self.error()
        return self

    def override(self, text: str, sections: Collection[KeyPath] = ()) -> Source:
        """The source with one `key.path=value` applied; the value is a YAML scalar, [list] or {mapping}."""
        label = f"--set {printable(text)}"
        key, sign, value = (part.strip() for part in text.partition("="))
        path: KeyPath = tuple(key.split("."))

        def wrong(message: str, at: KeyPath = path) -> Source:
            return replace(self, found=(*self.found, Fault(label, 0, 0, dotted(at), message)))

        if not sign or not key:
            return wrong("expected key.path=value", ())
        if path[0] == "expect":
            return wrong("bounds cannot be changed from the command line; change them in the file")
        try:
            given = parse(value, label).whole().tree
            changed, path = put(self.tree, path, given, sections)
        except SpecError as error:
            return wrong(error.faults[0].message)
        except NoSuchKey as missing:
            return wrong(missing.message, missing.path)
        if isinstance(given, dict | list) and value[0] not in "[{":
            return wrong("expected a number, a text, [a list] or {a: mapping}")
        marks = {place: mark for place, mark in self.marks.items() if place[: len(path)] != path}
        origins = {place: origin for place, origin in self.origins.items() if place[: len(path)] != path}
        return replace(self, tree=changed, marks=marks, origins=origins | {path: label})


@dataclass
class _Frame:
    """A mapping or list that is being filled."""

    path: KeyPath
    value: dict[str, Any] | list[Any]
    key: str | None = None  # whose value comes next
    lines: dict[str, int] = field(default_factory=dict)


class _Tree:
    """Consumes parser events, one at a time."""

    def __init__(self, file: str) -> None:
        self.file, self.root, self.count = file, None, 0
        self.marks: dict[KeyPath, Mark] = {}
        self.found: list[Fault] = []
        self.blind: set[KeyPath] = set()
        self.stack: list[_Frame] = []

    def add(self, event: yaml.Event) -> None:
        mark = _place(event.start_mark)
        if isinstance(event, yaml.DocumentStartEvent) and self.count:
            self.stop(mark, "a second document begins here; a spec is one document")
        elif isinstance(event, yaml.CollectionEndEvent):
            self.stack.pop()
        elif isinstance(event, yaml.NodeEvent):
            self.count += 1
            if self.count > MAX_VALUES:
                self.stop(mark, f"more than {MAX_VALUES} keys and values")
            frame = self.stack[-1] if self.stack else None
            if frame and isinstance(frame.value, dict) and frame.key is None:
                self._key(event, mark, frame)
            else:
                self._value(event, mark, frame)

    def stop(self, mark: Mark, message: str) -> NoReturn:
        raise SpecError([*self.found, Fault(self.file, *mark, "", message)])

    def _report(self, path: KeyPath, message: str, mark: Mark, blind: bool = True) -> None:
        self.found.append(Fault(self.file, *mark, dotted(path), message))
        self.blind |= {path} if blind else set()

    def _key(self, event: yaml.NodeEvent, mark: Mark, frame: _Frame) -> None:
        if not isinstance(event, yaml.ScalarEvent):
            self.stop(mark, "expected a plain name as a key, got an alias, a list or a mapping")
        frame.key = key = event.value
        path = (*frame.path, key)
        if key == "<<":
            self._report(path, "merge keys are not supported; write the keys out", mark)
        elif key in frame.lines:
            self._report(path, f"given twice; first on line {frame.lines[key]}", mark, blind=False)
        frame.lines.setdefault(key, mark[0])
        self._enter(event, path, mark)

    def _value(self, event: yaml.NodeEvent, mark: Mark, frame: _Frame | None) -> None:
        path: KeyPath = ()
        if frame:
            path = (*frame.path, len(frame.value) if frame.key is None else frame.key)
        self._enter(event, path, mark)
        value: Any = None
        if isinstance(event, yaml.ScalarEvent):
            value = scalar(event.value) if event.implicit[0] and not event.style else event.value
        elif isinstance(event, yaml.CollectionStartEvent):
            value = {} if isinstance(event, yaml.MappingStartEvent) else []
            self.stack.append(_Frame(path, value))
            if len(self.stack) > MAX_DEPTH:
                self.stop(mark, f"nested more than {MAX_DEPTH} levels deep")
        if frame is None:
            self.root = value
        elif isinstance(frame.value, list):
            frame.value.append(value)
        else:
            frame.value.setdefault(frame.key or "", value)  # of a key given twice the first value stays
            frame.key = None

    def _enter(self, event: yaml.NodeEvent, path: KeyPath, mark: Mark) -> None:
        """Remember the place of a key or value, and refuse what the subset leaves out."""
        self.marks.setdefault(path, mark)
        if isinstance(event, yaml.AliasEvent):
            self._report(path, f"aliases (*{event.anchor}) are not supported; write the value out", mark)
        elif event.anchor is not None:
            self._report(path, f"anchors (&{event.anchor}) are not supported", mark, blind=False)
        if (tag := getattr(event, "tag", None)) is not None:
            self._report(path, f"tags ({printable(tag)}) are not supported; write the plain value", mark)
        if bad := _UNPRINTABLE.search(getattr(event, "value", "")):
            self._report(path, f"control character {bad[0]!r} in a text", mark)


def parse(data: bytes | str, file: str) -> Source:
    """Read one document. What cannot be read past raises SpecError; the rest stands in `found`."""
    tree, text = _Tree(file), _text(data, file)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            tree.add(event)
    except yaml.MarkedYAMLError as error:
        begun = f" {error.context} that begins on line {_place(error.context_mark)[0]}" if error.context_mark else ""
        tree.stop(_place(error.problem_mark), f"not readable as YAML: {error.problem}{begun}")
    except yaml.YAMLError as error:
        tree.stop((1, 1), f"not readable as YAML: {printable(str(error), 200)}")
    return Source(file, tree.root, tree.marks, {}, tuple(tree.found), frozenset(tree.blind))


def _place(mark: Any) -> Mark:
    return (mark.line + 1, mark.column + 1) if mark else (1, 1)


def _text(data: bytes | str, file: str) -> str:
    """Decoded and printable text, or a fault at the first byte that is neither."""

    def wrong(before: str, message: str) -> SpecError:
        *lines, last = re.split("\r\n|\r|\n", before)
        return SpecError([Fault(file, len(lines) + 1, len(last) + 1, "", message)])

    if len(data) > MAX_BYTES:
        raise wrong("", f"larger than {MAX_BYTES // 1024} KiB, which no spec is")
    try:
        text = data if isinstance(data, str) else data.decode()
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()
        raise wrong(before, f"byte 0x{error.object[error.start]:02x} is not UTF-8; save the file as UTF-8") from None
    if bad := _UNPRINTABLE.search(text):
        what = "a byte order mark; save the file without it" if bad[0] == "\ufeff" else f"control character {bad[0]!r}"
        raise wrong(text[: bad.start()], what)
    return text
