"""The search for contact parameters: on functions that are known, and once on grains."""

import numpy as np
import pytest

from femxdem_fenicsx.calibration import Answer, Laboratory, Target, answer_of, calibrate
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.preparation import GUO_ZHAO, NotReached

START = (6e8, 0.5)


def material(noise: float = 0.0):
    """Like grains: E grows with E_c, the angle with mu until it does not any more."""
    rng = np.random.default_rng(4)

    def answer(modulus: float, friction: float) -> Answer:
        young = 3e7 * (modulus / 6e8) ** 0.9 * friction**0.05 * (1 + noise * rng.normal())
        angle = 40 * friction / (friction + 0.25) + 20 * noise * rng.normal()
        return Answer(modulus, friction, young, 0.0, angle, 0.0)

    return answer


@pytest.mark.parametrize(("young", "angle"), [(3e7, 25.0), (1e8, 20.0), (1e7, 30.0), (3e7, 12.0)])
def test_a_smooth_material_is_met_in_a_few_answers(young, angle):
    found = calibrate(material(), Target(young, angle), START, tolerance=(1e-2, 0.1))
    best = found.best
    assert best.young_modulus == pytest.approx(young, rel=1e-2)
    assert best.friction_angle == pytest.approx(angle, abs=0.1)
    assert best.friction == pytest.approx(0.25 * angle / (40 - angle), rel=2e-2)
    assert len(found.answers) <= 12


def test_scatter_as_of_grains_does_not_lead_astray():
    found = calibrate(material(noise=0.03), Target(5e7, 28.0), START)
    truth = material()(found.best.modulus, found.best.friction)
    assert truth.young_modulus == pytest.approx(5e7, rel=0.15)
    assert truth.friction_angle == pytest.approx(28.0, abs=2)


def test_an_angle_out_of_reach_is_an_error_that_says_how_far_it_came():
    with pytest.raises(NotReached, match=r"at best .* and 3[45].* degrees") as error:
        calibrate(material(), Target(3e7, 39.0), START)
    assert "mu = 2" in str(error.value) and "\n" not in str(error.value)


def test_a_target_or_start_that_is_none_is_refused():
    for values in ((-1.0, 30.0), (3e7, 95.0), (3e7, 0.0), (float("nan"), 30.0)):
        with pytest.raises(ValueError, match="target"):
            Target(*values)
    with pytest.raises(ValueError, match="secant"):
        Target(3e7, 30.0, secant=0.5)
    with pytest.raises(ValueError, match="starts with"):
        calibrate(material(), Target(3e7, 30.0), (6e8, 5.0))
    with pytest.raises(ValueError, match="modulus E_c"):
        Laboratory(Target(3e7, 30.0), LinearContact(stiffness=1e6), 1e5, 0.02, (1,))


def test_packings_of_two_seeds_answer_with_their_mean_and_standard_error():
    target = Target(3e7, 28.0)
    laboratory = Laboratory(target, GUO_ZHAO, 1e5, 0.03, (1, 2), preparation={"grains": 100})
    soft, stiff = laboratory.test(3e8, 0.3), laboratory.test(9e8, 0.3)
    moduli = [made.strength.young_modulus for made in soft]
    found = answer_of(soft, 3e8, 0.3, target)
    assert found.young_modulus == pytest.approx(np.mean(moduli))
    assert found.young_modulus_error == pytest.approx(abs(moduli[0] - moduli[1]) / 2)
    stiffer = answer_of(stiff, 9e8, 0.3, target)
    assert 2.0 < stiffer.young_modulus / found.young_modulus < 3.2  # a little less than E_c does
    assert abs(stiffer.friction_angle - found.friction_angle) < 12  # of few grains, which scatter
