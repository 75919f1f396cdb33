"""Files of runs, which ParaView and PyVista open as they are, and their checkpoints; of ensembles; and particles of
other programs.
"""

from jaxmps.io.checkpoint import checkpoint_of as checkpoint_of
from jaxmps.io.checkpoint import read_checkpoint as read_checkpoint
from jaxmps.io.checkpoint import replace_file as replace_file
from jaxmps.io.checkpoint import sync as sync
from jaxmps.io.checkpoint import write_checkpoint as write_checkpoint
from jaxmps.io.exchange import FORMATS as FORMATS
from jaxmps.io.exchange import export as export
from jaxmps.io.exchange import particles_from as particles_from
from jaxmps.io.gathering import gather as gather
from jaxmps.io.gathering import gathered as gathered
from jaxmps.io.member_files import read_ensemble as read_ensemble
from jaxmps.io.member_files import write_ensemble as write_ensemble
from jaxmps.io.reading import read as read
from jaxmps.io.text import TYPES as TYPES
from jaxmps.io.vtkhdf import UNITS as UNITS
from jaxmps.io.vtkhdf import Writer as Writer
