"""The corpus: a few hundred programs that real runs met, of every kind, that travel with the package.

    wbc compare --record wbc/compare/corpus.npz        # makes it again, from `RECIPE`

An npz: numbers of problems of one shape are one matrix, a column for each place in (H, g, C, lo, hi, T, h). Columns
that are the same to the bit (zeros, the second half of H, rows of T that stand in C) are stored once.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import ProblemError
from ..qp import Array, Problem
from ..resources import shipped_folder
from .record import INFEASIBLE, Recorded, record

FILE = Path(__file__).with_name("corpus.npz")


class Run(NamedTuple):
    """At most `most` problems of one kind, from a run of a spec with values changed."""

    kind: str
    spec: str
    changes: tuple[str, ...]  # as of --set
    most: int


CLEAR = 1e-4  # by how much bounds of rows of norm 1 give way to an infeasible program that stays one
EIGHT = "g1 on eight points"  # G1 on a point in every corner of its soles: 24 rows of rank 12
_WEAK = "phases.weak.set={limits.torque.scale: "
RECIPE = (
    Run("easy", "planar", ("duration=1",), 12),
    Run("easy", "eraser", ("duration=2",), 20),
    Run("easy", "eraser", ("duration=2", "robot=ur5e"), 16),
    Run("easy", "impedance", ("duration=1",), 12),
    Run("easy", "go2_stand", ("duration=1",), 14),
    Run("saturated", "eraser_weak", ("duration=2.5",), 24),
    Run("saturated", "eraser_weak", ("duration=1.5", _WEAK + "0.15}"), 12),
    Run("saturated", "eraser_noisy", ("duration=0.5", "limits.torque_rate=20"), 16),
    Run("saturated", "go2_stand", ("duration=0.3", "limits.torque=4"), 12),
    Run("saturated", "g1_push", ("duration=2",), 14),
    Run("changing", "chalk_liftoff", ("duration=9",), 24),
    Run("changing", "go2_step", ("duration=4",), 24),
    Run("redundant", "g1_stand", ("duration=1",), 12),
    Run("redundant", EIGHT, ("duration=1",), 14),
    Run("redundant", "panda_dual_box", ("duration=2",), 14),
    Run("ill-scaled", "eraser", ("duration=1", "tasks.posture.weight=1e-7", "tasks.press.weight=1e-5"), 12),
    Run("ill-scaled", "eraser", ("duration=1", "tasks.draw.weight=1e6"), 12),
    Run("ill-scaled", "go2_stand", ("duration=1", "tasks.balance.weight=1e-5"), 10),
    Run("ill-scaled", "g1_wipe", ("duration=1", "tasks.posture.weight=1e-6"), 10),
    Run(INFEASIBLE, "impedance", ("duration=1", "limits.torque={scale: 0.05}"), 14),
    Run(INFEASIBLE, "go2_stand", ("duration=1", "limits.torque=2"), 10),
    Run(INFEASIBLE, "go2_stand", ("duration=0.5", "limits.velocity=0.01", "limits.torque=3"), 14),
    Run(INFEASIBLE, "panda_dual_box", ("duration=0.1", "limits.torque={scale: 0.2}"), 6),
    Run(INFEASIBLE, "g1_stand", ("duration=0.5", "limits.torque={scale: 0.05}"), 8),
)


def make(recipe: Sequence[Run] = RECIPE, progress: Callable[[int], None] | None = None) -> list[Recorded]:
    """Run the recipe. `progress` is told the number of its runs that are done."""
    from ..build import build
    from ..spec import load as load_spec

    found: list[Recorded] = []
    with tempfile.TemporaryDirectory() as folder:
        for done, (kind, spec, changes, most) in enumerate(recipe, 1):
            built = build(load_spec(_eight_points(Path(folder)) if spec == EIGHT else spec, changes))
            own = kind in ("redundant", "ill-scaled")  # what no status of a tick tells
            met = [item for item in record(built, most=4 * most) if own or item.kind == kind]
            met = [item for item in met if (item.kind == INFEASIBLE) == (kind == INFEASIBLE)]
            met = [item for item in met if kind != INFEASIBLE or _clearly_infeasible(item.problem)]
            chosen = np.unique(np.linspace(0, len(met) - 1, min(most, len(met))).round().astype(int))
            found += [met[i]._replace(kind=kind) for i in chosen]
            if progress is not None:
                progress(done)
    return found


def _clearly_infeasible(problem: Problem) -> bool:
    """Whether nothing satisfies it, by more than a solver's tolerance: what is in between is neither."""
    from ..conflict import System

    n = problem.g.size
    rows = np.concatenate((np.eye(n), problem.C))
    give = CLEAR * np.maximum(np.linalg.norm(rows, axis=1), 1.0)
    names = ["all"] * len(rows)
    system = System(rows, problem.lo - give, problem.hi + give, names, np.zeros((0, n)), np.zeros(0))
    return not system.feasible(["all"])


def _eight_points(folder: Path) -> Path:
    """`g1_stand` on a point in every corner of its soles, as a spec with a robot of its own."""
    xml = (shipped_folder("scenes") / "robots" / "g1.xml").read_text()
    spec = (shipped_folder("tasks") / "g1_stand.yaml").read_text()
    feet = []
    for side in ("left", "right"):
        mark = f'<site name="{side}_sole"'
        for i, (x, y) in enumerate(((0.12, 0.025), (0.12, -0.025), (-0.05, 0.025), (-0.05, -0.025))):
            xml = xml.replace(mark, f'<site name="{side}_{i}" pos="{x} {y} -0.035"/>\n{mark}')
            feet.append(f"{side}_{i}")
    head, _, tail = spec.partition("contacts:\n")
    tasks = tail.partition("tasks:\n")[2].partition("expect:")[0]
    contacts = "".join(f"  at_{f}: {{frame: {f}, holds: [vx, vy, vz], pushes: -z, friction: 0.6}}\n" for f in feet)
    over = ", ".join(f"at_{foot}" for foot in feet)
    spec = f"{head}contacts:\n{contacts}tasks:\n{tasks.replace('left_foot, right_foot', over)}"
    (folder / "cornered.xml").write_text(xml)
    (folder / "g1_points.yaml").write_text(spec.replace("robot: g1", "robot: cornered.xml"))
    return folder / "g1_points.yaml"


# --- files ---


def _shape(item: Recorded) -> tuple[int, int, int, int]:
    return item.problem.g.size, item.problem.C.shape[0], item.problem.n_eq, item.h.size


def save(file: str | Path, recorded: Sequence[Recorded]) -> None:
    """Write problems to an npz. Raises ProblemError without any."""
    if not recorded:
        raise ProblemError("no problems to write")
    arrays: dict[str, Any] = {}
    shapes = list(dict.fromkeys(map(_shape, recorded)))
    order = [[i for i, item in enumerate(recorded) if _shape(item) == shape] for shape in shapes]
    for number, members in enumerate(order):
        flat = np.stack([_flat(recorded[i]) for i in members], axis=1)  # (places, problems): equal bits lie together
        bits, index = np.unique(flat.view(np.int64), axis=0, return_inverse=True)
        arrays[f"values{number}"] = bits.view(np.float64)
        arrays[f"index{number}"] = index.ravel().astype(np.uint16 if len(bits) <= 1 << 16 else np.uint32)
    arrays["t"] = np.array([item.t for item in recorded])
    told = [[item.spec, item.kind, list(item.active)] for item in recorded]
    meta = {"shapes": shapes, "order": order, "told": told}
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with Path(file).open("wb") as stream:  # a name of its own choice, whatever its suffix
        np.savez_compressed(stream, **arrays)


def load(file: str | Path = FILE) -> list[Recorded]:
    """Problems of an npz that `save` wrote, bit for bit; the package's own corpus when no file is named.

    Raises ProblemError for a file that is none; it holds numbers and JSON alone, and no code is read from it.
    """
    try:
        with Path(file).open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            meta = json.loads(arrays["meta"].tobytes())
            found: dict[int, Recorded] = {}
            for number, (shape, members) in enumerate(zip(meta["shapes"], meta["order"], strict=True)):
                flat = arrays[f"values{number}"][arrays[f"index{number}"]]
                for column, i in enumerate(members):
                    spec, kind, active = meta["told"][i]
                    found[i] = _item(flat[:, column], shape, float(arrays["t"][i]), spec, tuple(active), kind)
    except (OSError, EOFError, zipfile.BadZipFile, KeyError, ValueError, TypeError, IndexError) as error:
        raise ProblemError(f"{file}: not a file of recorded problems: {error}") from None
    return [found[i] for i in sorted(found)]


def _flat(item: Recorded) -> Array:
    p = item.problem
    return np.concatenate([np.ravel(part) for part in (p.stack, p.g, p.lo, p.hi, item.T, item.h)])


def _item(flat: Array, shape: Sequence[int], t: float, spec: str, active: tuple[str, ...], kind: str) -> Recorded:
    n, m, n_eq, nu = shape
    sizes = ((n + m) * n, n, n + m, n + m, nu * n, nu)
    stack, g, lo, hi, T, h = np.split(flat, np.cumsum(sizes)[:-1])
    stack = np.ascontiguousarray(stack).reshape(n + m, n)
    problem = Problem(stack[:n], g.copy(), stack[n:], lo.copy(), hi.copy(), n_eq, stack)
    return Recorded(problem, T.reshape(nu, n).copy(), h.copy(), t, spec, active, kind)
