"""User-supplied parts, packed into boxes at their real sizes, and the results.

`packit_sim.pack` returns `PackedParts`. These functions take them: `check`, `export`, `summary`,
`table`, `write_instructions`, `film` and `view`. Others take any packing off the grid:
`removable` and `packing_order` find straight moves in and out, `linked_pairs`, `separable` and
`separated` find and move what interlocks, `stacking` what rests on what, `stage_motions` what
gravity moves, `broken_constraints` and `filter_packing` apply `Constraints`, and
`packing_instructions` and `film_packing` are for the person who packs. Names are imported when they
are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
