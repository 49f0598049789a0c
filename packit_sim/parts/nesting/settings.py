"""The settings of the nester's search: how long each step tries, and how boldly."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """All settings of a search; the defaults come from measurements (`benchmarks/nesting`).

    Other constants stay next to the code that they belong to: in kernels, the sizes of arrays, the
    numerics of a descent and the accuracy of stored distances; in `build`, the tolerances that make
    an accepted packing valid.

    Attributes
    ----------
    refined_voxels, rough_voxels : int
        Voxels of the fields along the longest side of an item of median size: more where the
        surfaces compute nodes than where fields only choose among samples.
    max_field_values, max_fields : int
        Memory for fields: nodes of two bytes, and fields. When either is full, all are dropped.
    most_fields, most_hollow_fields : int
        Fields of all pairs of types up to which a strip or a box is searched with fields, and up to
        which a strip of items that are hollow together is; with more, items are placed and moved
        apart as cells (see `cells`).
    max_refined_fields : int
        Fields of a problem up to which the surfaces compute nodes; with more, a node is hardly
        ever used twice.
    simple_triangles : int
        Mean number of an item's triangles up to which the surfaces compute nodes.
    refined_work : int
        Fields times mean triangles up to which the surfaces compute nodes of detailed items too.
    distance_cells : int
        Cells of an item's grid of signed distances along its longest side, with the clearance.
    distance_margin : float
        Cells around an item, in addition to the clearance, in which distances to it are known.
    surface_points : int
        Points of an item's surface whose depth in others counts.
    hollow : float
        Share of the convex hull below which the volume makes a detailed item hollow. Simple items
        never are: their search would take fewer samples, and the literature's strips got higher.
    finest_cells : int
        Most cells along the longest side of an item of median size, where items are cells.
    most_cells : float
        Most cells of a box, times the root of the number of items.
    constructing : float
        Share of the search after which a strip of cells is not constructed again, in smaller ones,
        and after which all its items are arranged.
    first_construction : float
        Largest share of the search that the first construction may take for the hardest items to
        be arranged alone, instead of further constructions.
    first_arranged : tuple of float
        Shares of the items that are arranged alone, one after the other.
    cell_samples : tuple of int
        Samples of a move on the grid of cells, near the item and in the whole box.
    cell_patience : int
        Passes without a gain after which a separation of cells gives up.
    cell_failures : int
        Separations of cells without a gain after which more items are arranged, or cells become
        smaller.
    smaller_cells : float
        Factor of their side then.
    settling_steps : tuple of float
        First and last step of an item that settles, in cells.
    settling_tries : int
        Steps aside that it tries for each straight one.
    settling_sweeps : int
        Most sweeps over all items.
    compacting_moves, finishing_moves : int
        Most moves of all items of a strip at once: of items as cells after they have settled, and
        at the end of another search.
    finishing_shakes : int
        How often they are tried again at the end of another search, each time after all items have
        moved in random directions.
    finishing : tuple of float
        Time for what is done at the end of a search: a share of it or of its passes, and the most
        seconds, or a share of a long search.
    construction_samples : int
        Samples for each item of a construction.
    construction_seconds : float
        Seconds that the first construction of a knapsack has at least, even if the time is over.
    constructed_again : int
        Items that are placed in further constructions of a knapsack with limits, in all.
    samples : int
        Samples of a move in a separation.
    passes_at_once : int
        Passes of a separation between two looks at the clock.
    patience, exchange_patience : int
        Passes without a gain after which a separation gives up, and conflicts that the surfaces
        find without an overlap; the second one after an exchange of items of a knapsack.
    most_patience : int
        The patience of a separation of all items of a strip that takes little of the search, and of
        one that perseveres.
    patient_share : float
        The share of the search that is little: with more since the last gain, `patience` counts.
    gain : float
        Share of the least overlap below which the overlap after a pass is a gain.
    precise_overlap : float
        Total overlap, in voxels, below which the surfaces compute nodes from then on.
    weight_growth : tuple of float
        Share by which the weight of an overlapping pair grows in a pass: for all pairs, and in
        addition for the deepest pair.
    weight_decay : float
        Factor of the weight of a pair that does not overlap.
    first_items : int
        Minimum number of items that are searched for alone.
    first_levels : float
        Share of the search for a strip after which all items are searched for, at the latest.
    beginning : float
        The same for a knapsack, which until then also begins again with its most important items.
    beginning_seconds : tuple of float
        Seconds after which the search for a strip begins again, from another construction: at
        least, and for each item.
    most_beginnings : int
        How often it begins at most; with more time, each search is longer.
    persevering : int
        From the time of so many beginnings on, each search takes that time and perseveres: in long
        separations, of which each goes on from the poses of a failed one.
    resumes : bool
        Whether a search resumes from the best strip, instead of another construction, if the search
        before found it, or instead of a given packing; those that persevere do.
    shrink, early_shrink, least_shrink : float
        Largest share by which a strip shrinks at a time, and the smallest ones: early in the search
        with all items, falling with the time that is left, and at its end.
    shrink_growth, shrink_decay : float
        Factors of that share after a success and after a failure.
    restart_probability : float
        Probability that the attempt after a failure starts from the lowest strip, not from the
        failed one.
    full_shrink : float
        Shrinkage below which more items are added to a strip.
    more_space : float
        Share by which a strip grows for added items, besides their volume, and again if they find
        no place; twice as much the next time.
    max_inserted, max_removed : int
        Maximum numbers of items of an exchange that come into a knapsack, and that go.
    exchange_gain : tuple of float
        Smallest and largest gain that an exchange aims for, as shares of the value.
    exchange_choices : int
        Random exchanges among which the one with the smallest such gain is chosen.
    max_failures : int
        Exchanges without a gain after which more items are searched for.
    max_loss, max_refill_loss : float
        Shares of the best value by which a knapsack may be worse for the search to continue from
        it, and for an attempt to fill it up.
    least_rebuilding : float
        Least time for rebuilds, as a share of the time for exchanges.
    max_rebuilt : int
        Maximum number of items that a rebuild takes out of a knapsack.
    rebuilt_neighbours : float
        Probability that these are neighbours.
    shuffle : float
        Standard deviation of an item's rank in the order of a rebuild, as a share of the number of
        items.
    swap_probability : float
        Probability that an item goes to the place of smaller ones in another box, not anywhere.
    swap_neighbours : int
        Items nearest to that place; the smaller ones among them make space.
    smaller_box : float
        Probability of an attempt with a smaller box, where there are several sizes.
    round_seconds : tuple of float
        Shortest and longest round, after which searches exchange their best solutions.
    round_growth : float
        Length of a round as a share of the time before it: the first ones show something soon.
    round_passes : int
        Passes of a round, where passes are counted instead of the time.
    """

    refined_voxels: int = 16
    rough_voxels: int = 8
    max_field_values: int = 200_000_000
    max_fields: int = 200_000
    most_fields: int = 30_000
    most_hollow_fields: int = 15_000
    max_refined_fields: int = 3000
    simple_triangles: int = 200
    refined_work: int = 50_000
    distance_cells: int = 40
    distance_margin: float = 3.0
    surface_points: int = 128
    hollow: float = 0.6
    finest_cells: int = 66
    most_cells: float = 500_000
    constructing: float = 0.6
    first_construction: float = 0.1
    first_arranged: tuple[float, ...] = (0.25, 0.5)
    cell_samples: tuple[int, int] = (15, 15)
    cell_patience: int = 150
    cell_failures: int = 3
    smaller_cells: float = 0.7
    settling_steps: tuple[float, float] = (1.0, 0.04)
    settling_tries: int = 4
    settling_sweeps: int = 3
    compacting_moves: int = 3
    finishing_moves: int = 10
    finishing_shakes: int = 20
    finishing: tuple[float, float, float] = (0.1, 1.5, 0.01)
    construction_samples: int = 150
    construction_seconds: float = 5.0
    constructed_again: int = 256
    samples: int = 90
    passes_at_once: int = 5
    patience: int = 60
    exchange_patience: int = 15
    most_patience: int = 240
    patient_share: float = 0.01
    gain: float = 0.98
    precise_overlap: float = 1.0
    weight_growth: tuple[float, float] = (0.05, 0.2)
    weight_decay: float = 0.95
    first_items: int = 6
    first_levels: float = 0.2
    beginning: float = 0.5
    beginning_seconds: tuple[float, float] = (60.0, 1.0)
    most_beginnings: int = 10
    persevering: int = 5
    resumes: bool = False
    shrink: float = 0.04
    early_shrink: float = 0.01
    least_shrink: float = 0.0002
    shrink_growth: float = 1.1
    shrink_decay: float = 0.7
    restart_probability: float = 0.3
    full_shrink: float = 0.01
    more_space: float = 0.15
    max_inserted: int = 3
    max_removed: int = 2
    exchange_gain: tuple[float, float] = (1e-9, 0.05)
    exchange_choices: int = 100
    max_failures: int = 30
    max_loss: float = 0.02
    max_refill_loss: float = 0.05
    least_rebuilding: float = 0.05
    max_rebuilt: int = 4
    rebuilt_neighbours: float = 0.5
    shuffle: float = 0.25
    swap_probability: float = 0.5
    swap_neighbours: int = 12
    smaller_box: float = 0.5
    round_seconds: tuple[float, float] = (1.0, 20.0)
    round_growth: float = 0.25
    round_passes: int = 100


DEFAULT_SETTINGS = SearchSettings()
