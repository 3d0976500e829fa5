"""Fitting a model to recordings."""

from .bootstrap import Bootstrap as Bootstrap
from .bootstrap import bootstrap as bootstrap
from .embedded import Embedded as Embedded
from .embedded import Solution as Solution
from .embedded import embed as embed
from .evolution import MissingExtra as MissingExtra
from .genetic import Genetic as Genetic
from .history import History as History
from .many import Each as Each
from .many import fit_many as fit_many
from .methods import METHODS as METHODS
from .pipeline import DEFAULT_STARTS as DEFAULT_STARTS
from .pipeline import fit as fit
from .race import Race as Race
from .race import race as race
from .result import Fit as Fit
from .result import FitError as FitError
from .result import Mode as Mode
from .result import Number as Number
from .result import RecordingFit as RecordingFit
from .setup import mechanism_of as mechanism_of
from .setup import model_for as model_for
from .trace import levenberg_history as levenberg_history
