"""Case files in TOML: a built-in case with its arguments, or a geometry of one's own, with probes, scheme and run."""

from jaxmps.casefile.checks import Report as Report
from jaxmps.casefile.checks import check as check
from jaxmps.casefile.drawing import draw as draw
from jaxmps.casefile.leaving import leaving as leaving
from jaxmps.casefile.models import RunTable as RunTable
from jaxmps.casefile.parsing import CaseFileError as CaseFileError
from jaxmps.casefile.setup import CaseFile as CaseFile
from jaxmps.casefile.setup import Setup as Setup
from jaxmps.casefile.setup import read as read
from jaxmps.casefile.templates import template as template
