"""An environment for each peer: they pin other versions of Pinocchio than this package, and than one another."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

# what `pip install` is given, in turn. TSID's wheels do not fit their own Pinocchio: its library and its binding are
# built from source (a C++ compiler, some minutes on two cores), against the Pinocchio in the environment by then
SOURCE = ("--no-build-isolation", "--no-binary", "libtsid,tsid")
COMMANDS = {
    "placo": (("placo==0.10.2",),),
    "tsid": (
        ("pin==4.1.0", "cmeel[build]", "cmeel-eigen", "jrl-cmakemodules", "libpinocchio[build]", "eiquadprog[build]"),
        (*SOURCE, "libtsid==1.10.0"),
        (*SOURCE, "tsid==1.10.0"),
    ),
}


def folder() -> Path:
    """Where environments are kept when nobody says where."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "wbc-peers"


def interpreter(peer: str, where: Path) -> Path:
    """The Python of a peer's environment, which is made when it is not there. Raises CalledProcessError."""
    place = where / peer
    python = place / "bin" / "python"
    done = place / "complete"
    if not done.exists():
        print(f"{peer}: making an environment in {place}", file=sys.stderr)
        venv.create(place, clear=True, with_pip=True)
        # a build is told of the environment's tools by the path, as if it were activated; its own tests are left out
        path = f"{place / 'bin'}{os.pathsep}{os.environ['PATH']}"
        known = os.environ | {"PATH": path, "VIRTUAL_ENV": str(place), "CMEEL_RUN_TESTS": "OFF"}
        known.pop("PYTHONPATH", None)
        for given in COMMANDS[peer]:
            command = [str(python), "-m", "pip", "install", "--disable-pip-version-check", *given]
            print("  " + " ".join(command), file=sys.stderr)
            subprocess.run(command, check=True, env=known, stdout=sys.stderr)
        done.touch()
    return python
