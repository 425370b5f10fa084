"""Packing files: bit for bit, or one line that says what is wrong with them."""

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.files import load_packing, save_packing

from .scenes import loose

LAWS = {
    "modulus": LinearContact(modulus=6e8, stiffness_ratio=0.7, friction=0.3),
    "stiffness": LinearContact(
        stiffness=1e5 / 3, friction=0.1, cohesion=1 / 7, viscous_damping=0.2
    ),
}


@pytest.fixture
def packing():
    grains = loose(40, 3, 0.1 * np.array([[1.0, 0.3], [0.0, 1.0]]), LAWS["modulus"])
    return grains.but(contacts=[[0, 4], [2, 7]], tangential=[1 / 3, -np.pi])


@pytest.fixture
def path(tmp_path, packing):
    save_packing(tmp_path / "packing.h5", packing)
    return tmp_path / "packing.h5"


@pytest.mark.parametrize("kind", LAWS)
def test_a_packing_comes_back_bit_for_bit(tmp_path, packing, kind):
    packing = packing.but(law=LAWS[kind], density=1 / 3, thickness=np.pi)
    save_packing(tmp_path / "new" / "packing.h5", packing)
    back = load_packing(tmp_path / "new" / "packing.h5")
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(back, name), getattr(packing, name))
        assert getattr(back, name).dtype == getattr(packing, name).dtype
    assert (back.law, back.density, back.thickness) == (packing.law, 1 / 3, np.pi)


def missing(path):
    path.unlink()


def folder(path):
    path.unlink()
    path.mkdir()


def empty(path):
    path.write_bytes(b"")


def text(path):
    path.write_text("box 1 0 0 1\n" * 1000)


def truncated_in_the_middle(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def truncated_by_a_byte(path):
    path.write_bytes(path.read_bytes()[:-1])


def other_dimension(path):
    with h5py.File(path, "a") as file:
        file.attrs["dim"] = 3


def other_version(path):
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99


def other_format(path):
    with h5py.File(path, "w") as file:
        file["x"] = 1


def no_radii(path):
    with h5py.File(path, "a") as file:
        del file["radii"]


def no_law(path):
    with h5py.File(path, "a") as file:
        del file["law"]


def no_density(path):
    with h5py.File(path, "a") as file:
        del file.attrs["density"]


def negative_friction(path):
    with h5py.File(path, "a") as file:
        file["law"].attrs["friction"] = -0.5


def other_kind_of_law(path):
    with h5py.File(path, "a") as file:
        file["law"].attrs["kind"] = "HertzContact"


def radii_that_are_words(path):
    with h5py.File(path, "a") as file:
        del file["radii"]
        file["radii"] = ["small", "large"]


def a_group_for_radii(path):
    with h5py.File(path, "a") as file:
        del file["radii"]
        file.create_group("radii")


DAMAGE = {
    missing: "no such packing file",
    folder: "no such packing file",
    empty: "truncated or damaged",
    text: "truncated or damaged",
    truncated_in_the_middle: "truncated or damaged",
    truncated_by_a_byte: "truncated or damaged",
    other_dimension: "3 dimensions, need 2",
    other_version: "version 99, this program reads version 1",
    other_format: "not a packing",
    no_radii: "radii",
    no_law: "law",
    no_density: "density",
    negative_friction: "friction",
    other_kind_of_law: "HertzContact",
    radii_that_are_words: "",
    a_group_for_radii: "",
}


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
def test_a_bad_file_is_one_line_that_names_it_and_the_reason(path, damage):
    damage(path)
    with pytest.raises(ValueError) as error:
        load_packing(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert DAMAGE[damage] in message


def test_a_write_that_fails_leaves_nothing_behind_and_the_old_file_intact(
    path, packing, monkeypatch
):
    before = path.read_bytes()

    def full_disk(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(h5py.Group, "create_group", full_disk)
    with pytest.raises(OSError, match="No space left") as error:
        save_packing(path, packing)
    assert str(path) in str(error.value)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == before


def test_a_folder_that_is_a_file_is_one_line_that_names_the_path(path, packing):
    below = path / "packing.h5"
    with pytest.raises(OSError) as error:
        save_packing(below, packing)
    assert str(below) in str(error.value)
    assert "\n" not in str(error.value)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
