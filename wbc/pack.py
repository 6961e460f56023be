"""Values as a structure that JSON can hold and float64 numbers: exact to the bit, and to read them executes nothing.

A structure is null, true, false, the name of a number ("f", "i", "F"), or a list that begins with what it is: `a` an
array of float64 and its shape, `A` one in Fortran's order, `b` another array, `s` a text, `t` a tuple, `l` a list,
`d` a mapping, `n` a record with its fields, `e` a member of an enumeration, `?` something that cannot be kept, of
which the type is told. The numbers stand beside it in the same order. Values of one kind have one structure, which is
kept once.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, get_args, get_type_hints

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .qp import Array

Structure = Any  # of tuples, hashable; or of lists, as JSON gives it back

_FLOAT64 = np.dtype(np.float64)
_EXACT = 2**53  # integers up to here are float64
_PLAIN = "biufc"  # kinds of arrays that hold numbers alone
_SIZES = {"f": 1, "F": 1, "i": 1, "T": 12}


class Foreign:
    """Stands for an argument that could not be kept, and is as useless to a controller; `told`: its type's name."""

    def __init__(self, told: str) -> None:
        self.told = told

    def __repr__(self) -> str:
        return f"<{self.told}>"


class Codec:
    """Packs and unpacks values; `roots`: the records it knows, with all that their fields may hold."""

    def __init__(self, *roots: type) -> None:
        self._known = {each.__name__: each for each in _reached(roots)}
        self._names = {each: name for name, each in self._known.items()}
        self._fields = {each: () if issubclass(each, Enum) else _fields(each) for each in self._names}

    def pack(self, value: Any, numbers: array[float]) -> Structure:
        """The structure of a value, whose numbers are appended."""
        kind = type(value)
        if kind is np.ndarray and value.dtype is _FLOAT64:
            if value.flags.c_contiguous or not value.flags.f_contiguous:
                numbers.frombytes(value.tobytes())
                return ("a", *value.shape)
            numbers.frombytes(value.tobytes("F"))
            return ("A", *value.shape)
        if value is None or kind is bool:
            return value
        if kind is float or kind is np.float64:
            numbers.append(value)
            return "f" if kind is float else "F"
        if kind is int:
            if abs(value) > _EXACT:
                return ("i", str(value))
            numbers.append(value)
            return "i"
        if kind is str:
            return ("s", value)
        if kind is dict:
            return ("d", *[(self.pack(key, numbers), self.pack(each, numbers)) for key, each in value.items()])
        if kind is tuple or kind is list:
            return ("t" if kind is tuple else "l", *[self.pack(each, numbers) for each in value])
        return self._pack_rare(value, kind, numbers)

    def _pack_rare(self, value: Any, kind: type, numbers: array[float]) -> Structure:
        if kind in self._names:
            if isinstance(value, Enum):
                return ("e", self._names[kind], value.name)
            packed = [(name, self.pack(getattr(value, name), numbers)) for name in self._fields[kind]]
            return ("n", self._names[kind], *packed)
        if kind is pin.SE3:
            numbers.frombytes(value.rotation.tobytes("C") + value.translation.tobytes())
            return "T"
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in _PLAIN:
            scalar = isinstance(value, np.generic)
            return ("b", scalar, value.dtype.str, tuple(value.shape), value.tobytes().hex())
        if isinstance(value, Mapping):
            return self.pack(dict(value), numbers)
        return ("?", kind.__name__)

    def unpack(self, structure: Structure, numbers: Array) -> Any:
        """The value. Raises ValueError, TypeError, LookupError or AttributeError for what was never packed."""
        feed = _Feed(numbers)
        value = self._unpack(structure, feed)
        if feed.at != numbers.size:
            raise ValueError(f"{numbers.size} numbers for a structure of {feed.at}")
        return value

    def _unpack(self, structure: Structure, feed: _Feed) -> Any:
        if structure is None or isinstance(structure, bool):
            return structure
        if isinstance(structure, str):
            if structure == "T":
                taken = feed.take(12)
                return pin.SE3(taken[:9].reshape(3, 3), taken[9:])
            number = feed.take(1)[0]
            return {"f": float, "i": int, "F": np.float64}[structure](number)
        mark, *rest = structure
        return getattr(self, f"_unpack_{_MARKS[mark]}")(rest, feed)

    def _unpack_array(self, shape: Sequence[int], feed: _Feed) -> Array:
        return feed.take(math.prod(_shape(shape))).reshape(shape)

    def _unpack_fortran(self, shape: Sequence[int], feed: _Feed) -> Array:
        return feed.take(math.prod(_shape(shape))).reshape(shape, order="F")

    def _unpack_bytes(self, rest: Sequence[Any], feed: _Feed) -> Any:
        scalar, name, shape, text = rest
        dtype = np.dtype(str(name))
        if dtype.kind not in _PLAIN:
            raise ValueError(f"an array of {dtype}")
        found = np.frombuffer(bytes.fromhex(text), dtype).reshape(_shape(shape)).copy()
        return found[()] if scalar else found

    def _unpack_large(self, rest: Sequence[Any], feed: _Feed) -> int:
        return int(str(rest[0])[:4000])

    def _unpack_text(self, rest: Sequence[Any], feed: _Feed) -> str:
        return str(rest[0])

    def _unpack_tuple(self, rest: Sequence[Any], feed: _Feed) -> tuple[Any, ...]:
        return tuple([self._unpack(each, feed) for each in rest])

    def _unpack_list(self, rest: Sequence[Any], feed: _Feed) -> list[Any]:
        return [self._unpack(each, feed) for each in rest]

    def _unpack_mapping(self, rest: Sequence[Any], feed: _Feed) -> dict[Any, Any]:
        return {self._unpack(key, feed): self._unpack(each, feed) for key, each in rest}

    def _unpack_record(self, rest: Sequence[Any], feed: _Feed) -> Any:
        name, *packed = rest
        return self._known[name](**{str(key): self._unpack(each, feed) for key, each in packed})

    def _unpack_member(self, rest: Sequence[Any], feed: _Feed) -> Any:
        return self._known[rest[0]][rest[1]]  # type: ignore[index]

    def _unpack_foreign(self, rest: Sequence[Any], feed: _Feed) -> Foreign:
        return Foreign(str(rest[0]))


_MARKS = {
    "a": "array", "A": "fortran", "b": "bytes", "i": "large", "s": "text", "t": "tuple", "l": "list", "d": "mapping",
    "n": "record", "e": "member", "?": "foreign",
}  # fmt: skip


class _Feed:
    """Numbers, taken one after the other, as arrays of their own."""

    def __init__(self, numbers: Array) -> None:
        self.numbers, self.at = numbers, 0

    def take(self, count: int) -> Array:
        taken = self.numbers[self.at : self.at + count]
        if taken.size != count:
            raise ValueError(f"{self.numbers.size} numbers, expected more")
        self.at += count
        return taken.copy()


def _shape(shape: Sequence[Any]) -> Sequence[int]:
    if not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError(f"an array of shape {shape}")
    return shape


def size(structure: Structure) -> int:
    """How many numbers belong to a structure. Raises ValueError, TypeError or LookupError where it is none."""
    if structure is None or isinstance(structure, bool):
        return 0
    if isinstance(structure, str):
        return _SIZES[structure]
    mark, *rest = structure
    if mark in "aA":
        return math.prod(_shape(rest))
    if mark in "tl":
        return sum(map(size, rest))
    if mark == "d":
        return sum(size(key) + size(each) for key, each in rest)
    if mark == "n":
        return sum(size(each) for _, each in rest[1:])
    if mark not in _MARKS:
        raise ValueError(f"no structure begins with {mark!r}")
    return 0


class Kinds:
    """Structures by their number; equal ones have one."""

    def __init__(self) -> None:
        self._numbers: dict[Structure, int] = {}

    def number(self, structure: Structure) -> int:
        return self._numbers.setdefault(structure, len(self._numbers))

    @property
    def listed(self) -> list[Structure]:
        return list(self._numbers)


class Stream:
    """Values packed one after the other."""

    def __init__(self, codec: Codec, kinds: Kinds) -> None:
        self._codec, self._kinds = codec, kinds
        self._kind, self._numbers = array("i"), array("d")

    def __len__(self) -> int:
        return len(self._kind)

    def append(self, value: Any) -> None:
        self._kind.append(self._kinds.number(self._codec.pack(value, self._numbers)))

    def arrays(self, name: str) -> dict[str, NDArray[Any]]:
        """What `Packed` reads, by name."""
        return {f"{name}.kind": np.array(self._kind, np.int32), name: np.array(self._numbers, float)}


class Packed:
    """What a `Stream` has kept. Raises ValueError, TypeError or LookupError where the arrays do not fit."""

    def __init__(self, codec: Codec, listed: Sequence[Structure], kind: NDArray[Any], numbers: NDArray[Any]) -> None:
        if kind.ndim != 1 or kind.dtype.kind not in "iu" or numbers.ndim != 1 or numbers.dtype != _FLOAT64:
            raise ValueError("kinds are integers and numbers float64, each in one row")
        if kind.size and not 0 <= int(kind.min()) <= int(kind.max()) < len(listed):
            raise ValueError("a value of a kind that is not listed")
        sizes = np.array([size(structure) for structure in listed], dtype=np.int64)
        self._codec, self._listed, self._kind = codec, listed, kind
        self._numbers = np.frombuffer(numbers.tobytes())  # float64 itself: a pickled dtype only equals it
        self._ends = np.cumsum(sizes[kind]) if kind.size else np.zeros(0, np.int64)
        if (int(self._ends[-1]) if kind.size else 0) != numbers.size:
            raise ValueError(f"{numbers.size} numbers, expected {int(self._ends[-1]) if kind.size else 0}")

    def __len__(self) -> int:
        return int(self._kind.size)

    def raw(self, i: int) -> tuple[Structure, bytes]:
        """Value i as it is kept: the same bits are the same value."""
        return self._listed[self._kind[i]], self._of(i).tobytes()

    def __getitem__(self, i: int) -> Any:
        return self._codec.unpack(self._listed[self._kind[i]], self._of(i))

    def _of(self, i: int) -> Array:
        return self._numbers[int(self._ends[i - 1]) if i else 0 : int(self._ends[i])]


def _fields(kind: type) -> Sequence[str]:
    return getattr(kind, "_fields", None) or [each.name for each in fields(kind)]


def _reached(roots: Iterable[type]) -> Iterator[type]:
    """The records and enumerations among `roots`, and among what their fields are declared to hold."""
    seen: set[Any] = set()
    left: list[Any] = list(roots)
    while left:
        each = left.pop()
        if each in seen:
            continue
        seen.add(each)
        left += get_args(each)
        if not isinstance(each, type):
            continue
        if issubclass(each, Enum):
            yield each
        elif is_dataclass(each) or hasattr(each, "_fields"):
            yield each
            left += get_type_hints(each).values()
