"""Ready-made cases; an exact solution or measured data stand beside their case."""

from jaxmps.cases.dam_break import dam_break as dam_break
from jaxmps.cases.dam_break import dam_break_3d as dam_break_3d
from jaxmps.cases.hydrostatic import hydrostatic as hydrostatic
from jaxmps.cases.hydrostatic import hydrostatic_pressure as hydrostatic_pressure
from jaxmps.cases.lattice import jitter as jitter
