"""Where the files that travel with the package are: specs, worlds, robots, tools."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def shipped_folder(kind: str) -> Path:
    """The folder of `kind` ("tasks", "scenes", "scenes/robots", ...): inside the installed package, else beside it."""
    installed = _PACKAGE / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def shipped_names(kind: str, suffix: str) -> list[str]:
    """Names, without the suffix, of the files of one kind."""
    folder = shipped_folder(kind)
    return sorted(file.name.removesuffix(suffix) for file in folder.glob(f"*{suffix}") if file.is_file())


def shipped(kind: str, name: str, suffix: str) -> Path | None:
    """The file of that bare name, or None; a name with a path in it is never a shipped one."""
    return shipped_folder(kind) / f"{name}{suffix}" if name in shipped_names(kind, suffix) else None


def find_file(kind: str, name: str, suffix: str) -> Path | None:
    """A path to a file that exists, else a shipped file of that bare name, else None."""
    try:
        if Path(name).is_file():
            return Path(name)
    except OSError:  # a name too long for the file system
        return None
    return shipped(kind, name, suffix)
