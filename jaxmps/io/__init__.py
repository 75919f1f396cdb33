"""Files of runs, which ParaView and PyVista open as they are; of ensembles; and particles of other programs."""

from jaxmps.io._text import TYPES as TYPES
from jaxmps.io.exchange import FORMATS as FORMATS
from jaxmps.io.exchange import export as export
from jaxmps.io.exchange import particles_from as particles_from
from jaxmps.io.member_files import gather as gather
from jaxmps.io.member_files import read_ensemble as read_ensemble
from jaxmps.io.member_files import write_ensemble as write_ensemble
from jaxmps.io.vtkhdf import UNITS as UNITS
from jaxmps.io.vtkhdf import Writer as Writer
from jaxmps.io.vtkhdf import read as read
