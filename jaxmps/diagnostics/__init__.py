"""Quantities that are measured on a flow."""

from jaxmps.diagnostics.energy import mechanical_energy as mechanical_energy
