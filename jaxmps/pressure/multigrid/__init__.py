"""A multigrid preconditioner for equations between particles, on a background grid."""

from jaxmps.pressure.multigrid.grid import Grid, cover
from jaxmps.pressure.multigrid.preconditioner import Multigrid, multigrid

__all__ = ["Grid", "Multigrid", "cover", "multigrid"]
