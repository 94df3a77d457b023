"""Which row of a slab holds what: computed from the named tuples that lie there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import LANES
from qcar_env.physics import tree


class Layout:
    """Rows of slabs.

    Parameters
    ----------
    **trees
        What lies in a slab, in order: named tuples of numbers or of named tuples.
    """

    def __init__(self, **trees: Any) -> None:
        self.trees = trees
        self._rows: dict[str, int] = {}
        self.size = 0
        for name, each in trees.items():
            self._rows[name] = self.size
            self.size += len(tree.flat(each))

    def row(self, name: str) -> int:
        """Return the first row of what is called `name`."""
        return self._rows[name]

    def find(self, path: str) -> int:
        """Return the row of one number by its dotted path, such as ``x.plant.x1``."""
        first, _, rest = path.partition(".")
        return self._rows[first] + tree.paths(self.trees[first])[rest]


def columns(slabs: NDArray[Any], row: int, count: int, n: int) -> NDArray[np.float64]:
    """Return `count` rows from `row` on of `n` cars, shape (count, n)."""
    parts = slabs.reshape(len(slabs), -1, LANES)[:, row : row + count]
    return parts.transpose(1, 0, 2).reshape(count, len(slabs) * LANES)[:, :n].astype(float)
