"""Ready-made cases; an exact solution or measured data stand beside their case."""

from jaxmps.cases.dam_break import dam_break as dam_break
from jaxmps.cases.dam_break import dam_break_3d as dam_break_3d
from jaxmps.cases.hydrostatic import hydrostatic as hydrostatic
from jaxmps.cases.hydrostatic import hydrostatic_pressure as hydrostatic_pressure
from jaxmps.cases.lattice import jitter as jitter
from jaxmps.cases.sloshing import sloshing as sloshing
from jaxmps.cases.sloshing import sloshing_frequency as sloshing_frequency
from jaxmps.cases.sloshing import sloshing_linear as sloshing_linear
from jaxmps.cases.square_patch import SQUARE_PATCH_REFERENCE as SQUARE_PATCH_REFERENCE
from jaxmps.cases.square_patch import square_patch as square_patch
from jaxmps.cases.square_patch import square_patch_pressure as square_patch_pressure
from jaxmps.cases.square_patch import square_patch_tip as square_patch_tip
from jaxmps.cases.standing_wave import standing_wave as standing_wave
from jaxmps.cases.two_phase import SETTLING_ACCELERATION as SETTLING_ACCELERATION
from jaxmps.cases.two_phase import SURFACING_ACCELERATION as SURFACING_ACCELERATION
from jaxmps.cases.two_phase import grain_groups as grain_groups
from jaxmps.cases.two_phase import settling as settling
from jaxmps.cases.two_phase import surfacing as surfacing
from jaxmps.cases.two_phase import two_layer as two_layer
from jaxmps.cases.two_phase import two_layer_pressure as two_layer_pressure
from jaxmps.cases.wave_theory import standing_wave_frequency as standing_wave_frequency
from jaxmps.cases.wave_theory import standing_wave_linear as standing_wave_linear
from jaxmps.cases.wave_theory import standing_wave_reference as standing_wave_reference
from jaxmps.cases.wave_theory import standing_wave_second_order as standing_wave_second_order
from jaxmps.cases.wave_theory import standing_wave_wu_taylor as standing_wave_wu_taylor
