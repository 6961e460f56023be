"""Many seeds of everything that can go wrong, on several specs, and what must hold at every tick of them.

`scenario` says what a seed means, `arguments` what a caller can get wrong, `episode` runs one, `runner` all of them in
parallel, `table` shows what was found. What must hold is `wbc.invariant`.
"""

from __future__ import annotations

from ..invariant import INVARIANTS as _OF_A_TICK
from .episode import INVARIANTS as _OF_SEVERAL
from .episode import Episode, Outcome
from .runner import CASES, Case, campaign, cases
from .scenario import Scenario, scenario
from .table import table

INVARIANTS = _OF_A_TICK | _OF_SEVERAL

__all__ = ["CASES", "INVARIANTS", "Case", "Episode", "Outcome", "Scenario", "campaign", "cases", "scenario", "table"]
