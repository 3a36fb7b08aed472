"""Numbers in order, by a few lines that compile in a tenth of the time of numpy's sort."""

from __future__ import annotations

from fwclass.kernel import kernel


@kernel
def sort_few(values):  # type: ignore[no-untyped-def]
    """Sort some hundred numbers in place, lowest first; no NaN (Shell 1959, steps of Gonnet and Baeza-Yates 1991)."""
    step = len(values)
    while step > 1:
        step = max((5 * step - 1) // 11, 1)
        for i in range(step, len(values)):
            value, at = values[i], i
            while at >= step and values[at - step] > value:
                values[at] = values[at - step]
                at -= step
            values[at] = value
