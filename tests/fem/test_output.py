"""What ParaView, h5py and a spreadsheet find."""

from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from femxdem_fenicsx.fem.output import Fields, History, writable_folder
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import NeoHookean
from tests.fem.specimen import Specimen

TOPOLOGY = {"Q4": "Quadrilateral", "Q8": "Quadrilateral_9", "T6": "Triangle_6"}


def read(path, item):
    file, dataset = item.text.strip().split(":")
    with h5py.File(path.parent / file) as h5:
        return h5[dataset][...]


@pytest.mark.parametrize("name", TOPOLOGY)
def test_fields_hold_displacement_and_cell_means_on_the_first_geometry(name, tmp_path):
    specimen = Specimen(lambda points: NeoHookean(points.size, 100.0, 0.3), name=name)
    height = specimen.points.coordinates()[:, 1]
    tensors = np.einsum("n,ij->nij", height, [[1.0, 2.0], [3.0, 4.0]])
    centres = specimen.points.cell_means(specimen.points.coordinates())

    def observe(record):
        fields.write(record.load, {"height": height, "stress": tensors})

    with Fields(
        tmp_path / "fields", specimen.points, specimen.problem.motion.displacement
    ) as fields:
        walk(specimen.problem, specimen.compress, 0.1, LoadStepping(0.05), observe)
    path = tmp_path / "fields.xdmf"
    series = ElementTree.parse(path).getroot().findall("Domain/Grid")
    assert [grid.get("CollectionType") for grid in series] == ["Temporal"]
    grids = series[0].findall("Grid")
    assert [float(grid.find("Time").get("Value")) for grid in grids] == [0.05, 0.1]
    last = grids[-1]
    assert last.find("Topology").get("TopologyType") == TOPOLOGY[name]
    nodes = read(path, last.find("Geometry/DataItem"))[:, :2]
    assert nodes[:, 1].max() == pytest.approx(2.0)
    found = {
        a.get("Name"): (a.get("Center"), read(path, a.find("DataItem")))
        for a in last.findall("Attribute")
    }
    assert {key: value[0] for key, value in found.items()} == {
        "displacement": "Node",
        "height": "Cell",
        "stress": "Cell",
    }
    moved = nodes + found["displacement"][1][:, :2]
    assert moved[:, 1].max() == pytest.approx(1.8)
    np.testing.assert_allclose(moved[:, 1], 0.9 * nodes[:, 1], atol=1e-9)
    # each cell's value stands at that cell
    cells = read(path, last.find("Topology/DataItem"))
    corners = nodes[cells[:, : 3 if name == "T6" else 4]]
    value = found["stress"][1][:, [0, 1, 3, 4]] / [1, 2, 3, 4]
    np.testing.assert_allclose(value, found["height"][1].reshape(-1, 1).repeat(4, 1), rtol=1e-12)
    assert sorted(found["height"][1].ravel()) != sorted(
        centres[:, 1]
    )  # means of then, weights of now
    low, high = corners[..., 1].min(axis=1), corners[..., 1].max(axis=1)
    assert found["height"][1].size == len(centres)
    assert (low < found["height"][1].ravel()).all() and (found["height"][1].ravel() < high).all()


def test_history_is_on_disk_after_each_row(tmp_path):
    with History(MPI.COMM_SELF, tmp_path / "history.csv", ["strain", "cuts", "converged"]) as table:
        table.write({"strain": 0.1, "converged": True, "cuts": np.int64(3)})
        assert (tmp_path / "history.csv").read_text() == "strain,cuts,converged\n0.1,3,1\n"
        with pytest.raises(ValueError, match="history row has"):
            table.write({"strain": 0.2})


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match=r"cannot write results into .*file"):
        writable_folder(MPI.COMM_WORLD, tmp_path / "file" / "results")
    assert writable_folder(MPI.COMM_WORLD, tmp_path / "new" / "results").is_dir()
