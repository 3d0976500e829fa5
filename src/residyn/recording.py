"""For whoever makes experiments in Python: recordings, the tables of inertia, and their files."""

from .errors import InputError as InputError
from .recordings.csv import read_csv as read_csv
from .recordings.csv import write_csv as write_csv
from .recordings.experiment import Experiment as Experiment
from .recordings.experiment import load as load
from .recordings.noise import estimate_noise as estimate_noise
from .recordings.outliers import outlier_mask
from .recordings.recording import Recording as Recording
from .recordings.release import release_time as release_time
from .recordings.tables import ArmTable as ArmTable
from .recordings.tables import Bearing as Bearing
from .recordings.tables import InertiaTable as InertiaTable

wild_samples = outlier_mask
