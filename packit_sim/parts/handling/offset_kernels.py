"""Kernel of the search for ways out: the cheapest way through cells of offsets."""

from __future__ import annotations

import heapq

import numpy as np

from packit_sim.core.compilation import kernel

UNREACHED = np.int32(2**30)
"""The cost of cells that are blocked, or from which no way leads to the border."""


@kernel
def costs_to_border(costs):
    """Return the cost of the cheapest way from each cell through faces to the grid's border.

    Parameters
    ----------
    costs : ndarray
        uint8 (x, y, z), the cost of each cell; 0 if it is blocked.

    Returns
    -------
    ndarray
        int32 (x, y, z), the costs of all cells on the way together (Dijkstra, 1959).
    """
    nx, ny, nz = costs.shape
    found = np.full(costs.shape, UNREACHED, np.int32)
    heap = [(np.int64(0), np.int64(0))]
    heap.pop()
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                is_border = x in (0, nx - 1) or y in (0, ny - 1) or z in (0, nz - 1)
                if is_border and costs[x, y, z]:
                    found[x, y, z] = costs[x, y, z]
                    heap.append((np.int64(costs[x, y, z]), np.int64((x * ny + y) * nz + z)))
    heapq.heapify(heap)
    while heap:
        cost, at = heapq.heappop(heap)
        x, y, z = at // (ny * nz), at // nz % ny, at % nz
        if cost > found[x, y, z]:
            continue
        for side in range(6):
            step = 1 - 2 * (side % 2)
            u = x + step if side < 2 else x
            v = y + step if 2 <= side < 4 else y
            w = z + step if side >= 4 else z
            if u < 0 or u >= nx or v < 0 or v >= ny or w < 0 or w >= nz or not costs[u, v, w]:
                continue
            more = cost + costs[u, v, w]
            if more < found[u, v, w]:
                found[u, v, w] = more
                heapq.heappush(heap, (more, u * ny * nz + v * nz + w))
    return found
