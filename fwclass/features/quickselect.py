"""The lowest of many values, without sorting them (Hoare's quickselect)."""

from __future__ import annotations

from fwclass.kernel import kernel


@kernel
def lowest_first(values, n, k):  # type: ignore[no-untyped-def]
    """Reorder the first `n` of `values` (room,) so that the `k` lowest stand in front, the greatest of them at ``k -
    1``; no NaN."""
    low, high = 0, n - 1
    while low < high:
        a, b, c = values[low], values[(low + high) >> 1], values[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k - 1 <= j:
            high = j
        elif k - 1 >= i:
            low = i
        else:
            break
