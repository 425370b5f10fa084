"""Friction that varies from element to element (Desrues section 5.2): it decides where bands form.

A specimen that is the same everywhere has many branches behind its peak, and rounding chooses one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Variability:
    """Contact friction by element, from the number of the element alone.

    Attributes:
        deviation: delta, by how much the friction coefficient of an element differs.
        weak_element: number of the one element that differs: its friction is lower. None: half of
            all elements have mu - delta, half mu + delta, so that the mean stays; an odd one out
            keeps mu.
        seed: of the draw.
    """

    deviation: float
    weak_element: int | None = None
    seed: int = 1

    def friction(self, mean: float, elements: int) -> np.ndarray:
        """Friction coefficient of each element (elements,), around the packing's, `mean`.

        Raises:
            ValueError: a deviation that is not in ]0, mean[, a seed below zero, or an element that
                is not there.
        """
        if self.seed < 0:
            raise ValueError(f"variability seed {self.seed}: it must be 0 or more")
        if not 0 < self.deviation < mean:
            raise ValueError(
                f"friction that varies by {self.deviation}: it must be above 0 and below the"
                f" friction coefficient of the grains, {mean:.4g}"
            )
        if self.weak_element is not None:
            if not 0 <= self.weak_element < elements:
                raise ValueError(
                    f"weak element {self.weak_element}: the mesh has elements 0 to {elements - 1}"
                )
            sign = -1.0 * (np.arange(elements) == self.weak_element)
        else:
            half = elements // 2
            sign = np.repeat([-1.0, 0.0, 1.0], [half, elements - 2 * half, half])
            np.random.default_rng(self.seed).shuffle(sign)
        return mean + self.deviation * sign
