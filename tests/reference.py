"""The packing and the curves of `tests/data/yade`."""

from pathlib import Path

import numpy as np

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.packing import Packing

DATA = Path(__file__).parent / "data" / "yade"


def packing_from_tables() -> Packing:
    """YADE's packing, grain for grain and contact for contact."""
    box = np.loadtxt(DATA / "cell.txt")
    grains = table("grains.csv")
    contacts = table("contacts.csv")
    assert (contacts["fsx_N"] == 0).all() and (contacts["fsy_N"] == 0).all()
    positions = np.column_stack([grains["x_m"], grains["y_m"]]) @ np.linalg.inv(box).T
    law = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=float(np.tan(0.5)))
    return Packing(box, positions, grains["radius_m"], law, density=2650.0, thickness=0.1)


def spheres_from_tables() -> Packing:
    """YADE's 1000 spheres, sphere for sphere."""
    box = np.loadtxt(DATA / "spheres" / "cell.txt")
    grains = table("spheres/grains.csv")
    positions = np.column_stack([grains[name] for name in ("x_m", "y_m", "z_m")])
    law = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=float(np.tan(0.5)))
    return Packing(box, positions @ np.linalg.inv(box).T, grains["radius_m"], law, density=2650.0)


def reference_packing() -> Packing:
    """The same from the file that demos and benchmarks read."""
    return load_packing(DATA / "packing.h5")


def reference_spheres() -> Packing:
    """YADE's spheres from the file that demos and benchmarks read."""
    return load_packing(DATA / "spheres.h5", dim=3)


def table(name: str) -> np.ndarray:
    """One of the CSV files, columns by name."""
    return np.genfromtxt(DATA / name, delimiter=",", names=True)


if __name__ == "__main__":
    save_packing(DATA / "packing.h5", packing_from_tables())
    save_packing(DATA / "spheres.h5", spheres_from_tables())
