"""The public names and their modules; `__init__.py` and type checkers read them here."""

from .heuristics.best_fit import BestFitLocation as BestFitLocation
from .heuristics.best_fit import BestFitRotation as BestFitRotation
from .heuristics.best_fit import BestFitShape as BestFitShape
from .heuristics.location_policies import BLBF as BLBF
from .heuristics.location_policies import DBLF as DBLF
from .heuristics.location_policies import HeightmapMinimisation as HeightmapMinimisation
from .heuristics.location_policies import LeastEmpty as LeastEmpty
from .heuristics.location_policies import MaximalContact as MaximalContact
from .heuristics.location_policies import RandomLocation as RandomLocation
from .heuristics.rotation_policies import Aligned as Aligned
from .heuristics.rotation_policies import FirstFit as FirstFit
from .heuristics.rotation_policies import Lowest as Lowest
from .heuristics.rotation_policies import RandomRotation as RandomRotation
from .heuristics.shape_policies import LargestBoxFirst as LargestBoxFirst
from .heuristics.shape_policies import LargestFirst as LargestFirst
from .heuristics.shape_policies import LargestFittingFirst as LargestFittingFirst
from .heuristics.shape_policies import LongestFirst as LongestFirst
from .heuristics.shape_policies import OldestFirst as OldestFirst
from .heuristics.shape_policies import RandomShape as RandomShape
from .heuristics.shape_policies import SmallestFirst as SmallestFirst
