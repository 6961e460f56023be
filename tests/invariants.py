"""The watched controller of the package, under the name that tests know it by."""

from wbc.invariant import Watched

__all__ = ["Watched"]
