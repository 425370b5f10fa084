"""FEM x DEM for granular materials: a periodic packing of grains at every quadrature point."""

__version__ = "0.1.0"
