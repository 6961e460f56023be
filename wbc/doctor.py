"""What this installation consists of, for a report of trouble."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import sys
from typing import Any

PACKAGES = ("numpy", "pin", "proxsuite", "qpsolvers", "daqp", "mujoco", "pydantic", "pyyaml", "matplotlib")


def examine() -> dict[str, Any]:
    """Versions, solvers, and where Pinocchio was imported from (a system copy is a frequent trouble)."""
    import pinocchio

    from . import __version__
    from .resources import shipped_names
    from .solver import installed

    return {
        "wbc": __version__,
        "python": f"{platform.python_version()} at {sys.executable}",
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "packages": {name: _version(name) for name in PACKAGES},
        "pinocchio": f"{pinocchio.__version__} from {pinocchio.__file__}",
        "solvers": installed(),
        "rendering": os.environ.get("MUJOCO_GL")
        or ("a display" if os.environ.get("DISPLAY") else "no display: MUJOCO_GL=egl renders off screen"),
        "specs": shipped_names("tasks", ".yaml"),
        "robots": shipped_names("scenes/robots", ".xml"),
    }


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
