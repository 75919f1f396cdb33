"""Pictures of runs: a frame, several, an animation, the place of a failure, energies, surge fronts; of ensembles."""

from jaxmps.plotting.animation import animate as animate
from jaxmps.plotting.colors import COLORS as COLORS
from jaxmps.plotting.curves import energy as energy
from jaxmps.plotting.curves import front as front
from jaxmps.plotting.ensembles import bands as bands
from jaxmps.plotting.ensembles import wet as wet
from jaxmps.plotting.failure import failure as failure
from jaxmps.plotting.flow import frame as frame
from jaxmps.plotting.panels import panels as panels
from jaxmps.plotting.player import Player as Player
from jaxmps.plotting.player import player as player
