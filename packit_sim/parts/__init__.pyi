"""The public names and their modules; `__init__.py` and type checkers read them here."""

from .handling.broken import BrokenConstraint as BrokenConstraint
from .handling.broken import broken_constraints as broken_constraints
from .handling.constraints import Constraints as Constraints
from .handling.filtering import FilteredPacking as FilteredPacking
from .handling.filtering import LeftOutPart as LeftOutPart
from .handling.filtering import filter_packing as filter_packing
from .handling.order import packing_order as packing_order
from .handling.removal import Removal as Removal
from .handling.removal import Route as Route
from .handling.removal import StuckPart as StuckPart
from .handling.removal import removable as removable
from .handling.stability import StageMotion as StageMotion
from .handling.stability import stage_motions as stage_motions
from .handling.supports import Stacking as Stacking
from .handling.supports import lowered as lowered
from .handling.supports import stacking as stacking
from .results.check import Check as Check
from .results.check import check as check
from .results.exports import export as export
from .results.film import film as film
from .results.film import film_packing as film_packing
from .results.instructions import packing_instructions as packing_instructions
from .results.instructions import write_instructions as write_instructions
from .results.summary import summary as summary
from .results.summary import table as table
from .results.view import view as view
