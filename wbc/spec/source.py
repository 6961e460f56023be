"""YAML text -> a tree of plain values that remembers where every key stands.

A subset of YAML 1.2: one document of mappings with text keys, lists and scalars; no aliases, anchors, merge keys or
tags. The tree is built from parser events, so that size, depth and count are refused before they cost.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any, NoReturn

import yaml

from ..errors import Fault, SpecError, did_you_mean

KeyPath = tuple[str | int, ...]
Message = tuple[KeyPath, str]  # where something is wrong, and what
Place = tuple[str, int, int]  # a file or a `--set`, line and column from 1 or 0

MAX_BYTES = 256 * 1024
MAX_DEPTH = 32
MAX_VALUES = 10_000
MAX_FAULTS = 100
MAX_MESSAGE = 1000
TINY, HUGE = 1e-30, 1e30  # of numbers: a few multiplied stay finite

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


# --- A tree, its places, and changes to it ----------------------------------------------------------------------------


class NoSuchKey(LookupError):
    """A path that leads nowhere: where it ends, and why."""

    def __init__(self, path: KeyPath, message: str) -> None:
        self.path, self.message = path, message
        super().__init__(message)


def put(
    tree: Any, path: KeyPath, value: Any, new: Collection[KeyPath] = (), above: KeyPath = ()
) -> tuple[Any, KeyPath]:
    """A copy of the tree with one value changed, and the path with its list positions as integers.

    Every key but the last must be there, or be one of `new`, which are made when absent.
    """
    if not path:
        return value, above
    key, here = path[0], (*above, path[0])
    copy: Any
    if isinstance(tree, list | tuple):
        copy, key = list(tree), int(key) if re.fullmatch("[0-9]{1,5}", str(key)) else -1
        if not 0 <= key < len(copy):
            raise NoSuchKey(here, f"expected a position from 0 to {len(copy) - 1}")
        inner = copy[key]
    elif isinstance(tree, Mapping):
        copy, inner = dict(tree), tree.get(key, {})
        if key not in copy and path[1:] and here not in new:
            hint = did_you_mean(str(key), map(str, copy)) or "; expected one that is there to be changed"
            raise NoSuchKey(here, f"no such key{hint}")
    else:
        raise NoSuchKey(above, f"is {printable(repr(tree))}, which has no keys of its own")
    copy[key], done = put(inner, path[1:], value, new, (*above, key))
    return copy, done


@dataclass(frozen=True)
class Source:
    """A tree and where each of its keys comes from."""

    file: str = "spec"
    tree: Any = None
    places: Mapping[KeyPath, Place] = field(default_factory=dict)
    found: tuple[Fault, ...] = ()  # what was wrong but could be read past
    blind: frozenset[KeyPath] = frozenset()  # where the value is not what was written; nothing more is said there
    allow_outside: bool = False  # whether the models that it names may stand outside of its folder

    def fault(self, path: KeyPath, message: str) -> Fault:
        """A fault at the nearest enclosing key that exists."""
        above = (path[:length] for length in range(len(path), -1, -1))
        place = next((self.places[key] for key in above if key in self.places), (self.file, 0, 0))
        if len(message) > MAX_MESSAGE:  # a name of any length may be quoted in it; what to do stands at the end
            message = f"{message[: MAX_MESSAGE // 2]} ... {message[-MAX_MESSAGE // 2 :]}"
        return Fault(*place, dotted(path), message)

    def error(self, messages: Iterable[Message] = ()) -> SpecError:
        """Everything found while reading and afterwards, at most MAX_FAULTS of it."""
        seen = [message for message in messages if not any(message[0][: len(path)] == path for path in self.blind)]
        error = SpecError([*self.found, *(self.fault(*message) for message in dict.fromkeys(seen))])
        if len(error.faults) <= MAX_FAULTS:
            return error
        shown = error.faults[:MAX_FAULTS]
        return SpecError(
            [
                *shown,
                replace(
                    shown[-1],
                    key="",
                    message="there are more faults, which are not shown; expected these to be mended first",
                ),
            ]
        )

    def whole(self) -> Source:
        """The source, if nothing was wrong while reading it."""
        if self.found:
            raise self.error()
        return self

    def override(self, text: str, new: Collection[KeyPath] = ()) -> Source:
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
            if isinstance(given, dict | list) and value[0] not in "[{":
                return wrong("expected a number, a text, [a list] or {a: mapping}")
            tree, path = put(self.tree, path, given, new)
        except SpecError as error:
            return wrong(error.faults[0].message)
        except NoSuchKey as missing:
            return wrong(missing.message, missing.path)
        places = {at: place for at, place in self.places.items() if at[: len(path)] != path}
        return replace(self, tree=tree, places=places | {path: (label, 0, 0)})


# --- Reading ----------------------------------------------------------------------------------------------------------


class _Reader:
    """Makes the tree from parser events. MAX_DEPTH bounds the recursion."""

    def __init__(self, file: str, events: Iterator[yaml.Event]) -> None:
        self.file, self.events, self.count = file, events, 0
        self.places: dict[KeyPath, Place] = {}
        self.found: list[Fault] = []
        self.blind: set[KeyPath] = set()

    def document(self) -> Any:
        tree: Any = None
        for event in self.events:
            if isinstance(event, yaml.DocumentStartEvent) and self.count:
                self.stop(event.start_mark, "a second document begins here; a spec is one document")
            if isinstance(event, yaml.NodeEvent):
                tree = self._value(event, ())
        return tree

    def stop(self, mark: Any, message: str) -> NoReturn:
        raise SpecError([*self.found, Fault(*self.place(mark), "", message)])

    def place(self, mark: Any) -> Place:
        return (self.file, mark.line + 1, mark.column + 1) if mark else (self.file, 1, 1)

    def _value(self, event: Any, path: KeyPath) -> Any:
        self._enter(event, path)
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, path)
        if isinstance(event, yaml.AliasEvent):
            return None
        if len(path) >= MAX_DEPTH:
            self.stop(event.start_mark, f"nested more than {MAX_DEPTH} levels deep")
        inner = takewhile(lambda each: not isinstance(each, yaml.CollectionEndEvent), self.events)
        if isinstance(event, yaml.SequenceStartEvent):
            return [self._value(each, (*path, place)) for place, each in enumerate(inner)]
        tree: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for each in inner:
            key = self._key(each, path, lines)
            tree.setdefault(key, self._value(next(self.events), (*path, key)))  # of a key given twice the first stays
        return tree

    def _scalar(self, event: yaml.ScalarEvent, path: KeyPath) -> Any:
        value = scalar(event.value) if event.implicit[0] and not event.style else event.value
        if isinstance(value, float) and value and math.isfinite(value) and not TINY <= abs(value) <= HUGE:
            self._report(event, path, f"expected 0 or a size from {TINY:g} to {HUGE:g}, got {value:g}")
        return value

    def _key(self, event: Any, path: KeyPath, lines: dict[str, int]) -> str:
        if not isinstance(event, yaml.ScalarEvent):
            self.stop(event.start_mark, "expected a plain name as a key, got an alias, a list or a mapping")
        key: str = event.value
        if key == "<<":
            self._report(event, (*path, key), "merge keys are not supported; write the keys out")
        elif key in lines:
            self._report(event, (*path, key), f"given twice; first on line {lines[key]}", blind=False)
        lines.setdefault(key, self.place(event.start_mark)[1])
        self._enter(event, (*path, key))
        return key

    def _enter(self, event: Any, path: KeyPath) -> None:
        """Remember the place of a key or value, and refuse what the subset leaves out."""
        self.places.setdefault(path, self.place(event.start_mark))
        self.count += 1
        if self.count > MAX_VALUES:
            self.stop(event.start_mark, f"more than {MAX_VALUES} keys and values")
        if isinstance(event, yaml.AliasEvent):
            self._report(event, path, f"aliases (*{event.anchor}) are not supported; write the value out")
        elif event.anchor is not None:
            self._report(event, path, f"anchors (&{event.anchor}) are not supported", blind=False)
        if (tag := getattr(event, "tag", None)) is not None:
            self._report(event, path, f"tags ({printable(tag)}) are not supported; write the plain value")
        if bad := _UNPRINTABLE.search(getattr(event, "value", "")):
            self._report(event, path, f"control character {bad[0]!r} in a text")

    def _report(self, event: Any, path: KeyPath, message: str, blind: bool = True) -> None:
        self.found.append(Fault(*self.place(event.start_mark), dotted(path), message))
        self.blind |= {path} if blind else set()


def parse(data: bytes | str, file: str) -> Source:
    """Read one document. What cannot be read past raises SpecError; the rest stands in `found`."""
    reader = _Reader(file, yaml.parse(_text(data, file), Loader=_LOADER))
    try:
        tree = reader.document()
    except yaml.MarkedYAMLError as error:
        begun = (
            f" {error.context} that begins on line {reader.place(error.context_mark)[1]}" if error.context_mark else ""
        )
        reader.stop(error.problem_mark, f"not readable as YAML: {error.problem}{begun}")
    except yaml.YAMLError as error:
        reader.stop(None, f"not readable as YAML: {printable(str(error), 200)}")
    return Source(file, tree, reader.places, tuple(reader.found), frozenset(reader.blind))


def _text(data: bytes | str, file: str) -> str:
    """Decoded and printable text, or a fault at the first byte that is neither."""
    if len(data) > MAX_BYTES:
        raise SpecError([Fault(file, 1, 1, "", f"larger than {MAX_BYTES // 1024} KiB, which no spec is")])
    text = data if isinstance(data, str) else data.decode(errors="surrogateescape")
    if bad := _UNPRINTABLE.search(text):
        what = f"control character {bad[0]!r}"
        if bad[0] == "\ufeff":
            what = "a byte order mark; save the file without it"
        if "\udc80" <= bad[0] <= "\udcff":  # stands for a byte that could not be decoded
            what = f"byte 0x{ord(bad[0]) - 0xDC00:02x} is not UTF-8; save the file as UTF-8"
        *lines, last = re.split("\r\n|\r|\n", text[: bad.start()])
        raise SpecError([Fault(file, len(lines) + 1, len(last) + 1, "", what)])
    return text
