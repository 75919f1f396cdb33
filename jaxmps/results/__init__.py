"""What a run and an ensemble leave behind, and how other libraries and notebooks see it."""

from jaxmps.results.ensemble import Ensemble as Ensemble
from jaxmps.results.run import Run as Run
from jaxmps.results.run import names_of_phases as names_of_phases
from jaxmps.results.stored import Stored as Stored
from jaxmps.results.views import at_frame as at_frame
from jaxmps.results.views import box_of as box_of
from jaxmps.results.views import needed as needed
from jaxmps.results.views import padded as padded
