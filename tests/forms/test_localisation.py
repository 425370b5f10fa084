"""Softening laws: the second gradient alone gives shear bands that do not depend on the mesh."""

import numpy as np
import pytest
from scipy.optimize import brentq

from femxdem_fenicsx.double_stress import one_parameter
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import LinearShearSoftening, ShearSoftening
from femxdem_fenicsx.shear_band import measure
from tests.fem.layer import Layer
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


# A layer that softens linearly, with a band in its middle: the closed form

SHEAR, DUCTILITY = 100.0 / 2.6, 40.0


def closed_form(modulus: float) -> float:
    """Width at half maximum of the band in a high layer, which does not depend on how far it is.

    Stress t = G g - D g'' outside, where g is below the strain g0 of the peak, and
    t = G g0 - H (g - g0) - D g'' inside, |y| < s. With g and g' continuous at s, a = sqrt(H/D) and
    H = G/m: inside g - g0 ~ 1 - cos(a y) / cos(a s), far outside - H/G, and
    a s = pi - atan(sqrt(H/G)). All lengths go with sqrt(D) (Desrues eq. 46).
    """
    a, slope = np.sqrt(SHEAR / DUCTILITY / modulus), 1 / DUCTILITY
    s = (np.pi - np.arctan(np.sqrt(slope))) / a

    def strain(y: float) -> float:
        return 1 - np.cos(a * y) / np.cos(a * s)

    half = 0.5 * (strain(0.0) - slope)
    return 2 * brentq(lambda y: strain(y) - half, 0.0, s)


def width_of_band_in_layer(
    modulus: float, rows: int, strain: float, micro_strain: str = "linear"
) -> float:
    def law(points):
        y = points.coordinates()[:, 1] - 0.5
        peak = 0.01 / np.sqrt(2) * (1 - 0.03 * np.exp(-((y / 0.2) ** 2)))
        return LinearShearSoftening(points.size, 100.0, 0.3, peak, DUCTILITY)

    layer = Layer(
        law,
        one_parameter(modulus),
        (3, rows),
        3 / rows,
        micro_strain=micro_strain,
        tolerance=1e-6,
    )
    stepping = LoadStepping(1e-3, 1e-5, looser_limit=0.0)
    outcome = walk(layer.problem, layer.shear, strain, stepping)
    assert not outcome.lost_controllability
    y, strain = layer.points.coordinates()[:, 1].round(9), layer.law.deviatoric_strain
    y, place = np.unique(y, return_inverse=True)
    strain = np.bincount(place, strain) / np.bincount(place)
    half, peak = 0.5 * (strain.max() + strain.min()), strain.argmax()
    upper = np.interp(-half, -strain[peak:], y[peak:])
    return upper - np.interp(half, strain[: peak + 1], y[: peak + 1])


def test_the_band_of_a_linearly_softening_layer_has_its_closed_form_and_goes_with_sqrt_d(
    petsc_options,
):
    petsc_options("-femxdem_snes_type newtonls")
    moduli = SHEAR / DUCTILITY * np.array([0.01, 0.001])
    widths = [
        width_of_band_in_layer(D, 64, end) for D, end in zip(moduli, (0.06, 0.03), strict=True)
    ]
    np.testing.assert_allclose(widths, [closed_form(modulus) for modulus in moduli], rtol=0.04)
    assert np.log10(widths[0] / widths[1]) == pytest.approx(0.5, abs=0.02)


def test_a_quadratic_micro_strain_follows_a_band_of_two_rows(petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    modulus = 0.0005 * SHEAR / DUCTILITY
    linear, quadratic = (
        width_of_band_in_layer(modulus, 32, 0.03, kind) / closed_form(modulus) - 1
        for kind in ("linear", "quadratic")
    )
    assert abs(quadratic) < 0.02
    assert abs(linear) > 0.08
