"""Quantities that are measured on a flow."""

from jaxmps.diagnostics.layers import deep_surface as deep_surface
from jaxmps.diagnostics.layers import mean_height as mean_height
from jaxmps.diagnostics.layers import speed as speed
from jaxmps.diagnostics.layers import surface_height as surface_height
from jaxmps.diagnostics.objectives import elevation as elevation
from jaxmps.diagnostics.objectives import energy_error as energy_error
from jaxmps.diagnostics.objectives import front_position as front_position
from jaxmps.diagnostics.objectives import pressure_roughness as pressure_roughness
from jaxmps.diagnostics.objectives import smallest_distance as smallest_distance
from jaxmps.diagnostics.objectives import smooth_maximum as smooth_maximum
from jaxmps.diagnostics.objectives import tip_radius as tip_radius
from jaxmps.diagnostics.objectives import wave_height_error as wave_height_error
from jaxmps.diagnostics.separation import breakup as breakup
from jaxmps.diagnostics.separation import nearest as nearest
from jaxmps.diagnostics.surface import surge_front as surge_front
from jaxmps.diagnostics.tracing import Surface as Surface
from jaxmps.diagnostics.tracing import trace as trace
from jaxmps.diagnostics.tracing import trace_surface as trace_surface
from jaxmps.diagnostics.waves import Cosine as Cosine
from jaxmps.diagnostics.waves import Parabola as Parabola
from jaxmps.diagnostics.waves import WaveFit as WaveFit
from jaxmps.diagnostics.waves import fit_cosine as fit_cosine
from jaxmps.diagnostics.waves import fit_parabola as fit_parabola
from jaxmps.diagnostics.waves import wave_fit as wave_fit
from jaxmps.energy import Energy as Energy
from jaxmps.energy import mechanical_energy as mechanical_energy
