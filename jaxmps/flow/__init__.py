"""What a flow is: its particles and fluids, the box that it lies in, the motion of its walls, its energy, and what can
become of it.
"""

from jaxmps.flow.box import Box as Box
from jaxmps.flow.case import Case as Case
from jaxmps.flow.energy import Energy as Energy
from jaxmps.flow.energy import energy_loss as energy_loss
from jaxmps.flow.energy import kinetic_energy as kinetic_energy
from jaxmps.flow.energy import mechanical_energy as mechanical_energy
from jaxmps.flow.particles import Fluid as Fluid
from jaxmps.flow.particles import Kind as Kind
from jaxmps.flow.particles import Particles as Particles
from jaxmps.flow.particles import at_rest as at_rest
from jaxmps.flow.status import FATAL as FATAL
from jaxmps.flow.status import MESSAGES as MESSAGES
from jaxmps.flow.status import Event as Event
from jaxmps.flow.status import Outcome as Outcome
from jaxmps.flow.status import SimulationError as SimulationError
from jaxmps.flow.status import SimulationWarning as SimulationWarning
from jaxmps.flow.status import Status as Status
