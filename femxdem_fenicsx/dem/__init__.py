"""Micro scale: periodic packings of grains and the kernels that move them (no FEniCSx in here)."""

from .accuracy import PRESETS, Accuracy
from .contacts import LinearContact
from .packing import Packing, PackingBatch

__all__ = ["PRESETS", "Accuracy", "LinearContact", "Packing", "PackingBatch"]
