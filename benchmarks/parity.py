"""The same problem given to PlaCo, to TSID and to this package: torques and tick times, in one run.

    python benchmarks/parity.py [--peers placo,tsid] [--problems NAME;...] [--ticks N] [--clock wall|cpu]
                                [--environments FOLDER] [--json]

Every library runs in an interpreter of its own: peers pin other versions of Pinocchio, so that each gets an environment
in FOLDER (default: wbc-peers in the user's cache), made at the first run with the commands in `peers/environments.py`.
A tick is given to all in turn, the first one changing from tick to tick, so that all see the same machine; each times
itself, from q and v to the torque; of a busy machine `--clock cpu` tells the time on the processor alone.
`peers/problems.py` says what is asked for, `peers/by_*.py` how each states it.

tau is the largest difference of a joint torque from the peer's, where this package states the peer's own problem with
the same regulariser, relative to 1 + |tau|max. In problems called unique no regulariser decides anything.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from peers import environments
from peers.loop import CLOCKS
from peers.problems import load, problems, states

import wbc

BAR = 1e-6
PEERS = ("placo", "tsid")
HERE = Path(__file__).resolve().parent


class Contestant:
    """One interpreter that answers problems and ticks."""

    def __init__(self, module: str, python: str) -> None:
        known = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        known |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        if python == sys.executable:  # the same package as here, wherever that was found
            known["PYTHONPATH"] = str(Path(wbc.__file__).resolve().parent.parent)
        command = [python, "-m", module]
        self._process = subprocess.Popen(
            command, cwd=HERE, env=known, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, **message: Any) -> dict[str, Any]:
        """The answer to one line. Raises RuntimeError when the process ends instead."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(message), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self._process.args}: ended with status {self._process.wait()}")
        return json.loads(line)

    def close(self) -> None:
        self._process.communicate()


def entries(peers: list[str]) -> dict[str, tuple[str, str]]:
    """Name in the table -> (interpreter, form of the problem)."""
    found = {"floor: Pinocchio": ("wbc", "floor"), "wbc, its own metrics": ("wbc", "wbc")}
    for peer in peers:
        found |= {f"wbc, as {peer}": ("wbc", peer), peer: (peer, peer)}
    return found


def compete(
    problem: dict[str, Any], ticks: int, runs: dict[str, Contestant], table: dict[str, tuple[str, str]], clock: str
) -> dict[str, dict[str, Any]]:
    """Torques (ticks, nu), microseconds and whether each tick was solved, by name."""
    answers: dict[str, list[dict[str, Any]]] = {name: [] for name in table}
    for where, form in table.values():
        runs[where].ask(problem=problem, **{"as": form})
    names, warm = list(table), 20
    for i, (q, v) in enumerate(states(load(problem["robot"]), warm + ticks)):
        first = i % len(names)
        for name in names[first:] + names[:first]:
            where, form = table[name]
            answer = runs[where].ask(q=q.tolist(), v=v.tolist(), clock=clock, **{"as": form})
            if i >= warm:
                answers[name].append(answer)
        if sys.stderr.isatty():
            print(f"\r{problem['robot']}: {i + 1} of {warm + ticks} ticks", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return {
        name: {key: np.array([a[key] for a in got]) for key in ("tau", "us", "ok")}
        | {"active": [a["active"] for a in got]}
        for name, got in answers.items()
    }


def judge(got: dict[str, dict[str, Any]], peers: list[str]) -> dict[str, dict[str, Any]]:
    """Times, and torques against the peer whose problem it is."""
    floor = float(np.median(got["floor: Pinocchio"]["us"]))
    rows: dict[str, dict[str, Any]] = {}
    for name, answers in got.items():
        us = answers["us"]
        rows[name] = {
            "p50_us": float(np.median(us)), "p99_us": float(np.percentile(us, 99)),
            "floors": float(np.median(us)) / floor, "refused": int((~answers["ok"]).sum()),
        }  # fmt: skip
    for peer in peers:
        ours, theirs = got[f"wbc, as {peer}"], got[peer]
        both = ours["ok"] & theirs["ok"]
        apart = np.abs(ours["tau"] - theirs["tau"]).max(axis=1) / (1.0 + np.abs(theirs["tau"]).max(axis=1))
        bound = np.array([bool(names) for names in ours["active"]])
        rows[f"wbc, as {peer}"] |= {
            "tau_error": float(apart[both].max(initial=0.0)) if both.any() else np.inf,
            "compared": int(both.sum()), "bound": int((both & bound).sum()),
        }  # fmt: skip
    return rows


def show(name: str, rows: dict[str, dict[str, Any]]) -> None:
    print(f"\n{name:24s} {'median':>8s} {'p99':>8s} [us] {'x floor':>8s} {'refused':>8s} {'tau':>9s} {'bound':>11s}")
    for who, row in rows.items():
        error = f"{row['tau_error']:9.1e} {row['bound']:6d} of {row['compared']}" if "tau_error" in row else ""
        times = f"{row['p50_us']:8.1f} {row['p99_us']:8.1f}      {row['floors']:8.1f} {row['refused']:8d}"
        print(f"  {who:22s} {times} {error}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--problems", help="names, separated by ;")
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--clock", choices=CLOCKS, default="wall")
    parser.add_argument("--environments", type=Path, default=environments.folder())
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    peers = [peer for peer in args.peers.split(",") if peer]
    for peer in peers:
        if peer not in PEERS:
            parser.error(f"--peers: expected some of {', '.join(PEERS)}, got {peer!r}")
    pythons = {peer: str(environments.interpreter(peer, args.environments)) for peer in peers}
    asked = problems()
    if args.problems:
        asked = {name: asked[name] for name in args.problems.split(";")}
    runs = {"wbc": Contestant("peers.by_wbc", sys.executable)}
    runs |= {peer: Contestant(f"peers.by_{peer}", python) for peer, python in pythons.items()}
    result = {}
    for name, problem in asked.items():
        result[name] = judge(compete(problem, args.ticks, runs, entries(peers), args.clock), peers)
        if not args.json:
            show(name, result[name])
    for run in runs.values():
        run.close()
    if args.json:
        print(json.dumps(result))
    errors = [row["tau_error"] for rows in result.values() for row in rows.values() if "tau_error" in row]
    return 0 if all(error <= BAR for error in errors) else 1


if __name__ == "__main__":
    sys.exit(main())
