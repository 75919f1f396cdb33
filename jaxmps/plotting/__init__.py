"""Pictures of runs: a frame, an animation, the energies, and the surge front of a dam break."""

from jaxmps.plotting.animation import animate as animate
from jaxmps.plotting.colors import COLORS as COLORS
from jaxmps.plotting.curves import energy as energy
from jaxmps.plotting.curves import front as front
from jaxmps.plotting.flow import frame as frame
