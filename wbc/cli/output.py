"""What every command says in one way: faults of its input, JSON or words, progress."""

from __future__ import annotations

import ctypes
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click

from ..errors import Fault, LogError, SpecError, WbcError

STDOUT, STDERR = 1, 2


@contextmanager
def aside() -> Iterator[None]:
    """What libraries in C print to stdout (HiGHS its name) goes to stderr; what Python prints is alone there."""
    own = sys.stdout
    try:
        direct = own.fileno() == STDOUT
    except (AttributeError, OSError, ValueError):  # closed, or no file, as in a test
        direct = False
    if not direct:
        yield
        return
    own.flush()
    kept = os.dup(STDOUT)
    os.dup2(STDERR, STDOUT)
    try:
        with open(kept, "w", encoding=own.encoding, closefd=False) as sys.stdout:
            yield
    finally:
        sys.stdout = own
        with suppress(OSError, AttributeError, TypeError):  # what they have not written yet
            ctypes.CDLL(None).fflush(None)
        os.dup2(kept, STDOUT)
        os.close(kept)


@contextmanager
def refusing(spec: str, as_json: bool, more: dict[str, Any] | None = None) -> Iterator[None]:
    """Bad input becomes one message a fault, and exit status 2."""
    try:
        yield
    except (WbcError, OSError) as error:
        faults = error.faults if isinstance(error, SpecError) else [Fault(spec, 0, 0, "", str(error))]
        if isinstance(error, LogError):
            faults = [Fault(error.file, 0, 0, "", error.message)]
        for fault in faults:
            click.echo(str(fault), err=True)
        if as_json:
            found = {"spec": spec, "ok": False, "faults": [vars(fault) for fault in faults]}
            click.echo(json.dumps(found | (more or {})))
        sys.exit(2)


def emit(value: dict[str, Any], as_json: bool, tell: Callable[[], None]) -> None:
    if as_json:
        click.echo(json.dumps(plain(value), allow_nan=False))
    else:
        tell()


def plain(value: Any) -> Any:
    """The same with null for what is no number: JSON knows neither NaN nor infinity."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def terminal(err: bool = False) -> Any:
    from rich.console import Console

    return Console(stderr=err, highlight=False, markup=False)  # names and titles are no markup


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[int], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    if not sys.stderr.isatty():
        yield _now_and_then(title, total)
        return
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=terminal(True),
        transient=True,
    ) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


def _now_and_then(title: str, total: int, every: float = 10.0) -> Callable[[int], None]:
    """Progress where no bar can be drawn: a line, none of what is done before the first."""
    last = time.monotonic()

    def tell(done: int) -> None:
        nonlocal last
        if time.monotonic() - last >= every:
            last = time.monotonic()
            click.echo(f"{title}: {done / max(total, 1):.0%}", err=True)

    return tell


def writable(folder: Path) -> Path:
    """Made, and found to be writable: better said before the run than after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WbcError(f"--out {folder}: cannot be made: {error.strerror}; choose another folder") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise WbcError(f"--out {folder}: no permission to write there; choose another folder")
    return folder
