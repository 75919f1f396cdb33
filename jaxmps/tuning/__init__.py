"""Values of schemes and cases found by optimization through runs."""

from jaxmps.tuning.estimators import AbstractEstimator as AbstractEstimator
from jaxmps.tuning.estimators import Evolution as Evolution
from jaxmps.tuning.estimators import Forward as Forward
from jaxmps.tuning.estimators import Pathwise as Pathwise
from jaxmps.tuning.tuner import History as History
from jaxmps.tuning.tuner import tune as tune
