# # Drained triaxial compression of a specimen of spheres
#
# A cuboid of 50 mm x 50 mm x 100 mm stands between smooth plates under a lateral pressure of
# 100 kPa, which is kept while the upper plate moves down. It is the biaxial test of `biaxial.py`
# in three dimensions: hexahedra or tetrahedra, and a packing of spheres at every quadrature point.
#
# Run it with `.venv/bin/python demos/triaxial.py --help`, or under `mpirun -n 2`.

import argparse
from pathlib import Path
from time import perf_counter

from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx import arguments as shared
from femxdem_fenicsx import script
from femxdem_fenicsx.collective import together
from femxdem_fenicsx.compression import Specimen, load, packing_at_extreme, save_curves, tell
from femxdem_fenicsx.dem.files import save_packing
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.output import writable_folder
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from forms.first_gradient import FORMULATIONS
from forms.media import medium_for
from meshes.box import BACK, BOTTOM, FRONT, LEFT, RIGHT, TOP, box, sides, vertex_near

#: Largest strain of a point in one load step, over the step's axial strain: beyond it, cut.
LARGEST_INCREMENT = 30


# ## The scene


def arguments() -> argparse.ArgumentParser:
    parser = shared.parser("Drained triaxial compression, FEM x DEM.")
    specimen = parser.add_argument_group("specimen")
    specimen.add_argument(
        "--size", type=float, nargs=3, default=(0.05, 0.05, 0.1), metavar=("X", "Y", "Z"), help="m"
    )
    shared.add_discretisation(specimen, 3, (1, 1, 2), "H8", FORMULATIONS)
    shared.add_variability(specimen)
    shared.add_grains(parser, 400, "spheres")
    shared.add_compression(parser, strain=0.02)
    shared.add_solution(parser)
    shared.add_output(parser, "results/triaxial")
    return parser


# ## The boundary value problem
#
# As in the biaxial test, with pressure on four sides. The smooth plates prescribe $u_z$ alone. One
# corner is held, and another one along one axis, so that the specimen can neither drift nor turn
# between the plates.


def specimen_for(args: argparse.Namespace, packing: Packing, comm: MPI.Comm) -> Specimen:
    kind = element(args.element, args.points)
    mesh = box(comm, args.size, args.mesh, kind)
    points = QuadraturePoints(mesh, kind)
    law = shared.law_for(args, packing, points, comm)
    medium = medium_for(args, points)
    sigma = ExternalOperator(medium.F, law, points, LARGEST_INCREMENT * args.step, medium.states)

    tags = sides(mesh, args.size)
    ds = kind.ds(mesh, tags)
    p = fem.Constant(mesh, args.pressure)
    residual, jacobian = medium.equilibrium(
        sigma.stress, sigma.tangent, [(p, ds((LEFT, RIGHT, FRONT, BACK)))]
    )

    V_x, V_y, V_z = (medium.space.sub(axis) for axis in range(3))
    descent, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    top = fem.locate_dofs_topological(V_z, 2, tags.find(TOP))
    bottom = fem.locate_dofs_topological(V_z, 2, tags.find(BOTTOM))
    corner = vertex_near(mesh, 0.0, 0.0, 0.0)
    along_x = vertex_near(mesh, args.size[0], 0.0, 0.0)
    bcs = [
        fem.dirichletbc(descent, top, V_z),
        fem.dirichletbc(zero, bottom, V_z),
        fem.dirichletbc(zero, fem.locate_dofs_topological(V_x, 0, corner), V_x),
        fem.dirichletbc(zero, fem.locate_dofs_topological(V_y, 0, corner), V_y),
        fem.dirichletbc(zero, fem.locate_dofs_topological(V_y, 0, along_x), V_y),
        *medium.straight(tags.find(TOP), normal=2, component=2),
        *medium.straight(tags.find(BOTTOM), normal=2, component=2),
    ]
    problem = Problem(medium.unknown, residual, jacobian, sigma, bcs, shared.convergence_of(args))
    return Specimen(problem, descent, top, args.size[2], args.pressure)


# ## Results
#
# Fields for ParaView and the table of the load path, both step by step; at the end a picture of
# the curves and the packing that is strained the most.


def save_results(specimen: Specimen, rows: list[dict[str, float]], folder: Path) -> None:
    comm = specimen.mesh.comm
    strained = packing_at_extreme(specimen, specimen.law.deviatoric_strain)

    def save() -> None:
        if comm.rank > 0:
            return
        save_packing(folder / "packing.h5", strained)
        if rows:
            save_curves(folder / "history.png", rows)

    together(comm, save)


def main(comm: MPI.Comm) -> int:
    started = perf_counter()
    args = script.parse(arguments(), comm)
    shared.check(args, 3, FORMULATIONS)
    writable_folder(comm, args.output)
    specimen = specimen_for(args, shared.packing_for(args, comm, 3), comm)
    stepping, saving = shared.stepping_of(args), shared.saving_of(args, specimen.law)
    run = load(
        specimen, args.strain, stepping, args.output / "triaxial", args.quiet, saving, args.fields
    )
    if not run.signal:
        save_results(specimen, run.rows, args.output)
    seconds = perf_counter() - started
    return tell("Drained triaxial compression", specimen, run, seconds, args.quiet)


if __name__ == "__main__":
    script.run(main)
