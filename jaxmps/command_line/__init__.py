"""The command `jaxmps`: text becomes objects in `casefile`, these run, and what comes of it is told and written."""

from jaxmps.command_line.main import app as app
from jaxmps.command_line.main import main as main
