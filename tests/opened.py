"""Which files of a folder are opened, by anyone: Python, MuJoCo, a parser in C. The kernel tells (inotify)."""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OPEN, FOLDER = 0x20, 0x40000000  # IN_OPEN; IN_ISDIR
LINUX = sys.platform.startswith("linux")


@contextmanager
def opened(*folders: Path) -> Iterator[set[str]]:
    """A set that holds, when the block has ended, the names of all files that were opened in these folders."""
    libc = ctypes.CDLL(None, use_errno=True)
    watch = libc.inotify_init1(os.O_NONBLOCK)
    assert watch >= 0, os.strerror(ctypes.get_errno())
    names: set[str] = set()
    try:
        for folder in folders:
            assert libc.inotify_add_watch(watch, os.fsencode(folder), OPEN) >= 0, os.strerror(ctypes.get_errno())
        yield names
        try:
            data = os.read(watch, 1 << 16)
        except BlockingIOError:
            data = b""
        while data:
            _, mask, _, length = struct.unpack_from("iIII", data)
            if not mask & FOLDER:
                names.add(data[16 : 16 + length].rstrip(b"\0").decode())
            data = data[16 + length :]
    finally:
        os.close(watch)
