"""Running a case: the host's loop with its recorder, rescue and checkpoints, and the pure `rollout`."""

from jaxmps.running.checks import check_precision as check_precision
from jaxmps.running.log import Log as Log
from jaxmps.running.log import empty_log as empty_log
from jaxmps.running.log import events as events
from jaxmps.running.loop import Clock as Clock
from jaxmps.running.loop import Loop as Loop
from jaxmps.running.loop import advance_chunk as advance_chunk
from jaxmps.running.loop import frame_times as frame_times
from jaxmps.running.progress import Meter as Meter
from jaxmps.running.progress import counter as counter
from jaxmps.running.progress import tally as tally
from jaxmps.running.recorder import fields as fields
from jaxmps.running.recorder import unsolved as unsolved
from jaxmps.running.rescue import ON_BLOWUP as ON_BLOWUP
from jaxmps.running.restart import resume as resume
from jaxmps.running.rollout import rollout as rollout
from jaxmps.running.simulation import simulate as simulate
from jaxmps.running.starting import start as start
from jaxmps.running.upkeep import Upkeep as Upkeep
