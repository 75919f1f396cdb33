"""Files of runs, in the VTKHDF layout, which ParaView and PyVista open as they are, and of ensembles, in HDF5."""

from jaxmps.io.member_files import gather, read_ensemble, write_ensemble
from jaxmps.io.vtkhdf import UNITS, Writer, read

__all__ = ["UNITS", "Writer", "gather", "read", "read_ensemble", "write_ensemble"]
