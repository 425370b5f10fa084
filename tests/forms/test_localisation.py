"""A softening law: the second gradient alone gives shear bands that do not depend on the mesh."""

import numpy as np
import pytest

from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import ShearSoftening
from femxdem_fenicsx.shear_band import measure
from tests.fem.specimen import Specimen


def threshold(points) -> np.ndarray:
    """Of the strain at the peak: 1 %, less by 5 % in an oblique zone through the middle."""
    angle = np.radians(50)
    distance = (points.coordinates() - [0.5, 1.0]) @ [-np.sin(angle), np.cos(angle)]
    return 0.01 * (1 - 0.05 * np.exp(-((distance / 0.2) ** 2)))


def compressed(columns: int, modulus: float | None, strain: float, step: float):
    """Axial strains and forces, and the deviatoric strain at the points."""
    specimen = Specimen(
        lambda points: ShearSoftening(points.size, 100.0, 0.3, threshold(points), 60.0),
        cells=(columns, 2 * columns),
        distortion=0.0,
        modulus=modulus,
        formulation="small",
        tolerance=1e-4,
    )
    x = specimen.points.coordinates()
    curve = []
    outcome = walk(
        specimen.problem,
        specimen.compress,
        strain,
        LoadStepping(step, step / 16, looser_limit=0.0),
        lambda record: curve.append((record.load, specimen.top_force())),
    )
    return np.array(curve).T, x, specimen.law.deviatoric_strain, outcome


def test_bands_and_forces_with_the_second_gradient_do_not_depend_on_the_mesh(petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    bands, forces = [], []
    for columns in (16, 32):
        (load, force), x, strain, outcome = compressed(columns, 0.006, 0.016, 0.002)
        assert not outcome.lost_controllability
        bands.append(measure(x, strain))
        forces.append(np.interp(np.linspace(0.001, 0.016, 16), load, force))
    assert bands[0].contrast > 5
    assert bands[0].width > 4 / 16  # of several elements
    assert bands[1].width == pytest.approx(bands[0].width, rel=0.03)
    assert bands[1].angle == pytest.approx(bands[0].angle, abs=2)
    np.testing.assert_allclose(forces[1], forces[0], rtol=0.03)
    assert abs(forces[0]).max() > 1.02 * abs(forces[0][-1])  # behind the peak


def test_bands_with_the_first_gradient_are_one_element_wide(petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    forces = []
    for columns in (8, 16):
        (_, force), x, strain, outcome = compressed(columns, None, 0.016, 0.002)
        assert not outcome.lost_controllability
        forces.append(force[-1])
        assert measure(x, strain).width == pytest.approx(0.9 / columns, rel=0.1)
    assert abs(forces[1]) < 0.9 * abs(forces[0])
