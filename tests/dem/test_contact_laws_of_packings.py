"""Contact laws in packings: stiffness under pressure, energy, bonds that hold and break, files."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import Bonds, HertzMindlin, LinearContact, RollingResistance
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.homogenisation import coordination_number, elastic_energy, stress, touching
from femxdem_fenicsx.dem.preparation import cemented, random_packing, settle
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.stability import stable_time_step
from femxdem_fenicsx.dem.tangents import operator

from .scenes import RADIUS, Moving, cubic, hexagonal

TENSION, STIFFNESS = 5.0, 1e5
CEMENT = {"cohesion": 1e-9, "rolling": RollingResistance(0.1)}
ROCK = {
    2: HertzMindlin(shear_modulus=2e8, bonds=Bonds(TENSION, 5.0), **CEMENT),
    3: LinearContact(stiffness=STIFFNESS, bonds=Bonds(TENSION, 5.0), **CEMENT),
}


def sandstone(strength: float) -> HertzMindlin:
    return HertzMindlin(shear_modulus=4e9, bonds=Bonds(strength, strength), **CEMENT)


# Hertz-Mindlin


@pytest.fixture(scope="module", params=[2, 3])
def hertz(request):
    """100 disks or 100 spheres with smooth Hertz contacts at 100 kPa."""
    dim, none = request.param, {}
    if dim == 2:  # the kernels of sandstone, without its effects
        none = {"cohesion": 1e-30, "rolling": (0.0, 0.0), "bonds": (0.0, 0.0)}
    smooth = HertzMindlin(shear_modulus=4e9, friction=1e-30, **none)
    return settle(random_packing(100, dim=dim).but(law=smooth), 1e5)


def affine_bulk_modulus(packing) -> float:
    """Of the contacts' normal springs, Pa: sum of k_n l^2 / (d^2 V)."""
    contacts = touching(packing)
    springs = contacts.stiffness * (contacts.branches**2).sum(1)
    return springs.sum() / (packing.dim**2 * packing.volume)


def test_the_stiffness_of_a_hertz_packing_grows_with_the_cubic_root_of_pressure(hertz):
    """K ~ (z (1 - n))^(2/3) p^(1/3) (Walton 1987), and in 2D, too, for the contacts are of spheres.

    Linear contacts would give no growth. Forces also become more even, which adds some per cent.
    """
    pressed = settle(hertz, 8e5)
    np.testing.assert_allclose(stress(pressed), -8e5 * np.eye(hertz.dim), atol=8e2)
    packed = 1.0
    for packing, sign in ((pressed, 1), (hertz, -1)):
        solid = 1.0 / (1.0 + packing.void_ratio)
        packed *= (coordination_number(packing) * solid) ** (sign * 2 / 3)
    ratio = affine_bulk_modulus(pressed) / affine_bulk_modulus(hertz)
    assert ratio / packed == pytest.approx(8 ** (1 / 3), rel=0.08)


def test_a_smooth_hertz_packing_keeps_its_energy(hertz):
    velocity = 0.3 * np.random.default_rng(1).normal(size=hertz.positions.shape)
    moving, dt = Moving(hertz, velocity), 0.05 * stable_time_step(hertz)

    def energy():
        """Velocities are half a step behind: their mean over a step is taken."""
        before = moving.velocity.copy()
        stored = elastic_energy(moving.now)
        mean = 0.5 * (before + moving.advance(1, dt).velocity)
        return stored + 0.5 * (hertz.masses * (mean**2).sum(1)).sum(), stored

    (first, stored), (last, stored_last) = energy(), (moving.advance(3000, dt), energy())[1]
    assert abs(stored_last - stored) > 0.01 * first  # it has been to and fro
    assert last == pytest.approx(first, rel=1e-4)


@pytest.fixture(scope="module")
def rock():
    """100 disks of Hertz-Mindlin contacts, cemented at 100 kPa: 200 N are as much as they bear."""
    return cemented(settle(random_packing(100).but(law=sandstone(200.0)), 1e5))


def test_the_time_step_follows_hertz_contacts_as_they_stiffen(rock):
    response = Response(rock, 1, PRESETS["fast"])
    first = response.time_step[0]
    for _ in range(4):
        response.deform(np.eye(2)[None] * (1 - 2e-3))
        response.commit()
    pressed = response.committed.packing(0)
    assert -np.trace(stress(pressed)) / 2 > 2e5
    assert 0.5 * first < response.time_step[0] < first
    # the limit reckons with twice the overlap there is: it is exceeded from 2^(1/4) = 1.19 of it on
    assert response.time_step[0] < 1.1 * stable_time_step(pressed)


# Bonds


@pytest.mark.parametrize("dim", [2, 3])
def test_a_bonded_lattice_keeps_tension_up_to_its_strength_and_breaks_for_good(dim):
    """Pulled apart in all directions: every contact bears the same force f(a - 2R)."""
    law = ROCK[dim]
    packing = cemented(hexagonal(4, 4, law=law) if dim == 2 else cubic(4, law=law))
    contacts, spacing = len(touching(packing).pairs), 2 * RADIUS * (1 - 1e-3)
    assert packing.bonded.sum() == contacts == (3 * 16 if dim == 2 else 3 * 64)
    response = Response(packing, 1, PRESETS["fast"])
    strained = []

    def pulled_to(gap: float) -> float:
        """Mean stress (Pa, tension positive) once grains are that far apart (m)."""
        growth = (2 * RADIUS + gap) / (spacing * (strained[-1] if strained else 1.0))
        strained.append((2 * RADIUS + gap) / spacing)
        outcome = response.deform(growth * np.eye(dim)[None])
        response.commit()
        return float(np.trace(outcome.stress[0])) / dim

    def force(gap: float) -> float:
        if dim == 3:
            return STIFFNESS * gap
        return np.sign(gap) * 2 / 3 * 2e8 / 0.8 * np.sqrt(2 * RADIUS) * abs(gap) ** 1.5

    def tension(gap: float) -> float:
        now = response.committed.packing(0)
        return contacts * force(gap) * (2 * RADIUS + gap) / (dim * now.volume)

    most = TENSION / STIFFNESS if dim == 3 else (TENSION / force(1.0)) ** (2 / 3)
    assert pulled_to(0.5 * most) == pytest.approx(tension(0.5 * most), rel=1e-4)
    assert response.committed.packing(0).bonded.sum() == contacts
    assert pulled_to(0.98 * most) == pytest.approx(tension(0.98 * most), rel=1e-4)
    if dim == 3:
        C = operator("UKO")(response, np.eye(dim)[None])[0]
        assert C[0, 0, 0, 0] == pytest.approx(STIFFNESS / (2 * RADIUS), rel=0.01)
    assert pulled_to(1.02 * most) == 0.0
    assert response.committed.packing(0).bonded.sum() == 0
    assert pulled_to(0.5 * most) == 0.0
    assert pulled_to(-most) == pytest.approx(tension(-most), rel=1e-4)


def test_a_cemented_packing_of_disks_bears_tension_until_it_cracks_and_without_cement_none(rock):
    sand = rock.but(bonded=None)
    assert rock.bonded.all() and not sand.bonded.any()
    np.testing.assert_allclose(stress(rock), stress(sand))
    means = []
    for packing in (rock, sand):
        response = Response(packing, 1, PRESETS["fast"])
        for _ in range(8):
            means.append(np.trace(response.deform(np.eye(2)[None] * (1 + 1.5e-3)).stress[0]) / 2)
            response.commit()
        if packing is rock:
            broken = 1 - response.committed.packing(0).bonded.sum() / rock.bonded.sum()
    assert max(means[:8]) > 5e4 and 0.05 < broken < 0.9
    assert means[7] < 0.7 * max(means[:8])  # brittle
    assert max(means[8:]) == means[-1] == 0.0


def test_a_state_with_bonds_and_moments_is_a_function_of_the_motion_alone_and_travels(rock):
    rock = rock.but(law=sandstone(5.0))
    F = np.eye(2) + 1e-3 * np.array([[0.5, 1.5], [0.0, -1.0]])
    response = Response(rock, 2, PRESETS["fast"])
    response.deform(np.array([F, np.eye(2)]))
    response.commit()
    broken = response.committed.packing(0)
    assert 0 < broken.bonded.sum() < rock.bonded.sum()
    assert np.abs(broken.rolling).max() > 0
    first = response.deform(np.array([F, F])).stress.copy()
    assert response.trial.packing(0).bonded.sum() < broken.bonded.sum()
    response.deform(np.array([np.linalg.inv(F), F]))
    np.testing.assert_array_equal(response.deform(np.array([F, F])).stress, first)
    np.testing.assert_array_equal(response.probe(F[None], np.array([0])).stress[0], first[0])
    skewed = response.committed.copy()
    skewed.box[0] = skewed.box[0] @ np.array([[1.0, 0.9], [0.0, 1.0]])
    before = skewed.packing(0)
    skewed.reduce_boxes()
    np.testing.assert_array_equal(skewed.packing(0).bonded, before.bonded)
    np.testing.assert_array_equal(skewed.packing(0).rolling, before.rolling)


def test_bonds_that_the_law_does_not_know_are_refused_in_one_line():
    packing = cemented(hexagonal(4, 4, law=ROCK[2]))
    plain = LinearContact(stiffness=STIFFNESS)
    with pytest.raises(ValueError, match=r"48 values of bonded are not zero.*no bonds"):
        packing.but(law=plain)
    assert packing.but(law=plain, bonded=None).bonded is None
    with pytest.raises(ValueError, match="has no bonds; give it bonds=Bonds"):
        cemented(hexagonal(4, 4, law=plain))
    with pytest.raises(ValueError, match="0 or 1"):
        packing.but(bonded=np.full(48, 0.5))
    with pytest.raises(ValueError, match=r"bonded has shape \(3,\), expected \(48,\)"):
        packing.but(bonded=np.ones(3))
    strong = LinearContact(stiffness=STIFFNESS, bonds=Bonds(1e3, 1.0))
    with pytest.raises(ValueError, match="stretch by more than 8% of the mean radius"):
        cemented(hexagonal(4, 4, law=strong))


# Files


@pytest.mark.parametrize("dim", [2, 3])
def test_bonds_and_rolling_moments_come_back_from_a_file_bit_for_bit(tmp_path, dim):
    law = HertzMindlin(
        shear_modulus=1e9 / 3, poisson_ratio=0.1, bonds=Bonds(1 / 3, 2.0),
        rolling=RollingResistance(0.1, 1 / 7),
    )  # fmt: skip
    packing = cemented(hexagonal(4, 4, law=law) if dim == 2 else cubic(4, law=law))
    packing = packing.but(
        rolling=np.random.default_rng(0).normal(size=packing.tangential.shape),
        bonded=np.arange(len(packing.contacts)) % 2,
    )
    save_packing(tmp_path / "rock.h5", packing)
    back = load_packing(tmp_path / "rock.h5", dim)
    assert back.law == law
    for name in ("contacts", "tangential", "rolling", "bonded"):
        np.testing.assert_array_equal(getattr(back, name), getattr(packing, name))


# Kernels of a law that somebody wrote

LAW = """
from typing import NamedTuple

class Power(NamedTuple):
    scale: float

    def coefficient(law, radius_i, radius_j):
        return law.scale

    def normal_force(law, coefficient, overlap):
        return {factor} * coefficient * overlap

    def stiffnesses(law, coefficient, overlap):
        return {factor} * coefficient, 0.0
"""

ASK = """
import sys
import numpy as np
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import elastic_response
if sys.argv[1] == "mine":
    from my_law import Power
    law = Power(1.0)
elif sys.argv[1] == "script's own":
    exec(open(sys.argv[2]).read())
    law = Power(1.0)
else:
    law = LinearContact(stiffness=7.0).elasticity
force = elastic_response(law, np.ones(1), np.ones(1))[0][0]
print(force, sum(elastic_response.stats.cache_hits.values()))
"""


def test_a_kernel_with_somebodys_law_is_cached_and_compiled_anew_when_the_law_changes(tmp_path):
    """Processes that know nothing of the law can use the same cache; a script's law is not kept."""
    path = tmp_path / "my_law.py"
    (tmp_path / "ask.py").write_text(ASK)

    def ask(which: str, there: bool = True) -> tuple[float, int]:
        """(force, hits of the cache) in a process of its own."""
        environment = {
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            "PYTHONPATH": str(Path(__file__).parents[2]) + (f":{tmp_path}" if there else ""),
        }
        arguments = [sys.executable, tmp_path / "ask.py", which, path]
        run = subprocess.run(arguments, env=environment, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        force, hits = run.stdout.split()
        return float(force), int(hits)

    path.write_text(LAW.format(factor=2))
    assert ask("mine") == (2.0, 0)
    assert ask("mine") == (2.0, 1)
    path.write_text(LAW.format(factor=3))
    assert ask("mine") == (3.0, 0)
    path.rename(tmp_path / "elsewhere.py")
    path = tmp_path / "elsewhere.py"
    assert ask("linear") == (1.0, 0)
    assert ask("linear") == (1.0, 1)
    assert ask("script's own") == (3.0, 0)
    assert ask("script's own") == (3.0, 0)
