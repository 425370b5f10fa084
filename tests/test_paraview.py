"""VTP files: what a reader of the format finds in them."""

import base64
from xml.etree import ElementTree

import numpy as np
import pytest

from femxdem_fenicsx.dem.homogenisation import touching
from femxdem_fenicsx.paraview import save_vtp
from tests.dem.scenes import cubic, hexagonal

KINDS = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}


def read(path) -> tuple[dict[str, int], dict[str, np.ndarray]]:
    """(numbers of the piece, arrays by section and name)."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib["type"] == "PolyData" and root.attrib["header_type"] == "UInt64"
    piece = root.find("PolyData/Piece")
    arrays = {}
    for section in piece:
        for array in section:
            content = base64.b64decode(array.text)
            assert int(np.frombuffer(content[:8], "<u8")[0]) == len(content) - 8
            values = np.frombuffer(content[8:], KINDS[array.attrib["type"]])
            width = int(array.attrib.get("NumberOfComponents", 1))
            name = f"{section.tag}/{array.attrib['Name']}"
            arrays[name] = values.reshape(-1, width) if width > 1 else values
    return {k: int(v) for k, v in piece.attrib.items()}, arrays


@pytest.mark.parametrize("packing", [cubic(), hexagonal()], ids=["spheres", "disks"])
def test_grains_are_points_and_contacts_are_lines_between_them(tmp_path, packing):
    path = tmp_path / "new" / "packing.vtp"
    save_vtp(path, packing)
    numbers, arrays = read(path)
    contacts = touching(packing)
    assert numbers["NumberOfVerts"] == packing.size
    assert numbers["NumberOfLines"] == len(contacts.pairs)
    points = arrays["Points/Points"]
    assert points.shape == (numbers["NumberOfPoints"], 3)
    np.testing.assert_allclose(arrays["PointData/diameter"][: packing.size], 2 * packing.radii)
    assert (arrays["PointData/diameter"][packing.size :] == 0).all()
    lines = arrays["Lines/connectivity"].reshape(-1, 2)
    np.testing.assert_array_equal(arrays["Lines/offsets"], 2 * np.arange(1, len(lines) + 1))
    length = np.linalg.norm(points[lines[:, 1]] - points[lines[:, 0]], axis=1)
    np.testing.assert_allclose(length, np.linalg.norm(contacts.branches, axis=1))
    force = arrays["CellData/normal_force"]
    assert (force[: packing.size] == 0).all()
    np.testing.assert_allclose(force[packing.size :], contacts.normal_force)
    assert arrays["CellData/is_contact"].sum() == len(contacts.pairs)
    per_grain = arrays["PointData/contacts"][: packing.size]
    assert per_grain.sum() == 2 * len(contacts.pairs) and arrays["PointData/rattler"].sum() == 0


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"packing\.vtp: cannot write this file") as error:
        save_vtp(tmp_path / "file" / "packing.vtp", hexagonal())
    assert "\n" not in str(error.value)
