"""Solvers side by side on the quadratic programs that runs of specs meet; the certificate and the clock decide.

`record` keeps programs of a run, `corpus` those that travel with the package, `ask` asks for answers in this process,
`process` in one of each solver's own, `judge` holds them against one another, `table` and `picture` show what it found.
"""

from __future__ import annotations

from . import corpus
from .judge import TIMEOUT, compare, offered
from .picture import picture
from .record import Recorded, record
from .table import table

__all__ = ["TIMEOUT", "Recorded", "compare", "corpus", "offered", "picture", "record", "table"]
