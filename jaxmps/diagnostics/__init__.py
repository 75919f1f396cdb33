"""Quantities that are measured on a flow."""

from jaxmps.diagnostics.energy import Energy as Energy
from jaxmps.diagnostics.energy import mechanical_energy as mechanical_energy
from jaxmps.diagnostics.surface import surge_front as surge_front
