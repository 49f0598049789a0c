"""The kernel that computes the scores of a `PlacementNetwork`.

A perceptron with two hidden layers of rectified units, next to a linear part. Plain loops in a
fixed order: no threads of a linear algebra library, whose sums depend on the machine and on the
number of rows. So a placement has the same score alone and among others, and plays can be repeated.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, kernel


@allocating_kernel
def _layer(rows, weights, bias):
    """Return max(0, rows @ weights + bias), float32."""
    count, inputs = rows.shape
    outputs = weights.shape[1]
    found = np.empty((count, outputs), np.float32)
    for n in range(count):
        own = found[n]
        own[:] = bias
        for i in range(inputs):
            value = rows[n, i]
            if value != 0:  # rectified inputs are often 0
                for o in range(outputs):
                    own[o] += value * weights[i, o]
        for o in range(outputs):
            own[o] = max(own[o], np.float32(0))
    return found


@kernel
def score(features, mean, scale, linear, first, second, last):
    """Return the scores, float32 (n,).

    Parameters
    ----------
    features : ndarray
        float32 (n, features).
    mean, scale : ndarray
        float32 (features,).
    linear : ndarray
        float32 (features,).
    first, second : tuple
        Weights, float32 (inputs, outputs), and bias, float32 (outputs,).
    last : ndarray
        float32 (outputs,).
    """
    count, inputs = features.shape
    scaled = np.empty((count, inputs), np.float32)
    for n in range(count):
        for i in range(inputs):
            scaled[n, i] = (features[n, i] - mean[i]) / scale[i]
    hidden = _layer(_layer(scaled, first[0], first[1]), second[0], second[1])
    scores = np.empty(count, np.float32)
    for n in range(count):
        total = np.float32(0)
        for i in range(inputs):
            total += scaled[n, i] * linear[i]
        for o in range(hidden.shape[1]):
            total += hidden[n, o] * last[o]
        scores[n] = total
    return scores
