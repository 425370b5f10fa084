"""Width and inclination of a band that is known."""

import numpy as np
import pytest

from femxdem_fenicsx.shear_band import measure

WIDTH, HEIGHT = 0.05, 0.1


def points(count: int) -> np.ndarray:
    x = (np.arange(count) + 0.5) / count * WIDTH
    y = (np.arange(2 * count) + 0.5) / (2 * count) * HEIGHT
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


@pytest.mark.parametrize("width, angle", [(0.006, 52.0), (0.012, -47.0)])
def test_a_ridge_has_its_width_and_angle(width, angle):
    x, radians = points(32), np.radians(angle)
    distance = (x - [0.022, 0.055]) @ [-np.sin(radians), np.cos(radians)]
    strain = 0.01 + 0.1 * np.exp(-4 * np.log(2) * (distance / width) ** 2)
    band = measure(x, strain)
    assert band.width == pytest.approx(width, rel=0.03)
    assert band.angle == pytest.approx(angle, abs=1.0)


def test_a_field_without_a_ridge_has_no_band():
    x = points(16)
    with pytest.raises(ValueError, match="no shear band"):
        measure(x, 0.01 + x[:, 1])
