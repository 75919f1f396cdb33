"""Pictures of runs: a frame, several side by side, an animation, energies, surge fronts, and bands of ensembles."""

from jaxmps.plotting.animation import animate as animate
from jaxmps.plotting.colors import COLORS as COLORS
from jaxmps.plotting.curves import energy as energy
from jaxmps.plotting.curves import front as front
from jaxmps.plotting.ensembles import bands as bands
from jaxmps.plotting.ensembles import wet as wet
from jaxmps.plotting.flow import frame as frame
from jaxmps.plotting.panels import panels as panels
