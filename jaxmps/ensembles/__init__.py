"""Many runs as one: members side by side, on one core, on all, on several devices and hosts."""

from jaxmps.ensembles.ensemble import ensemble as ensemble
