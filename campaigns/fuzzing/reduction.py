"""Reduction of a file with which something is wrong to a short one with the same reason."""

from __future__ import annotations

import time

from campaigns.fuzzing.reader import Reader
from campaigns.fuzzing.verdicts import Finding, judge


def reduce(reader: Reader, data: bytes, finding: Finding, seconds: float = 20.0) -> bytes:
    """Remove pieces of a file, large ones first, as long as the finding stays the same.

    Parameters
    ----------
    reader : Reader
        The reader.
    data : bytes
        The file.
    finding : Finding
        What is wrong with it.
    seconds : float
        The limit of the search.

    Returns
    -------
    bytes
        A file, perhaps the same, with the same finding.
    """
    until = time.monotonic() + seconds
    size = len(data) // 2
    while size and time.monotonic() < until:
        at = 0
        while at < len(data) and time.monotonic() < until:
            shorter = data[:at] + data[at + size :]
            again = judge(reader, shorter)
            if again is not None and again.key == finding.key:
                data = shorter
            else:
                at += size
        size //= 2
    return data
