"""Fitting a model to recordings."""

from ..errors import MissingExtra as MissingExtra
from .batch import Each as Each
from .batch import fit_many as fit_many
from .bootstrap import Bootstrap as Bootstrap
from .bootstrap import bootstrap as bootstrap
from .fit import fit as fit
from .genetic import Genetic as Genetic
from .history import History as History
from .implicit import Embedded as Embedded
from .implicit import Solution as Solution
from .implicit import embed as embed
from .methods import METHODS as METHODS
from .multistart import DEFAULT_STARTS as DEFAULT_STARTS
from .problem import mechanism_of as mechanism_of
from .problem import model_for as model_for
from .race import Race as Race
from .race import race as race
from .result import Fit as Fit
from .result import FitError as FitError
from .result import Mode as Mode
from .result import Number as Number
from .result import RecordingFit as RecordingFit
