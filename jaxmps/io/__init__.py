"""Files of runs, in the VTKHDF layout, which ParaView and PyVista open as they are, and their checkpoints."""

from jaxmps.io.checkpoint import checkpoint_of, read_checkpoint, replace_file, sync, write_checkpoint
from jaxmps.io.vtkhdf import UNITS, Writer, read

__all__ = ["UNITS", "Writer", "checkpoint_of", "read", "read_checkpoint", "replace_file", "sync", "write_checkpoint"]
