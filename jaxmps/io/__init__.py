"""Files of runs, in the VTKHDF layout, which ParaView and PyVista open as they are."""

from jaxmps.io.vtkhdf import UNITS, Writer, read

__all__ = ["UNITS", "Writer", "read"]
